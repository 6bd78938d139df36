"""Checks of settings that need no heavy imports."""

import inspect
import types
import typing
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

LARGEST_SIDE = 16_384  # [px] of an image that a network sees
LARGEST = 2**32  # of a whole number: numpy's seeds end there too
WORDS = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "a text",
    types.NoneType: "null",
}
COUNTS = ("size", "frames")  # a setting whose name ends so counts something: 1 or more


def one_of(name: str, value: Any, allowed: Collection[Any]) -> None:
    """Raise ``ValueError`` if a setting has none of the allowed values."""
    if value not in allowed:
        raise ValueError(f"{name}={value!r}: give one of {', '.join(map(str, allowed))}")


def check_size(name: str, value: Any) -> tuple[int, int] | None:
    """Return the ``(height, width)`` [px] that a file states under ``name``; None: it states none.

    Raises:
        ValueError: it is something else, or absurdly large.
    """
    if value is None:
        return None
    sides = list(value) if isinstance(value, list | tuple) else []
    if len(sides) != 2 or not all(type(side) is int and 1 <= side <= LARGEST_SIDE for side in sides):
        raise ValueError(
            f"{name} is {value!r}, but must be null or [height, width] in pixels, 1 to {LARGEST_SIDE} each"
        )
    return sides[0], sides[1]


def check_arguments(target: Callable[..., Any], arguments: Mapping[str, Any], prefix: str = "") -> None:
    """Compare plain values with the annotations of what they are passed to.

    Args:
        target: class or function.
        arguments: name -> value; objects pass, and so does a name that ``target`` does not annotate.
        prefix: of the settings' names in the error, as "trainer.".

    Raises:
        ValueError: a value of another type, a whole number out of range, or a size below 1.
    """
    try:
        parameters = inspect.signature(target).parameters
    except (TypeError, ValueError):  # built in
        return
    for name, value in arguments.items():
        kind = parameters[name].annotation if name in parameters else Any
        if not _fits(value, kind):
            raise ValueError(f"{prefix}{name}={value}: give {_described(kind)}")
        whole = [one for one in (value if isinstance(value, list) else [value]) if type(one) is int]
        if any(abs(one) >= LARGEST for one in whole):
            raise ValueError(f"{prefix}{name}={value}: give a whole number below 2^32")
        if name.rpartition("_")[2] in COUNTS and any(one < 1 for one in whole):
            raise ValueError(f"{prefix}{name}={value}: give whole numbers of 1 or more")


def _fits(value: Any, kind: Any) -> bool:
    """Whether a plain value is of an annotated type; True where the annotation says too little."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, one) for one in inner)
    if kind in (None, types.NoneType):
        return value is None
    if kind is float:
        return type(value) in (int, float)
    if kind in (int, bool):
        return type(value) is kind
    if kind is str:
        return isinstance(value, str)
    if origin in (list, tuple, Sequence):
        if not isinstance(value, list | tuple):
            return False
        kinds = inner if origin is tuple and Ellipsis not in inner else inner[:1] * len(value)
        return len(kinds) == len(value) and all(map(_fits, value, kinds))
    return getattr(kind, "__name__", "") != "Tensor" or hasattr(value, "shape")


def _described(kind: Any) -> str:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        words = dict.fromkeys(_described(one) for one in inner if getattr(one, "__name__", "") != "Tensor")
        return " or ".join(words)
    if origin in (list, tuple, Sequence):
        count = f"{len(inner)} values" if origin is tuple and Ellipsis not in inner else "values"
        return f"a list of {count}, each {_described(inner[0])}"
    return WORDS.get(type(None) if kind is None else kind, getattr(kind, "__name__", str(kind)))

"""Checks of settings that need no heavy imports."""

from collections.abc import Collection
from typing import Any

LARGEST_SIDE = 16_384  # [px] of an image that a network sees
LARGEST_VALUE = 10.0  # of an image in [0, 1], with room for normalized ones and noise; bytes go to 255


def one_of(name: str, value: Any, allowed: Collection[Any]) -> None:
    """Raise ``ValueError`` if a setting has none of the allowed values."""
    if value not in allowed:
        raise ValueError(f"{name}={value!r}: give one of {', '.join(map(str, allowed))}")


def at_least(least: int, **settings: int | None) -> None:
    """Raise ``ValueError`` if one of the settings is less; None passes."""
    for name, value in settings.items():
        if value is not None and value < least:
            raise ValueError(f"{name}={value}: give a whole number, {least} or more")


def check_size(name: str, value: Any) -> tuple[int, int] | None:
    """Return the ``(height, width)`` [px] that a setting or a file gives under ``name``; None: it gives none.

    Raises:
        ValueError: it is something else, or absurdly large.
    """
    if value is None:
        return None
    sides = list(value) if isinstance(value, list | tuple) else []
    if len(sides) != 2 or not all(type(side) is int and 1 <= side <= LARGEST_SIDE for side in sides):
        raise ValueError(
            f"{name}={value!r}: give [height, width] in pixels, 1 to {LARGEST_SIDE} each, or null"
        )
    return sides[0], sides[1]


def check_largest(value: float) -> None:
    """Raise ``ValueError`` if the largest value of images in [0, 1] is that of bytes."""
    if value > LARGEST_VALUE:
        raise ValueError(f"image has values up to {value:.0f}: give floats in [0, 1] (bytes divided by 255)")

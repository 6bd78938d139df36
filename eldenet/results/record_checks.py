"""Whether a stored record has the form that tables and plots rely on, and figures that can be true."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from eldenet.evaluation.metric_names import RANGES, in_range

ADVICE = "the file is damaged, or not eldenet's: restore it, leave it out, or train or evaluate again"


class Kind(NamedTuple):
    """Values that an entry may have, in words and as a test."""

    words: str
    fits: Callable[[Any], bool]


def figure(name: str) -> Kind:
    """A finite number in the range of a metric or cost; null stands for NaN."""
    low, high = RANGES.get(name, (0, math.inf))
    return Kind(f"a number from {low:g} to {high:g}, or null", lambda value: in_range(name, value))


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


TEXT = Kind("a text", _is_text)
MAYBE_TEXT = Kind("a text or null", lambda value: value is None or _is_text(value))
WHOLE = Kind("a whole number from 0", lambda value: type(value) is int and 0 <= value < 2**63)
MAYBE_WHOLE = Kind("a whole number from 0, or null", lambda value: value is None or WHOLE.fits(value))
FINITE = Kind("a finite number or null", lambda value: in_range("", value, low=-math.inf))
MAPPING = Kind("a mapping", lambda value: isinstance(value, Mapping))


class Figures(NamedTuple):
    """A mapping of figures by name; ``also`` are its entries of another kind."""

    also: Mapping[str, Kind]
    prefix: str = ""  # before the metric's name: val_delta1
    may_be_null: bool = False


class ListOf(NamedTuple):
    """A list whose items all have one shape."""

    shape: Any


Shape = Kind | Figures | ListOf | Mapping[str, Any]
COST = Figures(
    {"runtime": TEXT, "precision": MAYBE_TEXT, "device": MAYBE_TEXT, "threads": MAYBE_WHOLE}
    | dict.fromkeys(("height", "width", "batch"), WHOLE)
)
RUN: Shape = {
    "model": TEXT,
    "data": TEXT,
    "split": TEXT,
    "split_hash": TEXT,
    "train_split_hash": MAYBE_TEXT,
    "protocol": {
        "name": TEXT,
        "resize": Kind(
            "a number, a list or null", lambda value: isinstance(value, list) or FINITE.fits(value)
        ),
        "inverse_scale": FINITE,
    },
    "metrics": Figures({"images": WHOLE, "pixels": WHOLE}),
    "constant_predictor": Figures({"images": WHOLE, "pixels": WHOLE}, may_be_null=True),
    "cost": COST,
    "seed": MAYBE_WHOLE,
    "date": TEXT,
    "hardware": {"processor": MAYBE_TEXT, "accelerator": MAYBE_TEXT},
    "versions": MAPPING,
    "resources": {"precision": MAYBE_TEXT},
    "sources": MAPPING,
    "config": MAPPING,
}
HISTORY: Shape = {"best_epoch": MAYBE_WHOLE, "history": ListOf(Figures({"epoch": WHOLE}, prefix="val_"))}
CHOICE: Shape = {
    "learning_rate": Kind("a number above 0", lambda value: in_range("", value) and bool(value)),
    "delta1": MAPPING,
    "rule": {"candidates": ListOf(FINITE), "config": MAPPING},
    "sources": MAPPING,
}


def check_shape(file: str | Path, content: Any, shape: Shape, name: str = "") -> None:
    """Raise ValueError, which names the file and the entry, unless ``content`` has ``shape``.

    Entries that the shape does not name may be anything; entries that are absent are not missed.
    """
    if isinstance(shape, Figures):
        if content is None and shape.may_be_null:
            return
        _refuse(file, name, content, MAPPING)
        for key, value in content.items():
            known = shape.also.get(key) or figure(str(key).removeprefix(shape.prefix))
            if shape.prefix and not str(key).startswith(shape.prefix) and key not in shape.also:
                known = FINITE
            _refuse(file, f"{name}.{key}", value, known)
    elif isinstance(shape, ListOf):
        _refuse(file, name, content, Kind("a list", lambda value: isinstance(value, list)))
        for number, item in enumerate(content):
            check_shape(file, item, shape.shape, f"{name}[{number}]")
    elif isinstance(shape, Kind):
        _refuse(file, name, content, shape)
    else:
        _refuse(file, name, content, MAPPING)
        for key, inner in shape.items():
            if key in content:
                check_shape(file, content[key], inner, f"{name}.{key}" if name else key)


def require(file: str | Path, content: Mapping[str, Any], *names: str) -> None:
    """Raise ValueError, which names the file, unless a record has all these entries (``cost.params``)."""
    for name in names:
        node: Any = content
        for part in name.split("."):
            if not isinstance(node, Mapping) or part not in node:
                raise ValueError(f"{file} has no {name}: {ADVICE}")
            node = node[part]


def _refuse(file: str | Path, name: str, value: Any, kind: Kind) -> None:
    if not kind.fits(value):
        raise ValueError(f"{file}: {name}={str(value)[:60]!r} should be {kind.words}: {ADVICE}")

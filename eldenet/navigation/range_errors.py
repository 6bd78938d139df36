"""How wrong a camera's ranges are: measured from looks, kept as a small JSON file, drawn by ``noisy``.

An error is the logarithm of a column's range over the true one. Each distance has its bias and spread; what
is left, over the spread, is the sum of three parts: one that the whole frame shares and that wanders from
frame to frame, one that about four neighboring columns share, and each column's own.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np

from eldenet.navigation.looks import Looks
from eldenet.navigation.observer import SECTORS
from eldenet.simulation.robot import ROBOT

EDGES = (0.3, 1.0, 2.0, 3.0, 4.5, 6.5, 10.0)  # of the distances that are told apart [m]
MISSED = math.log(1.5)  # a thing that reads half as far again as it is was not seen; the reverse is a ghost
EDGE_STEP = 0.2  # neighboring columns whose true ranges differ by more show different things
_SHARED = (0.719, 2)  # correlation of the smooth part at that many columns' distance
_APART = range(12, 20)  # columns that share the frame's part alone


@dataclass(frozen=True)
class RangeErrors:
    """Errors of ranges by distance.

    Attributes:
        edges: of the bins of true range [m]; the lists below have an entry for each bin.
        bias: median error.
        spread: standard deviation of the error, misses and ghosts left out.
        miss: share of the things there that were not seen in one look.
        scale: standard deviation of the frame's part, in spreads.
        smooth: of the part that neighbors share, in spreads.
        column: of each column's own part, in spreads.
        memory: correlation of the frame's part with the look before.
        far: median and standard deviation of the error where nothing is within reach.
        sectors: per bin of the nearest true range in a sector: bias, spread, missed and ghost share, count.
        measured: where this comes from.
    """

    edges: tuple[float, ...]
    bias: tuple[float, ...]
    spread: tuple[float, ...]
    miss: tuple[float, ...]
    scale: float
    smooth: float
    column: float
    memory: float
    far: tuple[float, float] = (0.0, 0.0)
    sectors: tuple[dict[str, float], ...] = ()
    measured: dict[str, Any] = field(default_factory=dict)

    @property
    def middles(self) -> np.ndarray:
        """Of the bins [m]."""
        return (np.array(self.edges[1:]) + self.edges[:-1]) / 2

    def write(self, path: Path) -> None:
        """As JSON."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(asdict(self), indent=1) + "\n")

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """What :meth:`write` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is none.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(
                f"no range errors at {path}: python -m eldenet.navigate mode=measure sensor=camera makes them"
            )
        try:
            content = json.loads(Path(path).read_text())
            lists = ("edges", "bias", "spread", "miss", "far", "sectors")
            errors = cls(**(content | {name: tuple(content[name]) for name in lists}))
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path} holds no range errors: {error!r}") from error
        if not {len(errors.bias), len(errors.spread), len(errors.miss)} == {len(errors.edges) - 1}:
            raise ValueError(f"{path}: bias, spread and miss need {len(errors.edges) - 1} entries each")
        return errors


def fit_errors(looks: Looks, edges: Sequence[float] = EDGES, **measured: Any) -> RangeErrors:
    """Errors of looks.

    Columns at the edge of something are left out: which side a ray meets there is chance.

    Args:
        looks: of one sensor.
        edges: of the bins of distance [m].
        measured: notes to keep.

    Raises:
        ValueError: too few looks to tell.
    """
    error = np.log(looks.ranges / looks.true)
    thing = things(looks.true)
    reach = looks.true < ROBOT.far
    inner = reach & ~_at_edge(thing)
    count = len(edges) - 1
    where = np.clip(np.digitize(looks.true, edges) - 1, 0, count - 1)
    kept = inner & (np.abs(error) < MISSED)
    if kept.sum() < 500:
        raise ValueError(
            f"{int(kept.sum())} columns show something: too few to measure errors, look in more arenas"
        )
    bins = {number: error[kept & (where == number)] for number in range(count)}
    enough = min(50, max(len(values) for values in bins.values()))
    told = [number for number, values in bins.items() if len(values) >= enough]
    # a bin that is all but empty takes over what the nearest other one tells
    nearest = [bins[min(told, key=lambda other: abs(other - number))] for number in range(count)]
    bias, spread = np.array([(np.median(values), values.std()) for values in nearest]).T
    unit = np.where(kept, (error - bias[where]) / np.maximum(spread[where], 1e-6), np.nan)
    scale, smooth, column, memory = _parts(unit, looks.crossing)
    beyond = error[~reach & ~_at_edge(thing)]
    far = (float(np.median(beyond)), float(beyond.std())) if len(beyond) >= 50 else (0.0, 0.0)
    return RangeErrors(
        edges=tuple(edges),
        bias=_rounded(bias),
        spread=_rounded(spread),
        miss=_missed(error, looks.true, thing, edges),
        scale=round(scale, 4),
        smooth=round(smooth, 4),
        column=round(column, 4),
        memory=round(memory, 4),
        far=(round(far[0], 4), round(far[1], 4)),
        sectors=_sectors(looks, edges),
        measured={"looks": len(error), "crossings": len(np.unique(looks.crossing)), **measured},
    )


def _rounded(values: np.ndarray) -> tuple[float, ...]:
    return tuple(round(float(value), 4) for value in values)


def things(ranges: np.ndarray) -> np.ndarray:
    """Number of the thing that each column of true ranges ``(..., columns)`` shows, from the right."""
    step = np.abs(np.diff(np.log(ranges), axis=-1)) > EDGE_STEP
    return np.concatenate([np.zeros_like(step[..., :1], int), np.cumsum(step, axis=-1)], axis=-1)


def _at_edge(thing: np.ndarray) -> np.ndarray:
    step = np.diff(thing, axis=1) > 0
    out = np.zeros(thing.shape, bool)
    out[:, 1:] |= step
    out[:, :-1] |= step
    return out


def _parts(unit: np.ndarray, crossing: np.ndarray) -> tuple[float, float, float, float]:
    """Standard deviations of frame, smooth and column part, and the frame's correlation in time."""
    columns = unit.shape[1]

    def shared(lag: int) -> float:
        return float(np.nanmean(unit[:, lag:] * unit[:, : columns - lag]))

    frame = max(float(np.mean([shared(lag) for lag in _APART])), 0.0)
    correlation, lag = _SHARED
    smooth = min(max((shared(lag) - frame) / correlation, 0.0), 1.0 - min(frame, 1.0))
    own = max(1.0 - frame - smooth, 0.0)
    seen = np.isfinite(unit).sum(axis=1) >= 8
    mean = np.where(seen, np.nansum(unit, axis=1) / np.maximum(np.isfinite(unit).sum(axis=1), 1), np.nan)
    same = (crossing[1:] == crossing[:-1]) & seen[1:] & seen[:-1]
    after = float((mean[1:] * mean[:-1])[same].mean()) if same.any() else 0.0
    memory = min(max(after / frame, 0.0), 0.98) if frame > 0.02 else 0.0
    # linear interpolation between knots loses a third of their variance
    return math.sqrt(frame), math.sqrt(1.5 * smooth), math.sqrt(own), memory


def _missed(
    error: np.ndarray, true: np.ndarray, thing: np.ndarray, edges: Sequence[float]
) -> tuple[float, ...]:
    """Share of things of two columns and more that read too far, by distance."""
    looks, columns = error.shape
    flat = (thing + np.arange(looks)[:, None] * columns).ravel()
    size = np.bincount(flat, minlength=looks * columns)
    with np.errstate(invalid="ignore"):
        mean_error = np.bincount(flat, error.ravel(), minlength=len(size)) / size
        mean_range = np.bincount(flat, true.ravel(), minlength=len(size)) / size
    there = (size >= 2) & (mean_range < ROBOT.far * 0.99)
    where = np.clip(np.digitize(mean_range[there], edges) - 1, 0, len(edges) - 2)
    total = np.bincount(where, minlength=len(edges) - 1)
    lost = np.bincount(where, mean_error[there] > MISSED, minlength=len(edges) - 1)
    return _rounded(lost / np.maximum(total, 1))


def _sectors(looks: Looks, edges: Sequence[float]) -> tuple[dict[str, float], ...]:
    got, true = (part.reshape(len(part), SECTORS, -1).min(axis=2) for part in (looks.ranges, looks.true))
    error, rows = np.log(got / true), []
    for low, high in pairwise(edges):
        values = error[(true >= low) & (true < high)]
        near = values[np.abs(values) < MISSED]
        row = {"from": low, "to": high, "count": len(values)}
        row |= {"bias": float(np.median(near)), "spread": float(near.std())} if len(near) else {}
        if len(values):
            row |= {"missed": float((values > MISSED).mean()), "ghost": float((values < -MISSED).mean())}
        rows.append({name: round(value, 4) for name, value in row.items()})
    return tuple(rows)

"""Errors of a camera's ranges: scans with their true ranges, and a model that is fitted to them.

``sensor=noisy`` draws from the model, which is kept as a small JSON file. An error is the logarithm of a
column's range over the true one. Each distance bin has a bias and a spread; the rest, divided by the spread,
is the sum of three parts: one that the whole frame shares and that changes slowly from frame to frame, one
that about four neighboring columns share, and one of each column.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np

from eldenet.navigation.episodes import Episodes, EpisodeSettings, Event
from eldenet.navigation.evaluation import Policy
from eldenet.navigation.observer import SECTORS
from eldenet.navigation.sensors import Ranges, Sensor
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import Arena, cell_center, clearance_map
from eldenet.simulation.robot import ROBOT
from eldenet.system.files import read_json, write_text
from eldenet.weights import check_packaged

EDGES = (0.3, 1.0, 2.0, 3.0, 4.5, 6.5, 10.0)  # of the distance bins [m]
NEAR = (0.3, 0.9)  # clearance of a place near an obstacle [m]; the robot fits from 0.3 m on
MISSED = math.log(1.5)  # a segment with a range 1.5 times too great was missed; the reverse is a ghost
EDGE_STEP = 0.2  # neighboring columns whose true log ranges differ by more belong to different segments
_SHARED = (0.719, 2)  # correlation of the smooth part, and the distance in columns it applies to
_APART = range(12, 20)  # distances in columns at which only the frame's part is shared


@dataclass(frozen=True)
class Scans:
    """Ranges of ``F`` scans ``(F, columns)`` [m], the true ranges, and numbers of their episodes ``(F,)``."""

    ranges: np.ndarray
    true: np.ndarray
    episode: np.ndarray


def scan_along(
    arenas: Sequence[Arena],
    sensor: Sensor,
    policy: Policy,
    settings: EpisodeSettings = EpisodeSettings(),  # noqa: B008 - immutable
    advance: Callable[[int], None] = lambda count: None,
) -> Scans:
    """Scan along episodes that ``policy`` drives with true ranges, so that no path depends on the sensor."""
    episodes = Episodes(1, Ranges(), settings)
    rows: list[tuple[np.ndarray, np.ndarray, int]] = []
    for number, arena in enumerate(arenas):
        episodes.start(0, arena, (settings.seed, number))
        world = episodes.worlds[0]
        assert world is not None
        policy.reset(0, world)
        instance = sensor.begin(world, np.random.default_rng((settings.seed, number)))
        event = Event.NONE
        while event is Event.NONE:
            senses = episodes.sense()
            rows.append((instance.scan().ranges, senses.ranges[0].copy(), number))
            _, events = episodes.step(policy.commands(senses))
            event = Event(int(events[0]))
        advance(1)
    return Scans(*map(np.array, zip(*rows, strict=True)))


def scan_near(
    arenas: Sequence[Arena],
    sensor: Sensor,
    *,
    scans: int = 8,
    seed: int = 0,
    advance: Callable[[int], None] = lambda count: None,
) -> Scans:
    """Scan from random places near standing obstacles or walls, with any heading.

    Drivers avoid such places, so episodes contain few of them. Each scan counts as a separate episode.

    Raises:
        ValueError: less than one scan per arena.
    """
    if scans < 1:
        raise ValueError(f"scans={scans}: give at least one scan per arena")
    rows: list[tuple[np.ndarray, np.ndarray, int]] = []
    for number, arena in enumerate(arenas):
        rng = np.random.default_rng((seed, number))
        clearance = clearance_map(arena.obstacles)
        places = np.argwhere((clearance >= NEAR[0]) & (clearance < NEAR[1]))
        world = ArenaWorld(arena)
        instance = sensor.begin(world, rng)
        for _ in range(scans):
            x, y = cell_center(*places[rng.integers(len(places))])
            world.place((x, y, rng.uniform(-math.pi, math.pi)))
            rows.append((instance.scan().ranges, world.ranges(), len(rows)))
        advance(1)
    return Scans(*map(np.array, zip(*rows, strict=True)))


@dataclass(frozen=True)
class RangeErrors:
    """Errors of ranges by distance.

    Attributes:
        edges: of the bins of true range [m]; the lists below have one entry per bin.
        bias: median error.
        spread: standard deviation of the error without misses and ghosts.
        miss: rate at which a segment is missed in one scan.
        scale: standard deviation of the frame's part, in spreads.
        smooth: of the part that neighboring columns share, in spreads.
        column: of each column's own part, in spreads.
        memory: correlation of the frame's part with the previous scan.
        far: median and standard deviation of the error where nothing is in range.
        sectors: per bin of a sector's nearest true range: bias, spread, miss and ghost rate, count.
        measured: notes about the measurement.
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
        """Middle of each bin [m]."""
        return (np.array(self.edges[1:]) + self.edges[:-1]) / 2

    def write(self, path: Path) -> None:
        """Write a JSON file."""
        write_text(path, json.dumps(asdict(self), indent=1) + "\n")

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file that :meth:`write` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file contains something else.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(
                f"no range errors at {path}: make them with eldenet navigate mode=fit_noise sensor=camera"
            )
        check_packaged(Path(path))
        try:
            content = read_json(Path(path))
            lists = ("edges", "bias", "spread", "miss", "far", "sectors")
            errors = cls(**(content | {name: tuple(content[name]) for name in lists}))
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path} contains no range errors: {error!r}") from error
        check_edges(f"{path}: edges", errors.edges)
        if not {len(errors.bias), len(errors.spread), len(errors.miss)} == {len(errors.edges) - 1}:
            raise ValueError(f"{path}: bias, spread and miss need {len(errors.edges) - 1} entries each")
        return errors


def check_edges(name: str, edges: Sequence[float]) -> None:
    """Raise ``ValueError`` unless these are edges of distance bins [m]."""
    if len(edges) < 2 or not np.isfinite(edges).all() or not (np.diff(edges) > 0).all():
        raise ValueError(f"{name}={list(edges)}: give two or more finite distances, rising [m]")


def fit_errors(scans: Scans, edges: Sequence[float] = EDGES, **measured: Any) -> RangeErrors:
    """Fit the errors of a sensor's scans.

    Columns at the edge of a segment are left out: either side of the edge may be the right one.

    Args:
        scans: of one sensor.
        edges: of the distance bins [m].
        measured: notes to store.

    Raises:
        ValueError: too few columns show something.
    """
    error = np.log(scans.ranges / scans.true)
    segment = segments(scans.true)
    reach = scans.true < ROBOT.far
    inner = reach & ~_at_edge(segment)
    count = len(edges) - 1
    where = np.clip(np.digitize(scans.true, edges) - 1, 0, count - 1)
    kept = inner & (np.abs(error) < MISSED)
    if kept.sum() < 500:
        raise ValueError(
            f"only {int(kept.sum())} columns show an obstacle or wall, but the fit needs 500: scan in "
            "more arenas"
        )
    bins = {number: error[kept & (where == number)] for number in range(count)}
    enough = min(50, max(len(values) for values in bins.values()))
    filled = [number for number, values in bins.items() if len(values) >= enough]
    # a nearly empty bin takes the values of the nearest filled one
    nearest = [bins[min(filled, key=lambda other: abs(other - number))] for number in range(count)]
    bias, spread = np.array([(np.median(values), values.std()) for values in nearest]).T
    unit = np.where(kept, (error - bias[where]) / np.maximum(spread[where], 1e-6), np.nan)
    scale, smooth, column, memory = _rounded(_parts(unit, scans.episode))
    beyond = error[~reach & ~_at_edge(segment)]
    far = (float(np.median(beyond)), float(beyond.std())) if len(beyond) >= 50 else (0.0, 0.0)
    return RangeErrors(
        edges=tuple(edges),
        bias=_rounded(bias),
        spread=_rounded(spread),
        miss=_missed(error, scans.true, segment, edges),
        scale=scale,
        smooth=smooth,
        column=column,
        memory=memory,
        far=(round(far[0], 4), round(far[1], 4)),
        sectors=_sectors(scans, edges),
        measured={"scans": len(error), "episodes": len(np.unique(scans.episode)), **measured},
    )


def _rounded(values: Sequence[float] | np.ndarray) -> tuple[float, ...]:
    return tuple(round(float(value), 4) for value in values)


def segments(ranges: np.ndarray) -> np.ndarray:
    """Number of each column's segment in true ranges ``(..., columns)``, counted from the right."""
    step = np.abs(np.diff(np.log(ranges), axis=-1)) > EDGE_STEP
    return np.concatenate([np.zeros_like(step[..., :1], int), np.cumsum(step, axis=-1)], axis=-1)


def _at_edge(segment: np.ndarray) -> np.ndarray:
    step = np.diff(segment, axis=1) > 0
    out = np.zeros(segment.shape, bool)
    out[:, 1:] |= step
    out[:, :-1] |= step
    return out


def _parts(unit: np.ndarray, episode: np.ndarray) -> tuple[float, float, float, float]:
    """Standard deviations of frame, smooth and column part, and the frame part's correlation over time."""
    columns = unit.shape[1]

    def shared(lag: int) -> float:
        return float(np.nanmean(unit[:, lag:] * unit[:, : columns - lag]))

    frame = max(float(np.mean([shared(lag) for lag in _APART])), 0.0)
    correlation, lag = _SHARED
    smooth = min(max((shared(lag) - frame) / correlation, 0.0), 1.0 - min(frame, 1.0))
    own = max(1.0 - frame - smooth, 0.0)
    seen = np.isfinite(unit).sum(axis=1) >= 8
    mean = np.where(seen, np.nansum(unit, axis=1) / np.maximum(np.isfinite(unit).sum(axis=1), 1), np.nan)
    same = (episode[1:] == episode[:-1]) & seen[1:] & seen[:-1]
    after = float((mean[1:] * mean[:-1])[same].mean()) if same.any() else 0.0
    memory = min(max(after / frame, 0.0), 0.98) if frame > 0.02 else 0.0
    # linear interpolation between knots loses a third of their variance
    return math.sqrt(frame), math.sqrt(1.5 * smooth), math.sqrt(own), memory


def _missed(
    error: np.ndarray, true: np.ndarray, segment: np.ndarray, edges: Sequence[float]
) -> tuple[float, ...]:
    """Rate at which segments of two or more columns are missed, by distance."""
    scans, columns = error.shape
    flat = (segment + np.arange(scans)[:, None] * columns).ravel()
    size = np.bincount(flat, minlength=scans * columns)
    with np.errstate(invalid="ignore"):
        mean_error = np.bincount(flat, error.ravel(), minlength=len(size)) / size
        mean_range = np.bincount(flat, true.ravel(), minlength=len(size)) / size
    there = (size >= 2) & (mean_range < ROBOT.far * 0.99)
    where = np.clip(np.digitize(mean_range[there], edges) - 1, 0, len(edges) - 2)
    total = np.bincount(where, minlength=len(edges) - 1)
    lost = np.bincount(where, mean_error[there] > MISSED, minlength=len(edges) - 1)
    return _rounded(lost / np.maximum(total, 1))


def _sectors(scans: Scans, edges: Sequence[float]) -> tuple[dict[str, float], ...]:
    got, true = (part.reshape(len(part), SECTORS, -1).min(axis=2) for part in (scans.ranges, scans.true))
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

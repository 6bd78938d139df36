"""Measure the errors of a camera's ranges in arenas, and fit the model that sensor=noisy draws from.

python experiments/table5_success/fit_range_errors.py density=[20,80] episodes=10
python experiments/table5_success/fit_range_errors.py density=80 --near --edges 0.3 0.5 0.8 1.2 2 4 7 10

Takes the settings of ``eldenet navigate mode=evaluate``, with sensor=camera and split=val by default, and
writes ``range_errors.json``, which ``sensor.errors=`` reads. It scans along episodes of the packaged driver
or, with --near, from random places 0.3 to 0.9 m from obstacles, which episodes avoid.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.compose import compose, listed
from eldenet.configurable import instantiate
from eldenet.navigate import NavigateEvaluateSettings, NavigateSettings, arenas_of, episode_settings
from eldenet.navigation.episodes import Episodes, EpisodeSettings, Event
from eldenet.navigation.evaluation import Policy
from eldenet.navigation.observer import SECTORS
from eldenet.navigation.policy import Navigator
from eldenet.navigation.range_errors import RangeErrors, check_edges, segments
from eldenet.navigation.sensors import Ranges, Sensor
from eldenet.results.run_record import environment
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import Arena, cell_center, clearance_map
from eldenet.simulation.robot import ROBOT
from eldenet.system.resources import choose_resources

EDGES = (0.3, 1.0, 2.0, 3.0, 4.5, 6.5, 10.0)  # of the distance bins [m]
NEAR = (0.3, 0.9)  # clearance of a place near an obstacle [m]; the robot fits from 0.3 m on
MISSED = math.log(1.5)  # a segment with a range 1.5 times too great was missed; the reverse is a ghost
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
    return Scans(*map(np.array, zip(*rows, strict=True)))


def scan_near(
    arenas: Sequence[Arena],
    sensor: Sensor,
    *,
    scans: int = 8,
    seed: int = 0,
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
    return Scans(*map(np.array, zip(*rows, strict=True)))


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


def main() -> None:
    """Scan, fit, write ``range_errors.json`` and print its table of sectors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("settings", nargs="*", help="of eldenet navigate mode=evaluate")
    parser.add_argument("--near", action="store_true", help="scan near obstacles")
    parser.add_argument("--scans", type=int, default=8, help="scans per arena, with --near")
    parser.add_argument("--edges", nargs="+", type=float, default=EDGES, help="of the distance bins [m]")
    args = parser.parse_intermixed_args()
    check_edges("--edges", args.edges)
    defaults = ["mode=evaluate", "sensor=camera", "split=val", "output=runs/fitted"]
    s = compose(NavigateSettings, [*defaults, *args.settings])
    assert isinstance(s, NavigateEvaluateSettings)
    choose_resources(device="cpu", precision="fp32", **s.runtime)
    sensor = instantiate(s.sensor, "sensor")
    arenas = [arena for density in listed(s.density) for arena in arenas_of(s, density)]
    if args.near:
        scans = scan_near(arenas, sensor, scans=args.scans, seed=s.seed)
    else:
        scans = scan_along(arenas, sensor, Navigator.load(), episode_settings(s))
    note = {"sensor": s.sensor, "density": s.density, "near": args.near}
    note |= {name: environment()[name] for name in ("date", "git", "versions", "command")}
    errors = fit_errors(scans, args.edges, split=s.split, arenas=len(arenas), **note)
    path = Path(s.output) / "range_errors.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    errors.write(path)
    print(f"errors of the nearest range per sector (natural logarithm), and the bias per column: {path}")
    titles = ("true range [m]", "scans", "bias", "spread", "missed", "ghosts", "column bias")
    print("".join(f"{title:>16}" for title in titles))
    for row, bias in zip(errors.sectors, errors.bias, strict=True):
        values = [row.get(name, math.nan) for name in ("bias", "spread", "missed", "ghost")]
        shown = [f"{row['from']} to {row['to']}", f"{row['count']:.0f}"]
        shown += [f"{value:.3f}" for value in (*values, bias)]
        print("".join(f"{value:>16}" for value in shown))


if __name__ == "__main__":
    main()

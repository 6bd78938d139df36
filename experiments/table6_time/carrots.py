"""Tune the carrot of A* on "val" arenas, and compare times with the tuned planners on "test" arenas.

python experiments/table6_time/carrots.py    reads stored episodes and measures those that are missing

The rule is the one that chose the driver's ``slows_within``: the shortest time at the same success. Here:
among the carrots whose success at 80 obstacles is at most one arena below the best, the one with the least
mean time over the arenas that all of these solved.
"""

import math
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402

from eldenet.evaluation.bootstrap import bootstrap_interval  # noqa: E402
from eldenet.navigation.episodes import EpisodeSettings  # noqa: E402
from eldenet.navigation.evaluation import (  # noqa: E402
    Episode,
    read_episodes,
    run_episodes,
    solved_by_all,
    summarize,
    write_episodes,
)
from eldenet.navigation.planners.astar import AStarDWA, AStarOnlineDWA  # noqa: E402
from eldenet.navigation.planners.dwa import DWA_VERSION  # noqa: E402
from eldenet.navigation.policy import Navigator  # noqa: E402
from eldenet.navigation.provenance import EPISODE_VERSION  # noqa: E402
from eldenet.navigation.sensors import Ranges  # noqa: E402
from eldenet.navigation.tasks import frozen_arenas  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402

HERE = Path(__file__).parent
PLANNERS: Mapping[str, type[Any]] = {"astar_dwa": AStarDWA, "astar_online_dwa": AStarOnlineDWA}
CARROTS = (1.0, 1.3, 1.6, 2.0, 2.5)  # [m]
DENSITIES = (5, 20, 40, 80)
VERSION = f"{EPISODE_VERSION}.{DWA_VERSION}"
LABELS = ("split", "density", "method", "carrot", "version")

# (split, density, method, carrot) -> episodes by arena; the learned driver's carrot is 0
Rows = dict[tuple[str, int, str, float], list[Episode]]


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--val-worlds", type=int, default=40, help="arenas that choose the carrot")
    parser.add_argument("--worlds", type=int, default=60, help="test arenas per density")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    rows = read(folder / "carrots.csv")
    for carrot in CARROTS:
        for method in PLANNERS:
            measure(rows, ("val", 80, method, carrot), args.val_worlds, folder)
    for density in reversed(DENSITIES):
        for method in PLANNERS:
            measure(rows, ("test", density, method, tuned(rows, method)), args.worlds, folder)
        measure(rows, ("test", density, "dqn_ensemble", 0.0), args.worlds, folder)


def measure(rows: Rows, key: tuple[str, int, str, float], worlds: int, folder: Path) -> None:
    """Measure a row unless it is stored, and store it."""
    if len(rows.setdefault(key, [])) < worlds:
        split, density, method, carrot = key
        # nothing is drawn with true ranges: an episode is the same whichever are run beside it
        arenas = frozen_arenas(density, worlds, split=split)[len(rows[key]) :]
        rows[key] = rows[key] + run_episodes(
            arenas, driver(method, carrot), Ranges(), EpisodeSettings("wheels")
        )
        print(*key, summarize(rows[key])["success"], flush=True)
        write(folder, rows)


def driver(method: str, carrot: float) -> Callable[[int], Any]:
    """Return number of robots -> driver."""
    if method in PLANNERS:
        return lambda robots: PLANNERS[method](carrot=carrot, robots=robots)
    return lambda robots: Navigator.load(slows_within=1.0, robots=robots)


def tuned(rows: Rows, method: str) -> float:
    """Return the carrot that the rule chooses [m]."""
    of = {
        carrot: rows["val", 80, method, carrot] for carrot in CARROTS if rows.get(("val", 80, method, carrot))
    }
    solved = {carrot: sum(row.outcome == "success" for row in episodes) for carrot, episodes in of.items()}
    safe = [carrot for carrot in of if solved[carrot] >= max(solved.values()) - 1]
    common = solved_by_all([of[carrot] for carrot in safe])
    return min(safe, key=lambda carrot: np.array([row.seconds for row in of[carrot]])[common].mean())


def ratio(ours: Sequence[Episode], reference: Sequence[Episode]) -> str:
    """Return the mean time over the reference's on the arenas that both solved, with its 95 % interval."""
    both = solved_by_all([ours, reference])
    times = np.array([[row.seconds for row in rows] for rows in (ours, reference)])

    def of(worlds: np.ndarray) -> float:
        mask = both[worlds]
        first, second = times[:, worlds][:, mask].sum(axis=1) if mask.any() else (math.nan, math.nan)
        return float(first / second)

    low, high = bootstrap_interval(of, len(both))
    return f"{of(np.arange(len(both))):.2f} [{low:.2f}, {high:.2f}]"


def read(file: Path) -> Rows:
    """Return the stored rows whose version is today's."""
    return {
        (split, int(density), method, float(carrot)): episodes
        for (split, density, method, carrot, version), episodes in read_episodes(file, LABELS).items()
        if version == VERSION
    }


def write(folder: Path, rows: Rows) -> None:
    """Write every episode to ``carrots.csv`` and the tables to ``carrots.md``."""
    labeled = {(*key, VERSION): episodes for key, episodes in rows.items()}
    write_episodes(folder / "carrots.csv", LABELS, labeled)
    text = ["# A* with a tuned carrot", "", f"True ranges, wheels, goal known. {environment()['date']}.", ""]
    text += [*val_lines(rows), ""]
    text += [*test_lines(rows), "", "Made by `python experiments/table6_time/carrots.py`."]
    (folder / "carrots.md").write_text("\n".join(text) + "\n")


def val_lines(rows: Rows) -> list[str]:
    """Return the table of the carrots on "val" arenas."""
    out = ['## "val" arenas with 80 obstacles', "", "| method | carrot [m] | arenas | success | time [s] |"]
    out.append("|---|---:|---:|---:|---:|")
    for method in PLANNERS:
        of = {key[3]: rows[key] for key in rows if key[0] == "val" and key[2] == method and rows[key]}
        if not of:
            continue
        common = solved_by_all(list(of.values()))
        for carrot in sorted(of):
            s = summarize(of[carrot])
            seconds = np.array([row.seconds for row in of[carrot]])[common].mean()
            chosen = " (chosen)" if len(of) == len(CARROTS) and carrot == tuned(rows, method) else ""
            rate = f"{s['success']:.1f} ({s['success_low']:.0f} to {s['success_high']:.0f})"
            out.append(f"| `{method}` | {carrot}{chosen} | {len(of[carrot])} | {rate} | {seconds:.1f} |")
    note = "Times are means over the arenas that the planner solved with every carrot. The choice compares "
    note += "the carrots that lose at most one arena to the best, on the arenas that all of these solved."
    return [*out, "", note]


def test_lines(rows: Rows) -> list[str]:
    """Return the table of the tuned planners and the learned driver on "test" arenas."""
    out = [
        '## "test" arenas',
        "",
        "| obstacles | method | carrot [m] | arenas | success | time over `astar_dwa`'s |",
    ]
    out.append("|---:|---|---:|---:|---:|---:|")
    for density in DENSITIES:
        of = {key: rows[key] for key in rows if key[:2] == ("test", density) and rows[key]}
        reference = next((of[key] for key in of if key[2] == "astar_dwa"), None)
        for (_, _, method, carrot), episodes in sorted(of.items()):
            s = summarize(episodes)
            rate = f"{s['success']:.1f} ({s['success_low']:.0f} to {s['success_high']:.0f})"
            shown = (
                "-" if reference is None or len(reference) != len(episodes) else ratio(episodes, reference)
            )
            out.append(f"| {density} | `{method}` | {carrot or '-'} | {len(episodes)} | {rate} | {shown} |")
    return [*out, "", "Ratios: over the arenas that both solved, with paired 95 % bootstrap intervals."]


if __name__ == "__main__":
    main(sys.argv[1:])

"""Tune the look-ahead distance ("carrot") of the planners on "val" arenas with 80 obstacles.

python experiments/table6_time/carrots.py    reads stored episodes and measures those that are missing

The rule is the one that chose the driver's ``slows_within``: the shortest time at the same success. Here:
among the carrots whose success is at most one point below the best, the one with the least mean time over
the arenas that all of these solved.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "table5_success"))

import numpy as np  # noqa: E402
import torch  # noqa: E402
from episodes import read_episodes, solved_by_all, write_episodes  # noqa: E402
from methods import PLANNERS  # noqa: E402

from eldenet.navigation.episodes import EpisodeSettings  # noqa: E402
from eldenet.navigation.evaluation import Episode, run_episodes, summarize  # noqa: E402
from eldenet.navigation.planners.dwa import DWA_VERSION  # noqa: E402
from eldenet.navigation.provenance import EPISODE_VERSION  # noqa: E402
from eldenet.navigation.sensors import Ranges  # noqa: E402
from eldenet.navigation.tasks import frozen_arenas  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402

ON_A_PATH, TOWARD_GOAL = (1.0, 1.3, 1.6, 2.0, 2.5, 3.0), (1.3, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0)
CARROTS = {  # that are tried [m]
    "astar_dwa": ON_A_PATH,
    "astar_online_dwa": ON_A_PATH,
    "dwa": TOWARD_GOAL,
    "dwa, 5 sectors, no memory": TOWARD_GOAL,
}
VERSION = f"{EPISODE_VERSION}.{DWA_VERSION}"
LABELS = ("method", "carrot", "version")

# (method, carrot) -> episodes by arena
Rows = dict[tuple[str, float], list[Episode]]


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=200, help="val arenas")
    parser.add_argument("--methods", default=";".join(CARROTS), help="separated by semicolons")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    rows = read(folder / "carrots.csv.xz")
    arenas = frozen_arenas(80, args.worlds, split="val")
    for method in args.methods.split(";"):
        for carrot in CARROTS[method]:
            if len(rows.get((method, carrot), [])) < args.worlds:
                rows[method, carrot] = run_episodes(
                    arenas,
                    lambda robots, method=method, carrot=carrot: PLANNERS[method](
                        carrot=carrot, robots=robots
                    ),
                    Ranges(),
                    EpisodeSettings("wheels"),
                )
                print(method, carrot, summarize(rows[method, carrot])["success"], flush=True)
                write(folder, rows)
    write(folder, rows)


def tuned(rows: Rows, method: str) -> float:
    """Return the carrot that the rule chooses [m]."""
    of = {carrot: rows[method, carrot] for carrot in CARROTS[method] if (method, carrot) in rows}
    success = {carrot: summarize(episodes)["success"] for carrot, episodes in of.items()}
    best = [carrot for carrot in of if success[carrot] >= max(success.values()) - 1]
    common = solved_by_all([of[carrot] for carrot in best])
    return min(best, key=lambda carrot: np.array([row.seconds for row in of[carrot]])[common].mean())


def read(file: Path) -> Rows:
    """Return the stored rows whose version is today's."""
    return {
        (method, float(carrot)): episodes
        for (method, carrot, version), episodes in read_episodes(file, LABELS).items()
        if version == VERSION
    }


def write(folder: Path, rows: Rows) -> None:
    """Write every episode to ``carrots.csv.xz`` and the table to ``carrots.md``."""
    labeled = {(*key, VERSION): episodes for key, episodes in rows.items()}
    write_episodes(folder / "carrots.csv.xz", LABELS, labeled)
    text = [
        "# Look-ahead distance of the planners",
        "",
        '"val" arenas with 80 obstacles, true ranges, wheels, goal known. Success [%] with Wilson\'s 95 % '
        "interval; times are means over the arenas that the planner solved with every carrot. The choice "
        "compares the carrots whose success is at most one point below the best, on the arenas that all of "
        f"these solved. {environment()['date']}.",
        "",
        "| method | carrot [m] | arenas | success | time [s] |",
        "|---|---:|---:|---:|---:|",
        *(line for method in CARROTS for line in lines_of(rows, method)),
        "",
        "Made by `python experiments/table6_time/carrots.py`.",
    ]
    (folder / "carrots.md").write_text("\n".join(text) + "\n")


def lines_of(rows: Rows, method: str) -> list[str]:
    """Return a planner's lines of the table."""
    of = {carrot: rows[method, carrot] for carrot in CARROTS[method] if (method, carrot) in rows}
    common = solved_by_all(list(of.values())) if of else np.array([])
    lines = []
    for carrot, episodes in of.items():
        s = summarize(episodes)
        seconds = np.array([row.seconds for row in episodes])[common].mean()
        chosen = " (chosen)" if len(of) == len(CARROTS[method]) and carrot == tuned(rows, method) else ""
        rate = f"{s['success']:.1f} ({s['success_low']:.0f} to {s['success_high']:.0f})"
        lines.append(f"| `{method}` | {carrot}{chosen} | {len(episodes)} | {rate} | {seconds:.1f} |")
    return lines


if __name__ == "__main__":
    main(sys.argv[1:])

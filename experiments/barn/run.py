"""Drive through the 300 public worlds of BARN.

python experiments/barn/run.py --worlds-file $ELDENET_DATA/barn/barn_worlds.npz

Stored drives are read and those that are missing measured, 30 worlds at a time: first every fifth world, then
those after them, so that a part of them is an even sample.
"""

import os
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402

from eldenet.navigation.episodes import EpisodeSettings  # noqa: E402
from eldenet.navigation.evaluation import Episode, run_episodes, summarize  # noqa: E402
from eldenet.navigation.planners.astar import CARROT, AStarDWA  # noqa: E402
from eldenet.navigation.planners.dwa import DWA_VERSION  # noqa: E402
from eldenet.navigation.planners.plan_and_steer import HEEDS_VERSION, STEER_VERSION, PlanAndSteer  # noqa: E402
from eldenet.navigation.policy import Navigator  # noqa: E402
from eldenet.navigation.provenance import EPISODE_VERSION  # noqa: E402
from eldenet.navigation.sensors import Ranges  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.simulation.barn import BarnWorld, read_barn  # noqa: E402

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "table5_success"))
from episodes import read_episodes, write_episodes  # noqa: E402

TIME_LIMIT = 100.0  # the benchmark's [s]
PART = 30  # worlds between two writings
EVERY = 5  # world that is driven first
METHODS: Mapping[str, Callable[[int], Any]] = {
    "astar_online_dqn": lambda robots: PlanAndSteer(slows_within=1.0, robots=robots),
    "dqn_ensemble": lambda robots: Navigator.load(slows_within=1.0, robots=robots),
    "astar_dwa": lambda robots: AStarDWA(robots=robots),
}
VERSIONS = {
    "astar_online_dqn": f"{EPISODE_VERSION}.{DWA_VERSION}.{STEER_VERSION}.{HEEDS_VERSION}",
    "dqn_ensemble": str(EPISODE_VERSION),
    "astar_dwa": f"{EPISODE_VERSION}.{DWA_VERSION}.{CARROT}",
}
LABELS = ("method", "size", "view", "speed", "version")
Rows = dict[tuple[str, str, str, str], list[Episode]]


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    default = Path(os.environ.get("ELDENET_DATA", "data")) / "barn" / "barn_worlds.npz"
    parser.add_argument("--worlds-file", type=Path, default=default)
    parser.add_argument("--worlds", type=int, default=300)
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--sizes", default="0.85,1.0", help="of the robot; 0.85 is about a Jackal's")
    parser.add_argument("--views", default="69.4,270", help="of the sensor [degrees]; 270 is the benchmark's")
    parser.add_argument("--speeds", default="1", help="greatest of the robot [m/s]; 2 is the benchmark's")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    worlds = read_barn(args.worlds_file)
    rows = read(folder / "drives.csv.xz")
    lists = args.speeds, args.views, args.sizes, args.methods
    for speed, view, size, method in product(*(given.split(",") for given in lists)):
        done = rows.setdefault((method, size, view, speed), [])
        settings = EpisodeSettings(
            "wheels", time_limit=TIME_LIMIT, robot_size=float(size), robot_speed=float(speed)
        )
        order = sorted(range(len(worlds)), key=lambda number: (number % EVERY, number))[: args.worlds]
        missing = [number for number in order if number not in {number_of(drive) for drive in done}]
        for first in range(0, len(missing), PART):
            part = missing[first : first + PART]
            arenas = [worlds[number].arena for number in part]
            sensor = Ranges(view=float(view))
            done += run_episodes(arenas, METHODS[method], sensor, settings, robots=PART)
            done.sort(key=number_of)
            write(folder, rows, worlds)
            print(line((method, size, view, speed), done, worlds), flush=True)
    write(folder, rows, worlds)


def read(file: Path) -> Rows:
    """Return the stored drives of today's versions."""
    return {
        (method, size, view, speed): drives
        for (method, size, view, speed, version), drives in read_episodes(file, LABELS).items()
        if version == VERSIONS.get(method)
    }


def number_of(drive: Episode) -> int:
    """Return the number of a drive's world."""
    return int(drive.world.rpartition("-")[2])


def line(key: tuple[str, ...], drives: Sequence[Episode], worlds: Sequence[BarnWorld]) -> str:
    """Return a line of the table: method, size, view, speed and what its drives reached."""
    s = summarize(drives)
    times = {number_of(drive): drive.seconds if drive.outcome == "success" else None for drive in drives}
    now, before = (
        np.mean([worlds[number].score(time, least=least) for number, time in times.items()])
        for least in (2.0, 4.0)
    )
    success = sum(drive.outcome == "success" for drive in drives)
    cells = [f"{success} of {len(drives)}", f"{s['success_low']:.1f} to {s['success_high']:.1f}"]
    cells += [f"{s['collision']:.1f}", f"{s['timeout']:.1f}", f"{s['seconds']:.1f}"]
    return f"| {' | '.join([f'`{key[0]}`', *key[1:], *cells, f'{now:.3f}', f'{before:.3f}'])} |"


def write(folder: Path, rows: Rows, worlds: Sequence[BarnWorld]) -> None:
    """Write every drive to ``drives.csv.xz`` and the table to ``results.md``."""
    rows = {key: drives for key, drives in sorted(rows.items()) if drives}
    labeled = {(*key, VERSIONS[key[0]]): drives for key, drives in rows.items()}
    write_episodes(folder / "drives.csv.xz", LABELS, labeled)
    text = [
        "# BARN's public worlds",
        "",
        f"True ranges, wheels, goal known; {environment()['date']}.",
        "",
        "| method | robot size | view [degrees] | speed [m/s] | arrived | 95 % [%] | collisions [%] |"
        " time-outs [%] | time [s] | score (2 times) | score (4 times) |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
        *(line(key, drives, worlds) for key, drives in rows.items()),
        "",
        "Made by `python experiments/barn/run.py`.",
    ]
    (folder / "results.md").write_text("\n".join(text) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])

"""Measure drivers in rooms and traps, with a delay, by wrong distances, and on another robot than they know.

python experiments/table5_robustness/conditions.py    reads stored rows and measures those that are missing

All methods cross the same test arenas; a command that was stopped goes on with the row where it stopped.
"""

import math
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eldenet.system.resources import prepare_environment

prepare_environment()

import torch  # noqa: E402

from eldenet.navigation.episodes import EpisodeSettings  # noqa: E402
from eldenet.navigation.evaluation import Episode, run_episodes, summarize  # noqa: E402
from eldenet.navigation.latency import Predictive  # noqa: E402
from eldenet.navigation.planners.astar import CARROT, AStarDWA, AStarOnlineDWA  # noqa: E402
from eldenet.navigation.planners.dwa import DWA_VERSION  # noqa: E402
from eldenet.navigation.planners.plan_and_steer import HEEDS_VERSION, STEER_VERSION, PlanAndSteer  # noqa: E402
from eldenet.navigation.policy import Navigator  # noqa: E402
from eldenet.navigation.provenance import EPISODE_VERSION  # noqa: E402
from eldenet.navigation.range_scale import SCALE_VERSION  # noqa: E402
from eldenet.navigation.sensors import Ranges  # noqa: E402
from eldenet.navigation.tasks import frozen_arenas  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "table5_success"))
from episodes import mcnemar, read_episodes, write_episodes  # noqa: E402

FRESH = 500  # index of the first test arena that no driver had crossed before


@dataclass(frozen=True)
class Condition:
    """Where and how the robot drives.

    Attributes:
        kind: of the arenas.
        density: their number of obstacles.
        first: index of the first arena.
        sensor: options of the sensor.
        robot: options of the episodes.
        predicted: latency that the driver is told [s].
    """

    kind: str = "open"
    density: int = 80
    first: int = 0
    sensor: Mapping[str, Any] = field(default_factory=dict)
    robot: Mapping[str, float] = field(default_factory=dict)
    predicted: float = 0.0


CONDITIONS: Mapping[str, Condition] = {
    "80 obstacles": Condition(),
    "40 obstacles": Condition(density=40),
    "20 obstacles": Condition(density=20),
    "5 obstacles": Condition(density=5),
    "rooms": Condition("rooms", 10),
    # arenas of no other row
    "80 obstacles, fresh": Condition(first=FRESH),
    "rooms, fresh": Condition("rooms", 10, first=FRESH),
    "traps": Condition("traps", 10),
    "office": Condition("office", 10, robot={"time_limit": 120.0}),
    "maze": Condition("maze", 0, robot={"time_limit": 120.0}),
    "corridor": Condition("corridor", 0, robot={"time_limit": 120.0}),
    "latency 0.2 s": Condition(sensor={"latency": 0.2}),
    "latency 0.2 s, predicted": Condition(sensor={"latency": 0.2}, predicted=0.2),
    "latency 0.4 s": Condition(sensor={"latency": 0.4}),
    "latency 0.4 s, predicted": Condition(sensor={"latency": 0.4}, predicted=0.4),
    # what a guess costs
    "latency 0.4 s, 0.2 s guessed": Condition(sensor={"latency": 0.4}, predicted=0.2),
    "no latency, 0.2 s guessed": Condition(predicted=0.2),
    "heading drift 4 degrees/m": Condition(sensor={"drift": {"distance": 0.0, "heading": math.radians(4)}}),
    "ranges 15 % too short": Condition(sensor={"factor": 0.85}),
    "ranges 15 % too short, corrected": Condition(sensor={"factor": 0.85}, robot={"range_scale": True}),
    "ranges 15 % too long": Condition(sensor={"factor": 1.15}),
    "ranges 15 % too long, corrected": Condition(sensor={"factor": 1.15}, robot={"range_scale": True}),
    # what correcting may break
    "true ranges, corrected": Condition(robot={"range_scale": True}),
    "drifting heading, corrected": Condition(
        sensor={"drift": {"distance": 0.0, "heading": math.radians(4)}}, robot={"range_scale": True}
    ),
    "sliding wheels, corrected": Condition(robot={"robot_friction": 0.15, "range_scale": True}),
    "camera sees 60 degrees": Condition(sensor={"view": 60.0}),
    "camera sees 50 degrees": Condition(sensor={"view": 50.0}),
    "5 % of the scans lost": Condition(sensor={"lost": 0.05}),
    "slippery floor": Condition(robot={"robot_friction": 0.15}),
    "speed x 0.8": Condition(robot={"robot_speed": 0.8}),
    "speed x 1.2": Condition(robot={"robot_speed": 1.2}),
    "size x 0.85": Condition(robot={"robot_size": 0.85}),
    "size x 1.15": Condition(robot={"robot_size": 1.15}),
}
# condition -> the same with its remedy
REMEDIES: Mapping[str, str] = {
    name: f"{name}, {remedy}"
    for name in CONDITIONS
    for remedy in ("predicted", "corrected")
    if f"{name}, {remedy}" in CONDITIONS
}
# trained with training.randomize, see README.md
VARIED = HERE / "varied_dqn.safetensors"
# one training in rooms, see README.md
IN_ROOMS = HERE / "rooms_dqn.safetensors"
METHODS: Mapping[str, Callable[[int], Any]] = {
    "dqn_ensemble": lambda robots: Navigator.load(slows_within=1.0, robots=robots),
    "astar_online_dqn": lambda robots: PlanAndSteer(slows_within=1.0, heeds_unseen=False, robots=robots),
    "astar_online_dqn, heeds unseen": lambda robots: PlanAndSteer(slows_within=1.0, robots=robots),
    "varied_dqn": lambda robots: Navigator.load(VARIED, slows_within=1.0, robots=robots),
    "rooms_dqn": lambda robots: Navigator.load(IN_ROOMS, slows_within=1.0, robots=robots),
    "astar_online_dqn, rooms_dqn": lambda robots: PlanAndSteer(
        IN_ROOMS, slows_within=1.0, heeds_unseen=False, robots=robots
    ),
    "astar_online_dwa": lambda robots: AStarOnlineDWA(robots=robots),
    "astar_dwa": lambda robots: AStarDWA(robots=robots),
}
DEFAULT_METHODS = ("dqn_ensemble", "astar_online_dqn", "astar_online_dwa", "varied_dqn")
VERSIONS = {
    "dqn_ensemble": str(EPISODE_VERSION),
    "astar_online_dqn": f"{EPISODE_VERSION}.{DWA_VERSION}.{STEER_VERSION}",
    "astar_online_dqn, heeds unseen": f"{EPISODE_VERSION}.{DWA_VERSION}.{STEER_VERSION}.{HEEDS_VERSION}",
    "varied_dqn": str(EPISODE_VERSION),
    "rooms_dqn": str(EPISODE_VERSION),
    "astar_online_dqn, rooms_dqn": f"{EPISODE_VERSION}.{DWA_VERSION}.{STEER_VERSION}",
    "astar_online_dwa": f"{EPISODE_VERSION}.{DWA_VERSION}.{CARROT}",
    "astar_dwa": f"{EPISODE_VERSION}.{DWA_VERSION}.{CARROT}",
}
LABELS = ("method", "condition", "version")

# (method, condition) -> episodes by arena
Rows = dict[tuple[str, str], list[Episode]]


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=60, help="test arenas")
    parser.add_argument("--methods", default=";".join(DEFAULT_METHODS), help="separated by semicolons")
    parser.add_argument("--conditions", default=";".join(CONDITIONS), help="separated by semicolons")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    stored = read(folder / "conditions.csv.xz")
    for name in args.conditions.split(";"):
        condition = CONDITIONS[name]
        count = condition.first + args.worlds
        arenas = frozen_arenas(condition.density, count, kind=condition.kind)[condition.first :]
        for method in args.methods.split(";"):
            rows = stored.setdefault((method, name), [])
            if len(rows) >= args.worlds:
                continue
            settings = EpisodeSettings("wheels", **condition.robot)  # type: ignore[arg-type]
            rows[:] = run_episodes(arenas, driver(method, condition), Ranges(**condition.sensor), settings)
            write(folder, stored)
            solved = sum(row.outcome == "success" for row in rows)
            print(f"{method}, {name}: {solved} of {len(rows)}", flush=True)
    write(folder, stored)


def driver(method: str, condition: Condition) -> Callable[[int], Any]:
    """Return number of robots -> driver."""
    if not condition.predicted:
        return METHODS[method]
    return lambda robots: Predictive(METHODS[method](robots), condition.predicted, robots)


def made_with(method: str, condition: str) -> str:
    """Version of what an episode depends on."""
    corrected = "range_scale" in CONDITIONS[condition].robot
    return f"{VERSIONS[method]}.{SCALE_VERSION}" if corrected else VERSIONS[method]


def read(file: Path) -> Rows:
    """Return the stored rows whose version is today's."""
    return {
        (method, condition): episodes
        for (method, condition, version), episodes in read_episodes(file, LABELS).items()
        if version == made_with(method, condition)
    }


def write(folder: Path, rows: Rows) -> None:
    """Write every episode to ``conditions.csv.xz`` and the table to ``conditions.md``."""
    made = {
        (method, name): rows[method, name]
        for name in CONDITIONS
        for method in METHODS
        if rows.get((method, name))
    }
    labeled = {(*key, made_with(*key)): episodes for key, episodes in made.items()}
    write_episodes(folder / "conditions.csv.xz", LABELS, labeled)
    text = [
        "# Rooms, traps, delay, wrong distances and other robots",
        "",
        f"Success [%] with Wilson's 95 % interval on the first test arenas (fresh: from {FRESH} on); true "
        "ranges, wheels, goal known, 80 obstacles unless the row names others. "
        f"{environment()['date']}. The last column counts arenas that only `dqn_ensemble` and only the "
        "method of the row solved, and McNemar's p-value.",
        "",
        "| condition | method | arenas | success | collisions | time-outs | time of successes [s] | SPL |"
        " only `dqn_ensemble` : only it |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
        *(line_of(*key, episodes, made.get(("dqn_ensemble", key[1]))) for key, episodes in made.items()),
        "",
        "Made by `python experiments/table5_robustness/conditions.py`.",
    ]
    (folder / "conditions.md").write_text("\n".join(text) + "\n")


def line_of(method: str, name: str, episodes: Sequence[Episode], learned: Sequence[Episode] | None) -> str:
    """Return a line of the table."""
    s = summarize(episodes)
    cells = [f"{s['success']:.1f} ({s['success_low']:.0f} to {s['success_high']:.0f})"]
    cells += [f"{s['collision']:.1f}", f"{s['timeout']:.1f}", f"{s['seconds']:.1f}", f"{s['spl']:.3f}"]
    paired = "-"
    if method != "dqn_ensemble" and learned:
        count = min(len(learned), len(episodes))
        first, second = ([row.outcome == "success" for row in rows[:count]] for rows in (learned, episodes))
        only_learned, only_it, p = mcnemar(first, second)
        paired = f"{only_learned} : {only_it} (p = {p:.2g})"
    return f"| {name} | `{method}` | {len(episodes)} | {' | '.join(cells)} | {paired} |"


if __name__ == "__main__":
    main(sys.argv[1:])

"""One row of the navigation tables: a method, a density, a sensor, a physics -> one CSV, made once."""

import csv
import functools
import json
import shutil
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inputs import CAMERAS, TRUTH, check_inputs, digest, input_hashes, make_sensor, training_of

from eldenet.navigation.crossings import GOALS
from eldenet.navigation.evaluation import Crossing, as_rows, cross
from eldenet.navigation.planners.astar import AStarDWA, AStarOnlineDWA
from eldenet.navigation.planners.dwa import LocalDWA
from eldenet.navigation.planners.straight import Straight
from eldenet.navigation.policy import DEFAULT_WEIGHTS, Navigator
from eldenet.navigation.sources import crossing_hash
from eldenet.navigation.tasks import frozen_arenas
from eldenet.record import environment, write_json, write_rows
from eldenet.simulation.arenas import Arena, arenas_hash

HERE = Path(__file__).parent
COURSES = ((5, 0), (20, 0), (40, 0), (80, 0), (20, 10))  # standing obstacles, people who walk
SENSORS = ("ranges", "noisy", "camera", "objects")
LEARNT = {  # name -> what to train it with
    "paper_literal": ["policy=paper_literal"],
    "paper_state": ["policy=paper_state"],
    "dqn": [],
    "dqn_ensemble": [],  # the packaged policy: three of dqn's trainings drive together
    "dqn_as_trained": [],  # dqn's trainings slow down 3 m before the goal, not 1 m
    "dqn_follows": [],  # dqn's trainings, told to follow what moves
    "dqn_ensemble_follows": [],
    "dqn_walkers": ["movers=10", "observer.walkers=true"],
    "dqn_mixed": ["sensor=mixed"],  # half of the crossings with a depth network's measured errors
    "dqn_by_age": ["observer.seen_through=0"],  # remembered points are forgotten with age alone
    "dqn_reverse": [  # beside the five turns: on the spot to either side, and straight back
        "observer.turn_rates=[1.2,0.5,0.0,-0.5,-1.2,1.2,-1.2,0.0]",
        "observer.turn_factors=[0.35,0.75,1.0,0.75,0.35,0.0,0.0,-0.4]",
    ],
    "dqn_curriculum": ["training.arenas.curriculum=0.5"],
    "dqn_quantile": ["learner.quantiles=16"],
}
VARIANTS = ("dqn_reverse", "dqn_curriculum", "dqn_quantile")  # asked for by name alone
PACKAGED = ("dqn_ensemble", "dqn_ensemble_follows")
SLOWS_WITHIN = 1.0  # [m] of the goal: how all drive but these, which do it as they were trained
AS_TRAINED = ("paper_literal", "paper_state", "dqn_as_trained")
PLANNERS = {
    "astar_dwa": lambda robots: AStarDWA(robots=robots),
    "astar_online_dwa": lambda robots: AStarOnlineDWA(robots=robots),
    "dwa": lambda robots: LocalDWA(robots=robots),
    "dwa, 5 sectors, no memory": lambda robots: LocalDWA(sight="sectors", memory=0, robots=robots),
    "straight": lambda robots: Straight(robots=robots),
}


@dataclass(frozen=True)
class Row:
    """What is measured.

    Attributes:
        method: a name of LEARNT or PLANNERS.
        density: standing obstacles.
        movers: people who walk.
        sensor: "ranges", "noisy", "camera" or "objects"; "camera@0.1" in that share of a normal day's light.
        physics: "wheels" or "kinematic".
        worlds: how many arenas.
        seed: of the training; None for planners.
        goal: "known" or "odometry".
    """

    method: str
    density: int
    movers: int
    sensor: str
    physics: str
    worlds: int
    seed: int | None = None
    goal: str = "known"

    @property
    def course(self) -> str:
        """Name of its arenas: "20+10" are 20 obstacles and 10 people."""
        return course_name(self.density, self.movers)

    @property
    def name(self) -> str:
        """Of its files."""
        method = self.method.replace(", ", "-").replace(" ", "_")
        seed = "" if self.seed is None else f"-seed{self.seed}"
        goal = "" if self.goal == "known" else f"-goal_{self.goal}"
        return f"{method}{seed}-{self.sensor}{goal}-{self.physics}-{self.course}-{self.worlds}"


def course_name(density: int, movers: int) -> str:
    """As tables write it."""
    return f"{density}+{movers}" if movers else str(density)


def arguments(
    methods: Sequence[str] = tuple(name for name in (*LEARNT, *PLANNERS) if name not in VARIANTS),
) -> Namespace:
    """What both tables' commands take; ``methods`` are those of the default."""
    parser = ArgumentParser()
    parser.add_argument("--worlds", type=int, default=500, help="test arenas per density")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of every learnt method")
    parser.add_argument("--methods", default=",,".join(methods), help="names, separated by ,,")
    parser.add_argument(
        "--sensors",
        default="ranges",
        help="of ranges, noisy, camera, objects; camera@0.1: in a tenth of the light",
    )
    parser.add_argument("--physics", default="wheels")
    parser.add_argument("--courses", default=",".join(course_name(*course) for course in COURSES))
    parser.add_argument("--goal", default="known", choices=GOALS, help="where the goal's place is taken from")
    parser.add_argument("--depth", help=f"network of camera and objects: folder or file; or {TRUTH}")
    parser.add_argument("--detector", help=f"of objects: an .onnx file; or {TRUTH}, an ideal one")
    parser.add_argument("--errors", default="packaged", help="range_errors.json of sensor noisy")
    parser.add_argument("--any-sources", action="store_true", help="take trainings that other sources made")
    parser.add_argument(
        "--recheck",
        type=int,
        default=0,
        metavar="N",
        help="keep a row that other sources made if its first N crossings come out the same, bit for bit",
    )
    parser.add_argument("--out", help="name of the results; default: results-<worlds>")
    parser.add_argument("--runs", type=Path, default=Path("runs/table5"), help="where trainings go")
    parser.add_argument("--rows", type=Path, default=HERE / "rows", help="where rows are kept")
    return parser.parse_args()


def results_name(given: Namespace) -> str:
    """Of a table's files, without their endings."""
    goal = "" if given.goal == "known" else f"-goal-{given.goal}"
    return str(given.out or f"results-{given.worlds}{goal}")


def refuse_to_drop(path: Path, asked: Iterable[Sequence[str]]) -> None:
    """A part of a table must not replace the whole.

    Args:
        path: of the table's CSV.
        asked: first columns of every row that the command will write.

    Raises:
        ValueError: the file holds rows that were not asked for.
    """
    if not path.is_file():
        return
    asked = {tuple(row) for row in asked}
    width = len(next(iter(asked)))
    with path.open() as file:
        dropped = [row for row in list(csv.reader(file))[1:] if tuple(row[:width]) not in asked]
    if dropped:
        raise ValueError(
            f"{path} holds {len(dropped)} rows that this command does not ask for, such as "
            f"{', '.join(dropped[0][:width])}: ask for them too (they are not made twice), or give --out"
        )


def without_nan(row: Sequence[Any]) -> list[Any]:
    """For a CSV: an empty field where there is no number."""
    return ["" if isinstance(value, float) and value != value else value for value in row]


def all_rows(given: Namespace) -> Iterator[Row]:
    """Every row that the command asks for.

    Raises:
        ValueError: a method, a sensor or a course that there is not, or something that a sensor needs.
    """
    methods, sensors, courses = given.methods.split(",,"), given.sensors.split(","), given.courses.split(",")
    known = {course_name(*course): course for course in COURSES}
    for kind, asked, there in (
        ("methods", methods, [*LEARNT, *PLANNERS]),
        ("sensors", [sensor.partition("@")[0] for sensor in sensors], SENSORS),
        ("courses", courses, known),
    ):
        if not set(asked) <= set(there):
            raise ValueError(f"--{kind}: {sorted(set(asked) - set(there))} is none of {', '.join(there)}")
    check_inputs(given, sensors)
    for physics in given.physics.split(","):
        for sensor in sensors:
            for method in methods:
                seeds = range(1 if method in PACKAGED else given.seeds)
                for seed in seeds if method in LEARNT else [None]:
                    for course in courses:
                        yield Row(method, *known[course], sensor, physics, given.worlds, seed, given.goal)


def policy_file(row: Row, given: Namespace) -> Path | None:
    """The trained policy of a row; it is trained now if it was not yet. None for planners.

    What rows rest on is kept beside them, in ``policies``: a table is rebuilt without its trainings' folders.
    """
    if row.seed is None:
        return None
    if row.method in PACKAGED:
        return DEFAULT_WEIGHTS
    method = "dqn" if row.method in ("dqn_follows", "dqn_as_trained") else row.method
    options = [*LEARNT[method], f"seed={row.seed}"]
    folder, kept = (at / f"{method}-{row.seed}" for at in (given.runs, given.rows.parent / "policies"))
    if not folder.is_dir() and kept.is_dir():
        return training_of(kept, options, any_sources=given.any_sources)
    policy = training_of(folder, options, any_sources=given.any_sources)
    kept.mkdir(parents=True, exist_ok=True)
    for name in (policy.name, "training.json"):
        shutil.copyfile(folder / name, kept / name)
    return policy


@functools.cache
def frozen(density: int, worlds: int, movers: int) -> tuple[Sequence[Arena], str]:
    """Test arenas, the same for every method and sensor, and their hash."""
    arenas = frozen_arenas(density, worlds, movers=movers)
    return arenas, arenas_hash(arenas)


def key_of(row: Row, given: Namespace, weights: Path | None, arenas: str) -> dict[str, Any]:
    """All that a row's crossings depend on: where any of it has changed, the row is made anew."""
    versions = environment()["versions"]
    return {
        "arenas": arenas,
        "sources": crossing_hash(camera=row.sensor.partition("@")[0] in CAMERAS),
        "versions": {name: versions[name] for name in ("mujoco", "numpy", "torch")},
        "policy": None if weights is None else digest([weights]),
        **input_hashes(row.sensor, given),
    }


def measure(row: Row, given: Namespace) -> list[Crossing]:
    """The crossings of a row: read, if nothing that they depend on has changed since, or made now.

    With ``--recheck`` a row that differs by its sources alone is read too, if some of it comes out the same.
    """
    arenas, found = frozen(row.density, row.worlds, row.movers)
    wanted = json.loads((HERE / "arenas.json").read_text()).get(str(row.worlds), {}).get(row.course)
    if wanted is not None and found != wanted:
        raise ValueError(f"the test arenas {row.course} are not those that were frozen (arenas.json)")
    weights = policy_file(row, given)
    key = key_of(row, given, weights, found)
    table, note = given.rows / f"{row.name}.csv", given.rows / f"{row.name}.json"
    if table.is_file() and note.is_file():
        kept = json.loads(note.read_text())
        if kept["key"] == key:
            return read_rows(table)
        if given.recheck and kept["key"] | {"sources": key["sources"]} == key:
            there = read_rows(table)
            if make_crossings(row, given, weights, arenas[: given.recheck]) == there[: given.recheck]:
                again = {"worlds": given.recheck, "made_by": kept["key"]["sources"]}
                write_json(note, kept | {"key": key, "rechecked": [*kept.get("rechecked", []), again]})
                print(f"{row.name}: the first {given.recheck} came out the same, kept", flush=True)
                return there
    started = time.process_time()
    crossings = make_crossings(row, given, weights, arenas)
    write_rows(table, *as_rows(crossings))
    spent = round(time.process_time() - started, 1)
    write_json(note, {"key": key, "cpu_seconds": spent, **environment()})
    solved = sum(crossing.outcome == "success" for crossing in crossings)
    print(f"{row.name}: {solved} of {len(crossings)}, {spent:.0f} s of processor time", flush=True)
    return crossings


def make_crossings(
    row: Row, given: Namespace, weights: Path | None, arenas: Sequence[Arena]
) -> list[Crossing]:
    """Cross arenas as the row says; an outcome does not depend on the other arenas."""
    options = {
        "walkers": True if row.method.endswith("follows") else None,
        "slows_within": None if row.method in AS_TRAINED else SLOWS_WITHIN,
    }
    make = PLANNERS.get(row.method, lambda robots: Navigator.load(weights, **options, robots=robots))
    return cross(arenas, make, make_sensor(row.sensor, given), physics=row.physics, goal=row.goal)


def read_rows(path: Path) -> list[Crossing]:
    """The crossings of a CSV."""
    with path.open() as file:
        return [
            Crossing(
                line["world"],
                int(line["density"]),
                line["outcome"],
                *(float(line[name]) for name in ("seconds", "travelled", "shortest")),
            )
            for line in csv.DictReader(file)
        ]

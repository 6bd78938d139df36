"""One row of the navigation tables: a method, a density, a sensor, a physics -> one CSV, made once."""

import csv
import hashlib
import json
import subprocess
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import eldenet
from eldenet.navigation.cameras import camera, objects
from eldenet.navigation.evaluation import Crossing, as_rows, cross
from eldenet.navigation.noise import NoisyRanges, errors_file
from eldenet.navigation.planners.astar import AStarDWA, AStarOnlineDWA
from eldenet.navigation.planners.dwa import LocalDWA
from eldenet.navigation.planners.straight import Straight
from eldenet.navigation.policy import DEFAULT_WEIGHTS, Navigator
from eldenet.navigation.sensors import Ranges, Sensor
from eldenet.navigation.tasks import frozen_arenas
from eldenet.record import environment, write_json, write_rows
from eldenet.simulation.arenas import Arena, arenas_hash

HERE = Path(__file__).parent
PACKAGE = Path(eldenet.__file__).parent
COURSES = ((5, 0), (20, 0), (40, 0), (80, 0), (20, 10))  # standing obstacles, people who walk
SENSORS = ("ranges", "noisy", "camera", "objects")
LEARNT = {  # name -> what to train it with
    "paper_literal": ["policy=paper_literal"],
    "paper_state": ["policy=paper_state"],
    "dqn": [],
    "dqn_follows": [],  # dqn's trainings, told to follow what moves
    "dqn_walkers": ["movers=10", "observer.walkers=true"],
    "dqn_noisy": ["sensor=noisy", "sensor.errors=packaged"],
}
PLANNERS = {
    "astar_dwa": lambda robots: AStarDWA(robots=robots),
    "astar_online_dwa": lambda robots: AStarOnlineDWA(robots=robots),
    "dwa": lambda robots: LocalDWA(robots=robots),
    "dwa, 5 sectors, no memory": lambda robots: LocalDWA(sight="sectors", memory=0, robots=robots),
    "straight": lambda robots: Straight(robots=robots),
}
#: Of eldenet/navigation, what no crossing rests on: drawing, counting, training (a policy has its own hash).
_NO_PART = ("dqn", "env", "failures", "film", "pictures", "registration", "statistics", "training")


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
    """

    method: str
    density: int
    movers: int
    sensor: str
    physics: str
    worlds: int
    seed: int | None = None

    @property
    def course(self) -> str:
        """Name of its arenas: "20+10" are 20 obstacles and 10 people."""
        return course_name(self.density, self.movers)

    @property
    def name(self) -> str:
        """Of its files."""
        method = self.method.replace(", ", "-").replace(" ", "_")
        seed = "" if self.seed is None else f"-seed{self.seed}"
        return f"{method}{seed}-{self.sensor}-{self.physics}-{self.course}-{self.worlds}"


def course_name(density: int, movers: int) -> str:
    """As tables write it."""
    return f"{density}+{movers}" if movers else str(density)


def arguments() -> Namespace:
    """What both tables' commands take."""
    parser = ArgumentParser()
    parser.add_argument("--worlds", type=int, default=500, help="test arenas per density")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of every learnt method")
    parser.add_argument("--methods", default=",,".join([*LEARNT, *PLANNERS]), help="names, separated by ,,")
    parser.add_argument(
        "--sensors",
        default="ranges",
        help="of ranges, noisy, camera, objects; camera@0.1: in a tenth of the light",
    )
    parser.add_argument("--physics", default="wheels")
    parser.add_argument("--courses", default=",".join(course_name(*course) for course in COURSES))
    parser.add_argument("--depth", default=None, help="folder of the depth network of camera and objects")
    parser.add_argument("--errors", default="packaged", help="range_errors.json of sensor noisy")
    parser.add_argument("--packaged", action="store_true", help="the packaged policy is dqn's only training")
    parser.add_argument("--runs", type=Path, default=Path("runs/table5"), help="where trainings go")
    parser.add_argument("--rows", type=Path, default=HERE / "rows", help="where rows are kept")
    return parser.parse_args()


def all_rows(given: Namespace) -> Iterator[Row]:
    """Every row that the command asks for.

    Raises:
        ValueError: a method, a sensor or a course that there is not.
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
    for physics in given.physics.split(","):
        for sensor in sensors:
            for method in methods:
                packaged = given.packaged and method in ("dqn", "dqn_follows")
                seeds = [0] if packaged else list(range(given.seeds))
                for seed in seeds if method in LEARNT else [None]:
                    for course in courses:
                        yield Row(method, *known[course], sensor, physics, given.worlds, seed)


def policy_file(row: Row, given: Namespace) -> Path | None:
    """The trained policy of a row; it is trained now if it was not yet. None for planners."""
    if row.seed is None:
        return None
    method = "dqn" if row.method == "dqn_follows" else row.method
    if given.packaged and method == "dqn":
        return DEFAULT_WEIGHTS
    folder = given.runs / f"{method}-{row.seed}"
    if not (folder / "policy.safetensors").is_file():
        options = [*LEARNT[row.method], f"seed={row.seed}", f"run_dir={folder}"]
        subprocess.run([sys.executable, "-m", "eldenet.navigate", "mode=train", *options], check=True)
    return folder / "policy.safetensors"


def make_sensor(row: Row, given: Namespace) -> Sensor:
    """The sensor of a row."""
    kind, _, light = row.sensor.partition("@")
    if kind == "ranges":
        return Ranges()
    if kind == "noisy":
        return NoisyRanges(errors=given.errors)
    return {"camera": camera, "objects": objects}[kind](given.depth, light=float(light or 1.0))


def sources_hash(row: Row) -> str:
    """SHA-256 over the code that a row's crossings depend on; its camera's too, where it has one."""
    files = [
        PACKAGE / "robot.py",
        *PACKAGE.glob("simulation/arena*.py"),
        PACKAGE / "simulation" / "culling.py",
    ]
    files += [file for file in PACKAGE.glob("navigation/**/*.py") if file.stem not in _NO_PART]
    if row.sensor.partition("@")[0] in ("camera", "objects"):
        files += [
            *PACKAGE.glob("simulation/*.py"),
            *PACKAGE.glob("perception/*.py"),
            PACKAGE / "predictor.py",
        ]
    digest = hashlib.sha256()
    for file in sorted(set(files)):
        digest.update(
            file.relative_to(PACKAGE).as_posix().encode() + file.read_bytes().replace(b"\r\n", b"\n")
        )
    return digest.hexdigest()


def key_of(
    row: Row, given: Namespace, weights: Path | None, arenas: Sequence[Arena]
) -> dict[str, str | None]:
    """All that a row's crossings depend on: where any of it has changed, the row is made anew."""
    kind = row.sensor.partition("@")[0]
    network = None
    if given.depth is not None and kind in ("camera", "objects"):
        inner = Path(given.depth) / "model"
        network = next(path for path in (inner, Path(given.depth)) if path.exists())
        network = network / "model.safetensors" if network.is_dir() else network
    return {
        "arenas": arenas_hash(arenas),
        "sources": sources_hash(row),
        "policy": _digest(weights),
        "depth": _digest(network),
        "errors": _digest(errors_file(given.errors) if kind == "noisy" else None),
    }


def _digest(path: Path | None) -> str | None:
    return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


def measure(row: Row, given: Namespace) -> list[Crossing]:
    """The crossings of a row: read, if nothing that they depend on has changed since, or made now."""
    arenas = frozen_arenas(row.density, row.worlds, movers=row.movers)
    frozen = json.loads((HERE / "arenas.json").read_text()).get(str(row.worlds), {}).get(row.course)
    if frozen is not None and arenas_hash(arenas) != frozen:
        raise ValueError(f"the test arenas {row.course} are not those that were frozen (arenas.json)")
    weights = policy_file(row, given)
    key = key_of(row, given, weights, arenas)
    table, note = given.rows / f"{row.name}.csv", given.rows / f"{row.name}.json"
    if table.is_file() and note.is_file() and json.loads(note.read_text())["key"] == key:
        return read_rows(table)
    started = time.process_time()
    walkers = True if row.method == "dqn_follows" else None
    make = PLANNERS.get(row.method, lambda robots: Navigator.load(weights, walkers=walkers, robots=robots))
    crossings = cross(arenas, make, make_sensor(row, given), physics=row.physics)
    write_rows(table, *as_rows(crossings))
    spent = round(time.process_time() - started, 1)
    write_json(note, {"key": key, "cpu_seconds": spent, **environment()})
    solved = sum(crossing.outcome == "success" for crossing in crossings)
    print(f"{row.name}: {solved} of {len(crossings)}, {spent:.0f} s of processor time", flush=True)
    return crossings


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

"""One row of the navigation tables: a method, a density, a sensor, a physics -> one CSV, made once."""

import csv
import hashlib
import json
import subprocess
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from eldenet.navigation.cameras import camera
from eldenet.navigation.evaluation import Crossing, as_rows, cross
from eldenet.navigation.noise import NoisyRanges
from eldenet.navigation.planners.astar import AStarDWA, AStarOnlineDWA
from eldenet.navigation.planners.dwa import LocalDWA
from eldenet.navigation.planners.straight import Straight
from eldenet.navigation.policy import DEFAULT_WEIGHTS, Navigator
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import frozen_arenas
from eldenet.record import environment, write_json, write_rows
from eldenet.simulation.arenas import arenas_hash

HERE = Path(__file__).parent
DENSITIES = (5, 20, 40, 80)
LEARNT = {  # name -> what to train it with
    "algorithm2, paper state": ["observer=paper", "learner=algorithm2"],
    "our learner, paper state": ["observer=paper", "learner=dqn"],
    "dqn": ["observer=memory", "learner=dqn"],
}
PLANNERS = {
    "astar_dwa": lambda robots: AStarDWA(robots=robots),
    "astar_online_dwa": lambda robots: AStarOnlineDWA(robots=robots),
    "dwa": lambda robots: LocalDWA(robots=robots),
    "dwa, 5 sectors, no memory": lambda robots: LocalDWA(sight="sectors", memory=0, robots=robots),
    "straight": lambda robots: Straight(robots=robots),
}


@dataclass(frozen=True)
class Row:
    """What is measured: ``seed`` is the training's, None for planners."""

    method: str
    density: int
    sensor: str
    physics: str
    seed: int | None = None

    @property
    def file_name(self) -> str:
        """Of its CSV."""
        method = self.method.replace(", ", "-").replace(" ", "_")
        seed = "" if self.seed is None else f"-seed{self.seed}"
        return f"{method}{seed}-{self.sensor}-{self.physics}-{self.density}.csv"


def arguments() -> Namespace:
    """What both tables' commands take."""
    parser = ArgumentParser()
    parser.add_argument("--worlds", type=int, default=500, help="test arenas per density")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of every learnt method")
    parser.add_argument("--methods", default=",,".join([*LEARNT, *PLANNERS]), help="names, separated by ,,")
    parser.add_argument("--sensors", default="ranges,noisy")
    parser.add_argument("--physics", default="wheels,kinematic")
    parser.add_argument("--depth", default=None, help="folder of the depth network behind sensor camera")
    parser.add_argument("--packaged", action="store_true", help="the packaged policy is dqn's only training")
    parser.add_argument("--runs", type=Path, default=Path("runs/table5"), help="where trainings go")
    parser.add_argument("--rows", type=Path, default=HERE / "rows", help="where rows are kept")
    return parser.parse_args()


def all_rows(given: Namespace) -> Iterator[Row]:
    """Every row that the command asks for."""
    for physics in given.physics.split(","):
        for sensor in given.sensors.split(","):
            for method in given.methods.split(",,"):
                learnt = method in LEARNT
                seeds = [0] if given.packaged and method == "dqn" else list(range(given.seeds))
                for seed in seeds if learnt else [None]:
                    for density in DENSITIES:
                        yield Row(method, density, sensor, physics, seed)


def policy_file(row: Row, given: Namespace) -> Path | None:
    """The trained policy of a row; it is trained now if it was not yet. None for planners."""
    if row.seed is None:
        return None
    if given.packaged and row.method == "dqn":
        return DEFAULT_WEIGHTS
    folder = given.runs / f"{row.method.replace(', ', '-').replace(' ', '_')}-{row.seed}"
    if not (folder / "policy.safetensors").is_file():
        options = [*LEARNT[row.method], f"seed={row.seed}", f"run_dir={folder}"]
        subprocess.run([sys.executable, "-m", "eldenet.navigate", "mode=train", *options], check=True)
    return folder / "policy.safetensors"


def measure(row: Row, given: Namespace) -> list[Crossing]:
    """The crossings of a row: read, if made of the same arenas with the same policy, or made now."""
    arenas = frozen_arenas(row.density, given.worlds)
    frozen = json.loads((HERE / "arenas.json").read_text()).get(str(given.worlds), {}).get(str(row.density))
    if frozen is not None and arenas_hash(arenas) != frozen:
        raise ValueError(
            f"the test arenas of density {row.density} are not those that were frozen (arenas.json)"
        )
    weights = policy_file(row, given)
    digest = None if weights is None else hashlib.sha256(weights.read_bytes()).hexdigest()
    key = {
        "arenas": arenas_hash(arenas),
        "policy": digest,
        "depth": given.depth if row.sensor == "camera" else None,
    }
    table, note = given.rows / row.file_name, given.rows / f"{row.file_name[:-4]}.json"
    if table.is_file() and note.is_file() and json.loads(note.read_text())["key"] == key:
        return read_rows(table)
    sensor = {"ranges": Ranges, "noisy": NoisyRanges, "camera": lambda: camera(given.depth)}[row.sensor]()
    make = PLANNERS.get(row.method, lambda robots: Navigator.load(weights, robots=robots))
    crossings = cross(arenas, make, sensor, physics=row.physics)
    write_rows(table, *as_rows(crossings))
    write_json(note, {"key": key, **environment()})
    solved = sum(crossing.outcome == "success" for crossing in crossings)
    print(f"{row.file_name}: {solved} of {len(crossings)}", flush=True)
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

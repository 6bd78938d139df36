"""One row of the navigation tables: a method, a density, a sensor, a physics -> one CSV, made once."""

import csv
import functools
import json
import shutil
import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inputs import CAMERAS, digest, input_hashes, make_sensor, training_of
from methods import LEARNT, PLANNERS

from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import Episode, Policy, as_rows, run_episodes
from eldenet.navigation.policy import DEFAULT_WEIGHTS, Navigator
from eldenet.navigation.provenance import episode_hash
from eldenet.navigation.tasks import frozen_arenas
from eldenet.results.run_record import environment, write_json, write_rows
from eldenet.simulation.arenas import Arena, arenas_hash

HERE = Path(__file__).parent


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


def policy_file(row: Row, given: Namespace) -> Path | None:
    """The trained policy of a row; it is trained now if it was not yet. None for planners.

    What rows rest on is kept beside them, in ``policies``: a table is rebuilt without its trainings' folders.
    """
    if row.seed is None:
        return None
    if LEARNT[row.method].packaged:
        return DEFAULT_WEIGHTS
    method = LEARNT[row.method].drivers or row.method
    options = [*LEARNT[method].options, f"seed={row.seed}"]
    folder, kept = (at / f"{method}-{row.seed}" for at in (given.runs, given.rows.parent / "policies"))
    check = functools.partial(
        training_of, options=options, any_sources=given.any_sources, recheck=given.recheck > 0
    )
    if not folder.is_dir() and kept.is_dir():
        return check(kept)
    policy = check(folder)
    kept.mkdir(parents=True, exist_ok=True)
    for name in (policy.name, "training.json"):
        shutil.copyfile(folder / name, kept / name)
    return policy


@functools.cache
def frozen(density: int, worlds: int, movers: int) -> tuple[Sequence[Arena], str]:
    """Test arenas, the same for every method and sensor, and their hash."""
    arenas = frozen_arenas(density, worlds, pedestrians=movers)
    return arenas, arenas_hash(arenas)


def key_of(row: Row, given: Namespace, weights: Path | None, arenas: str) -> dict[str, Any]:
    """All that a row's crossings depend on: where any of it has changed, the row is made anew."""
    versions = environment()["versions"]
    return {
        "arenas": arenas,
        "sources": episode_hash(camera=row.sensor.partition("@")[0] in CAMERAS),
        "versions": {name: versions[name] for name in ("mujoco", "numpy", "torch")},
        "policy": None if weights is None else digest([weights]),
        "drives": None if row.seed is None else LEARNT[row.method].drives,
        **input_hashes(row.sensor, given),
    }


def measure(row: Row, given: Namespace) -> list[Episode]:
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
) -> list[Episode]:
    """Cross arenas as the row says; an outcome does not depend on the other arenas."""

    def driver(robots: int) -> Policy:
        if row.seed is None:
            return PLANNERS[row.method](robots)
        return Navigator.load(weights, **LEARNT[row.method].drives, robots=robots)

    settings = EpisodeSettings(row.physics, row.goal)
    return run_episodes(arenas, driver, make_sensor(row.sensor, given), settings)


def read_rows(path: Path) -> list[Episode]:
    """The crossings of a CSV."""
    with path.open() as file:
        return [
            Episode(
                line["world"],
                int(line["density"]),
                line["outcome"],
                *(float(line[name]) for name in ("seconds", "travelled", "shortest")),
            )
            for line in csv.DictReader(file)
        ]

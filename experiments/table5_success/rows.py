"""One row of the navigation tables: a method on one course. Its episodes are crossed once and stored.

``rows/<method>.csv`` holds an episode a line, ``rows/<method>.json`` what each row of them was made with.
"""

import fcntl
import functools
import os
import shutil
import time
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inputs import digest, input_hashes, make_sensor, trained_policy
from methods import LEARNED, PLANNERS

from eldenet.navigation.cameras import FACES_VERSION
from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import Episode, Policy, read_episodes, run_episodes, write_episodes
from eldenet.navigation.planners.dwa import DWA_VERSION
from eldenet.navigation.planners.paths import SHORTEST_VERSION
from eldenet.navigation.planners.plan_and_steer import STEER_VERSION
from eldenet.navigation.policy import Navigator
from eldenet.navigation.policy_files import DEFAULT_WEIGHTS
from eldenet.navigation.provenance import EPISODE_VERSION
from eldenet.navigation.tasks import frozen_arenas
from eldenet.results.run_record import environment
from eldenet.simulation.arenas import Arena, arenas_hash
from eldenet.system.files import read_json, write_json

HERE = Path(__file__).parent
LABELS = ("sensor", "goal", "physics", "course", "worlds", "seed")  # columns that name a row of a method


@dataclass(frozen=True)
class Row:
    """What is measured.

    Attributes:
        method: a name of LEARNED or PLANNERS.
        density: standing obstacles.
        movers: walking people.
        sensor: "ranges", "noisy", "camera" or "objects"; "camera@0.1" in that share of a normal day's light.
        physics: "wheels" or "kinematic".
        worlds: number of arenas.
        seed: of the training; None for planners.
        goal: "known", "fixes" or "odometry".
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
    def labels(self) -> tuple[str, ...]:
        """Values of the columns ``LABELS``."""
        seed = "" if self.seed is None else str(self.seed)
        return (self.sensor, self.goal, self.physics, self.course, str(self.worlds), seed)

    @property
    def name(self) -> str:
        """Key of its note, such as "ranges-known-wheels-20-500-seed0"."""
        return "-".join(self.labels[:-1]) + ("" if self.seed is None else f"-seed{self.seed}")

    @property
    def file(self) -> str:
        """Name of its method's two files, without their ending."""
        return self.method.replace(", ", "-").replace(" ", "_")


def course_name(density: int, movers: int) -> str:
    """Return a course as tables write it."""
    return f"{density}+{movers}" if movers else str(density)


def measure(row: Row, args: Namespace) -> list[Episode]:
    """Return the episodes of a row: stored ones if all that they depend on is unchanged, else new ones."""
    arenas, found = frozen(row.density, row.worlds, row.movers)
    wanted = read_json(HERE / "arenas.json").get(str(row.worlds), {}).get(row.course)
    if wanted is not None and found != wanted:
        raise ValueError(f"the test arenas of course {row.course} differ from the frozen ones in arenas.json")
    weights = policy_file(row, args)
    key = key_of(row, args, weights, found)
    stored = read_notes(args.rows / f"{row.file}.json").get(row.name)
    if stored is not None and stored["key"] == key:
        return read_episodes(args.rows / f"{row.file}.csv", LABELS)[row.labels]
    started = time.process_time()
    crossings = make_crossings(row, args, weights, arenas)
    spent = round(time.process_time() - started, 1)
    store(row, args.rows, crossings, key, spent)
    solved = sum(crossing.outcome == "success" for crossing in crossings)
    print(
        f"{row.method} {row.name}: {solved} of {len(crossings)}, {spent:.0f} s of processor time", flush=True
    )
    return crossings


@functools.cache
def frozen(density: int, worlds: int, movers: int) -> tuple[Sequence[Arena], str]:
    """Return the test arenas, the same for every method and sensor, and their hash."""
    arenas = frozen_arenas(density, worlds, pedestrians=movers)
    return arenas, arenas_hash(arenas)


def policy_file(row: Row, args: Namespace) -> Path | None:
    """Return the policy of a row, trained now if it is missing; None for planners.

    Policies of stored rows are kept beside them in ``policies``, so that a table can be rebuilt without the
    folders of its trainings.
    """
    if row.seed is None:
        return None
    if LEARNED[row.method].packaged:
        return DEFAULT_WEIGHTS
    method = LEARNED[row.method].drivers or row.method
    options = [*LEARNED[method].options, f"seed={row.seed}"]
    folder, kept = (at / f"{method}-{row.seed}" for at in (args.runs, args.rows.parent / "policies"))
    if not folder.is_dir() and kept.is_dir():
        return trained_policy(kept, options)
    policy = trained_policy(folder, options)
    kept.mkdir(parents=True, exist_ok=True)
    for name in (policy.name, "training.json"):
        shutil.copyfile(folder / name, kept / name)
    return policy


def key_of(row: Row, args: Namespace, weights: Path | None, arenas: str) -> dict[str, Any]:
    """Return all that a row's episodes depend on: where any of it changes, the row is made anew."""
    versions = environment()["versions"]
    return {
        "arenas": arenas,
        "version": EPISODE_VERSION,
        "shortest": SHORTEST_VERSION,
        "versions": {name: versions[name] for name in ("mujoco", "numpy", "torch")},
        "policy": None if weights is None else digest([weights]),
        "drives": planner_version(row.method) if row.seed is None else LEARNED[row.method].drives,
        **({"faces": FACES_VERSION} if row.sensor.startswith("objects") else {}),
        **input_hashes(row.sensor, args),
    }


def planner_version(method: str) -> dict[str, Any] | None:
    """Return what a planner's decisions depend on: versions, look-ahead distance [m], policy."""
    if method == "astar_online_dqn":
        return {"dwa": DWA_VERSION, "steer": STEER_VERSION, "policy": digest([DEFAULT_WEIGHTS])}
    if "dwa" in method:
        return {"dwa": DWA_VERSION, "carrot": PLANNERS[method]().carrot}
    return None


def make_crossings(row: Row, args: Namespace, weights: Path | None, arenas: Sequence[Arena]) -> list[Episode]:
    """Cross all arenas; the outcome in one does not depend on the others."""

    def driver(robots: int) -> Policy:
        if row.seed is None:
            return PLANNERS[row.method](robots=robots)
        return Navigator.load(weights, **LEARNED[row.method].drives, robots=robots)

    settings = EpisodeSettings(row.physics, row.goal)
    return run_episodes(arenas, driver, make_sensor(row.sensor, args), settings)


def read_notes(file: Path) -> dict[str, dict[str, Any]]:
    """Return the notes of a method's rows by their names; none without the file."""
    if not file.is_file():
        return {}
    content = read_json(file)
    environments = content["environments"]
    return {
        name: note | {"environment": environments[note["environment"]]}
        for name, note in content["rows"].items()
    }


def store(
    row: Row, folder: Path, crossings: Sequence[Episode], key: Mapping[str, Any], cpu_seconds: float
) -> None:
    """Add or replace one row of a method's files; other rows stay, also those of commands side by side."""
    table, note = folder / f"{row.file}.csv", folder / f"{row.file}.json"
    where = environment()
    with locked(folder):
        write_episodes(table, LABELS, read_episodes(table, LABELS) | {row.labels: crossings})
        made = {"key": key, "cpu_seconds": cpu_seconds, "date": where.pop("date"), "environment": where}
        write_notes(note, read_notes(note) | {row.name: made})


def write_notes(file: Path, notes: Mapping[str, Mapping[str, Any]]) -> None:
    """Write the notes of a method's rows; an environment that several share is written once."""
    environments: list[Any] = []
    for note in notes.values():
        if note["environment"] not in environments:
            environments.append(note["environment"])
    rows = {
        name: {**note, "environment": environments.index(note["environment"])} for name, note in notes.items()
    }
    write_json(file, {"environments": environments, "rows": rows})


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Let one command at a time change the files of a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)

"""One row of the navigation tables: a method on one course. Its episodes are crossed once and stored.

``rows/episodes.csv.xz`` holds an episode a line, ``rows/notes.json`` what each row of them was made with.
"""

import functools
import time
import zipfile
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from episodes import read_episodes, write_episodes
from filelock import FileLock
from inputs import digest, input_hashes, make_sensor, trained_policy
from methods import LEARNED, PLANNERS

from eldenet.navigation.cameras import FACES_VERSION
from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import Episode, Policy, run_episodes, to_goal
from eldenet.navigation.planners.dwa import DWA_VERSION
from eldenet.navigation.planners.paths import SHORTEST_VERSION
from eldenet.navigation.planners.plan_and_steer import STEER_VERSION
from eldenet.navigation.policy import Navigator
from eldenet.navigation.policy_files import DEFAULT_WEIGHTS
from eldenet.navigation.provenance import EPISODE_VERSION
from eldenet.navigation.tasks import frozen_arenas
from eldenet.navigation.training import POLICY, RECORD
from eldenet.results.packed_runs import file_state
from eldenet.results.run_record import environment
from eldenet.simulation.arenas import Arena, arenas_hash
from eldenet.system.files import LOCK, part_file, read_json, write_json

HERE = Path(__file__).parent
EPISODES, NOTES = "episodes.csv.xz", "notes.json"
LABELS = ("method", "sensor", "goal", "physics", "course", "worlds", "seed")  # columns that name a row


@dataclass(frozen=True)
class Row:
    """What is measured.

    Attributes:
        method: a name of LEARNED or PLANNERS.
        density: standing obstacles.
        movers: walking people.
        sensor: "ranges", "centers", "noisy", "camera" or "objects"; "camera@0.1" in that share of a normal
            day's light.
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
        return (self.method, self.sensor, self.goal, self.physics, self.course, str(self.worlds), seed)

    @property
    def name(self) -> str:
        """Key of its note, such as "dqn-ranges-known-wheels-20-500-seed0"."""
        return "-".join(self.labels[:-1]) + ("" if self.seed is None else f"-seed{self.seed}")


def course_name(density: int, movers: int) -> str:
    """Return a course as tables write it."""
    return f"{density}+{movers}" if movers else str(density)


def measure(row: Row, args: Namespace) -> list[Episode]:
    """Return the episodes of a row: stored ones if all that they depend on is unchanged, else new ones."""
    arenas, found = frozen(row.density, row.worlds, row.movers)
    wanted = read_json(HERE / "arenas.json").get(str(row.worlds), {}).get(row.course)
    if wanted is not None and found != wanted:
        raise ValueError(f"the test arenas of course {row.course} differ from the frozen ones in arenas.json")
    if args.stored:
        crossings = stored_episodes(args.rows)[row.labels]
        return [replace(c, shortest=_to_goal(arena)) for c, arena in zip(crossings, arenas, strict=True)]
    weights = policy_file(row, args)
    key = key_of(row, args, weights, found)
    stored = read_notes(args.rows / NOTES).get(row.name)
    if stored is not None and stored["key"] == key:
        return stored_episodes(args.rows)[row.labels]
    started = time.process_time()
    crossings = make_crossings(row, args, weights, arenas)
    spent = round(time.process_time() - started, 1)
    store(row, args.rows, crossings, key, spent)
    solved = sum(crossing.outcome == "success" for crossing in crossings)
    print(
        f"{row.method} {row.name}: {solved} of {len(crossings)}, {spent:.0f} s of processor time", flush=True
    )
    return crossings


def stored_episodes(folder: Path) -> dict[tuple[str, ...], list[Episode]]:
    """Return the stored episodes by the labels of their rows."""
    file = folder / EPISODES
    return _episodes(file, file_state(file)) if file.is_file() else {}


@functools.lru_cache(maxsize=1)
def _episodes(file: Path, state: tuple[int, int, int]) -> dict[tuple[str, ...], list[Episode]]:
    return read_episodes(file, LABELS)


_to_goal = functools.cache(to_goal)  # for each sensor of a table anew, it would take minutes


@functools.cache
def frozen(density: int, worlds: int, movers: int) -> tuple[Sequence[Arena], str]:
    """Return the test arenas, the same for every method and sensor, and their hash."""
    arenas = frozen_arenas(density, worlds, pedestrians=movers)
    return arenas, arenas_hash(arenas)


def policy_file(row: Row, args: Namespace) -> Path | None:
    """Return the policy of a row, trained now if it is missing; None for planners.

    Policies of stored rows are kept in ``policies.zip``, so that a table can be made without its trainings.
    """
    if row.seed is None:
        return None
    if LEARNED[row.method].packaged:
        return DEFAULT_WEIGHTS
    method = LEARNED[row.method].drivers or row.method
    options = [*LEARNED[method].options, f"seed={row.seed}"]
    folder, archive = args.runs / f"{method}-{row.seed}", args.rows.parent / "policies.zip"
    kept = read_archive(archive)
    if not folder.is_dir() and f"{folder.name}/{POLICY}" in kept:
        with zipfile.ZipFile(archive) as packed:
            packed.extractall(args.runs, [name for name in kept if name.startswith(f"{folder.name}/")])
    policy = trained_policy(folder, options)
    mine = {f"{folder.name}/{name}": (folder / name).read_bytes() for name in (POLICY, RECORD)}
    if mine.items() - kept.items():
        write_archive(archive, kept | mine)
    return policy


def read_archive(path: Path) -> dict[str, bytes]:
    """Return the contents of the files in an archive by their names; none without the archive."""
    if not path.is_file():
        return {}
    with zipfile.ZipFile(path) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def write_archive(path: Path, files: Mapping[str, bytes]) -> None:
    """Write files into an archive: the same bytes for the same files."""
    with part_file(path) as unfinished, zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in files.items():
            packed.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)


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
    if method.startswith("astar_online_dqn"):
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
    """Return the notes of the rows by their names; none without the file."""
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
    """Add or replace one row; other rows stay, also those of commands side by side."""
    where, note = environment(), folder / NOTES
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / LOCK):
        write_episodes(folder / EPISODES, LABELS, stored_episodes(folder) | {row.labels: crossings})
        made = {"key": key, "cpu_seconds": cpu_seconds, "date": where.pop("date"), "environment": where}
        write_notes(note, read_notes(note) | {row.name: made})


def write_notes(file: Path, notes: Mapping[str, Mapping[str, Any]]) -> None:
    """Write the notes of the rows; an environment that several share is written once."""
    environments: list[Any] = []
    for note in notes.values():
        if note["environment"] not in environments:
            environments.append(note["environment"])
    rows = {
        name: {**note, "environment": environments.index(note["environment"])} for name, note in notes.items()
    }
    write_json(file, {"environments": environments, "rows": rows})

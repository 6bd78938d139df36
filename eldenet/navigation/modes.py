"""Modes of ``python -m eldenet.navigate``: what each one needs, and a function that runs it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eldenet.navigation.dqn import DQN
from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import Policy, as_rows, run_episodes, summarize
from eldenet.navigation.policy_files import POLICY
from eldenet.navigation.provenance import driver_identity, sensor_identity
from eldenet.navigation.sensors import Sensor
from eldenet.navigation.tasks import frozen_arenas
from eldenet.navigation.training import train as train_driver
from eldenet.navigation.visualization import VIDEO_FORMATS, record_episode
from eldenet.results.run_log import RunLog
from eldenet.results.run_record import RUN_FILE, environment, read_record
from eldenet.simulation.arena_files import read_arena
from eldenet.simulation.arenas import Arena, arenas_hash, generate_arena, triangle_course
from eldenet.simulation.robot import ROBOT
from eldenet.system.checks import one_of
from eldenet.system.files import sole_writer, write_json, write_rows
from eldenet.system.resources import choose_resources


@dataclass(frozen=True, kw_only=True)
class ModeSetup:
    """What all modes need.

    Attributes:
        mode: its name.
        folder: Run folder.
        threads: of torch, or "auto".
        make_sensor: builds the sensor, and loads its networks.
        episode: conditions of the episodes.
        settings: the resolved settings, which ``run.json`` stores.
    """

    mode: str
    folder: Path
    threads: int | str
    make_sensor: Callable[[], Sensor]
    episode: EpisodeSettings
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class RecordSetup(ModeSetup):
    """A video of one episode.

    Attributes:
        make_policy: number of robots -> driver.
        density: number of obstacles.
        pedestrians: number of walking people.
        world: number of the arena.
        split: seed stream of the arena.
        kind: "open", "rooms" or "traps".
        course: "triangle" instead of a random arena, or None.
        arena_file: YAML file of an arena instead, or None.
        video: "gif", "webp" or "mp4".
    """

    make_policy: Callable[[int], Policy]
    density: int
    pedestrians: int
    world: int
    split: str
    kind: str
    course: str | None
    arena_file: str | None
    video: str


@dataclass(frozen=True, kw_only=True)
class EvaluationSetup(ModeSetup):
    """An evaluation in random arenas, the same for every driver.

    Attributes:
        make_policy: number of robots -> driver.
        densities: numbers of obstacles.
        episodes: arenas per density.
        robots: episodes that run at once.
        split: seed stream of the arenas.
        pedestrians: number of walking people in each.
        kind: "open", "rooms" or "traps".
    """

    make_policy: Callable[[int], Policy]
    densities: Sequence[int]
    episodes: int
    robots: int
    split: str
    pedestrians: int
    kind: str

    def __post_init__(self) -> None:
        if not self.densities or self.episodes < 1:
            raise ValueError(f"density={self.densities}, episodes={self.episodes}: give at least one of each")
        if self.robots < 1:
            raise ValueError(f"robots={self.robots}: give at least 1 episode to run at once")

    def arenas(self, density: int) -> Sequence[Arena]:
        """Return the arenas of one density."""
        return frozen_arenas(
            density, self.episodes, split=self.split, pedestrians=self.pedestrians, kind=self.kind
        )


@dataclass(frozen=True, kw_only=True)
class TrainSetup(ModeSetup):
    """A training of a driver.

    Attributes:
        make_learner: sensor -> the learner with its environment.
        validate: arenas to validate on at every checkpoint; 0: no validation.
    """

    make_learner: Callable[[Sensor], DQN]
    validate: int

    def __post_init__(self) -> None:
        if self.validate < 0:
            raise ValueError(f"training.validate={self.validate}: give a number of arenas, or 0 for none")


def run_mode(setup: ModeSetup) -> None:
    """Run the mode that the setup is for; results go to its folder."""
    refuse_to_replace(setup.folder, setup.mode)
    choose_resources(device="cpu", precision="fp32", threads=setup.threads)
    modes: tuple[Callable[[Any, RunLog], None], ...] = (record, evaluate, train)
    with sole_writer(setup.folder):
        log = RunLog(setup.folder)
        {mode.__name__: mode for mode in modes}[setup.mode](setup, log)
        log.close()


def refuse_to_replace(folder: Path, mode: str) -> None:
    """Keep the ``run.json`` of another mode or command; the same mode may run again.

    Raises:
        ValueError: ``folder`` has one.
    """
    if mode == "train" or not (folder / RUN_FILE).is_file():  # a training writes training.json
        return
    stored = read_record(folder / RUN_FILE)
    before = stored.get("mode", "evaluate" if "driver" in stored else "another command")
    if before != mode:
        raise ValueError(f"output={folder} holds results of {before}: give another output")


def write_record(setup: ModeSetup, sensor: Sensor, policy: Policy | None, found: Mapping[str, Any]) -> None:
    """Write ``run.json``: results, driver, sensor files, seed, settings, versions and the command."""
    driver = {} if policy is None else {"policy": policy.name, "driver": driver_identity(policy)}
    record = {
        "mode": setup.mode,
        **driver,
        "inputs": sensor_identity(sensor),
        **found,
        "seed": setup.episode.seed,
        "config": setup.settings,
        **environment(),
    }
    write_json(setup.folder / RUN_FILE, record)


def record(setup: RecordSetup, log: RunLog) -> None:
    """Record a video of one episode."""
    one_of("video", setup.video, VIDEO_FORMATS)
    if setup.arena_file is not None:
        if setup.course is not None:
            raise ValueError(
                f"course={setup.course} and arena.file={setup.arena_file}: give only one of them"
            )
        arena = read_arena(setup.arena_file)
    elif setup.course is None:
        arena = generate_arena(
            setup.split, setup.density, setup.world, pedestrians=setup.pedestrians, kind=setup.kind
        )
    else:
        one_of("course", setup.course, ("triangle",))
        arena = triangle_course()
    policy, sensor = setup.make_policy(1), setup.make_sensor()
    path = setup.folder / f"{policy.name}-{arena.name}.{setup.video}"
    with log.bar("recording", round(setup.episode.time_limit / ROBOT.period), unit="frames") as bar:
        event, seconds = record_episode(arena, policy, sensor, path, setup.episode, advance=bar.advance)
    outcome = event.name.lower()
    found = {"arena": arenas_hash([arena]), "outcome": outcome, "seconds": seconds, "video": path.name}
    write_record(setup, sensor, policy, found)
    log.say(f"{policy.name} in {arena.name}: {outcome} after {seconds:.1f} s; video: {path}")


def evaluate(setup: EvaluationSetup, log: RunLog) -> None:
    """Run the driver through the arenas; write a CSV row per episode."""
    policy, sensor = setup.make_policy(1), setup.make_sensor()
    metrics, hashes, table = {}, {}, []
    for density in setup.densities:
        arenas = setup.arenas(density)
        with log.bar(f"{density} obstacles", len(arenas), unit="episodes") as bar:
            rows = run_episodes(
                arenas, setup.make_policy, sensor, setup.episode, robots=setup.robots, advance=bar.advance
            )
        hashes[str(density)] = arenas_hash(arenas)
        write_rows(setup.folder / f"episodes_{density}.csv", *as_rows(rows))
        metrics[str(density)] = s = summarize(rows)
        interval = f"{s['success_low']:.1f} to {s['success_high']:.1f}"
        rates = [f"{s[name]:.1f}" for name in ("collision", "timeout", "seconds")]
        table.append([str(density), f"{s['success']:.1f}", interval, *rates, f"{s['spl']:.3f}"])
    write_record(setup, sensor, policy, {"metrics": metrics, "arenas": hashes})
    filtered = "range filter, " if setup.episode.filters(sensor) else ""
    title = (
        f"{policy.name}, {setup.episode.physics}, goal {setup.episode.goal}, {filtered}{setup.episodes} "
        f"{setup.split} arenas ({setup.kind}) per density: {setup.folder / RUN_FILE}"
    )
    log.table(title, ["obstacles", "success [%]", "95 %", "collision", "time-out", "time [s]", "SPL"], table)


def train(setup: TrainSetup, log: RunLog) -> None:
    """Train a driver; continue if the folder has an unfinished training."""
    sensor = setup.make_sensor()
    note = train_driver(
        setup.make_learner(sensor), sensor, setup.folder, log, validate=setup.validate, config=setup.settings
    )
    log.say(f"policy in {setup.folder / POLICY}; {note['cpu_seconds']:.0f} s of processor time")

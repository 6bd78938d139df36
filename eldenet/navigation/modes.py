"""Modes of ``python -m eldenet.navigate``: what each one needs, and a function that runs it."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eldenet.navigation.dqn import DQN
from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import Episode, Policy, as_rows, run_episodes, summarize
from eldenet.navigation.failures import KINDS, draw_worst, trace
from eldenet.navigation.policy import Navigator
from eldenet.navigation.policy_files import POLICY
from eldenet.navigation.provenance import driver_identity, sensor_identity
from eldenet.navigation.range_errors import check_edges, fit_errors, scan_along, scan_near
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
from eldenet.system.files import write_json, write_rows
from eldenet.system.locks import sole_writer
from eldenet.system.resources import choose_resources
from eldenet.visualization import write_picture


@dataclass(frozen=True, kw_only=True)
class ModeSetup:
    """What all modes need.

    Attributes:
        mode: its name.
        folder: of the run.
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
class ArenasSetup(ModeSetup):
    """Random arenas, the same for every driver.

    Attributes:
        densities: numbers of obstacles.
        episodes: arenas per density.
        split: their seed stream.
        pedestrians: number of walking people in each.
        kind: "open", "rooms" or "traps".
    """

    densities: Sequence[int]
    episodes: int
    split: str = "val"
    pedestrians: int = 0
    kind: str = "open"

    def __post_init__(self) -> None:
        if not self.densities or self.episodes < 1:
            raise ValueError(f"density={self.densities}, episodes={self.episodes}: give at least one of each")

    def arenas(self, density: int) -> Sequence[Arena]:
        """Return the arenas of one density."""
        return frozen_arenas(
            density, self.episodes, split=self.split, pedestrians=self.pedestrians, kind=self.kind
        )


@dataclass(frozen=True, kw_only=True)
class EvaluationSetup(ArenasSetup):
    """An evaluation, or an analysis of its failures.

    Attributes:
        make_policy: number of robots -> driver.
        robots: episodes that run at once.
    """

    make_policy: Callable[[int], Policy]
    robots: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.robots < 1:
            raise ValueError(f"robots={self.robots}: give at least 1 episode to run at once")


@dataclass(frozen=True, kw_only=True)
class NoiseSetup(ArenasSetup):
    """A measurement of a sensor's range errors.

    Attributes:
        places: "episodes": along episodes of the packaged driver; "near": near obstacles.
        scans: per arena, for ``places="near"``.
        edges: of the distance bins [m].
    """

    places: str
    scans: int
    edges: Sequence[float]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_edges("fit_noise.edges", self.edges)


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
    modes: tuple[Callable[[Any, RunLog], None], ...] = (record, evaluate, analyze_failures, fit_noise, train)
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
        arenas, rows = _run(setup, density, sensor, log)
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


def _run(
    setup: EvaluationSetup, density: int, sensor: Sensor, log: RunLog
) -> tuple[Sequence[Arena], list[Episode]]:
    """Run the driver through the arenas of one density, with a progress bar."""
    arenas, settings = setup.arenas(density), setup.episode
    with log.bar(f"{density} obstacles", len(arenas), unit="episodes") as bar:
        rows = run_episodes(
            arenas, setup.make_policy, sensor, settings, robots=setup.robots, advance=bar.advance
        )
    return arenas, rows


def analyze_failures(setup: EvaluationSetup, log: RunLog) -> None:
    """Repeat every failed episode; write a CSV row for each, and a picture of the worst."""
    policy, sensor = setup.make_policy(1), setup.make_sensor()
    found: dict[str, dict[str, Any]] = {}
    for density in setup.densities:
        arenas, rows = _run(setup, density, sensor, log)
        failures = trace(arenas, rows, setup.make_policy, sensor, setup.episode)
        counts = Counter(failure.kind for failure in failures)
        found[str(density)] = {"worlds": len(rows), "arenas": arenas_hash(arenas), "failures": dict(counts)}
        if not failures:
            log.say(f"{density} obstacles: all {len(rows)} episodes succeeded")
            continue
        write_rows(setup.folder / f"failures_{density}.csv", *as_rows(failures, without=["picture"]))
        write_picture(setup.folder / f"failures_{density}.png", draw_worst(failures))
        table = [[kind, str(counts[kind]), KINDS[kind]] for kind in KINDS if counts[kind]]
        title = f"{len(failures)} of {len(rows)} failed at {density} obstacles: {setup.folder}"
        log.table(title, ["kind", "failures", "what happened"], table)
    write_record(setup, sensor, policy, {"densities": found})


def fit_noise(setup: NoiseSetup, log: RunLog) -> None:
    """Measure the errors of a sensor's ranges for ``sensor=noisy``."""
    one_of("fit_noise.places", setup.places, ("episodes", "near"))
    sensor = setup.make_sensor()
    arenas = [arena for density in setup.densities for arena in setup.arenas(density)]
    with log.bar("scanning", len(arenas), unit="arenas") as bar:
        if setup.places == "near":
            seed = setup.episode.seed
            scans = scan_near(arenas, sensor, scans=setup.scans, seed=seed, advance=bar.advance)
        else:
            scans = scan_along(arenas, sensor, Navigator.load(), setup.episode, bar.advance)
    note = {name: setup.settings[name] for name in ("sensor", "density", "fit_noise")}
    note |= {name: environment()[name] for name in ("date", "git", "versions", "command")}
    errors = fit_errors(scans, setup.edges, split=setup.split, arenas=len(arenas), **note)
    path = setup.folder / "range_errors.json"
    errors.write(path)
    write_record(setup, sensor, None, {"errors": path.name})
    table = []
    for row, bias in zip(errors.sectors, errors.bias, strict=True):
        values = [row.get(name, float("nan")) for name in ("bias", "spread", "missed", "ghost")]
        shown = [f"{value:.3f}" for value in (*values, bias)]
        table.append([f"{row['from']} to {row['to']} m", f"{row['count']:.0f}", *shown])
    title = f"errors of the nearest range per sector (natural logarithm), and the bias per column: {path}"
    log.table(title, ["true range", "scans", "bias", "spread", "missed", "ghosts", "column bias"], table)


def train(setup: TrainSetup, log: RunLog) -> None:
    """Train a driver; continue if the folder has an unfinished training."""
    sensor = setup.make_sensor()
    note = train_driver(
        setup.make_learner(sensor), sensor, setup.folder, log, validate=setup.validate, config=setup.settings
    )
    log.say(f"policy in {setup.folder / POLICY}; {note['cpu_seconds']:.0f} s of processor time")

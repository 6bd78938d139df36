"""``python -m eldenet.navigate``: record, evaluate or train a driver.

python -m eldenet.navigate                                     a video of the packaged driver in one arena
python -m eldenet.navigate policy=astar_dwa density=80 world=3 video=mp4
python -m eldenet.navigate mode=evaluate 'density=[5,20,40,80]' episodes=500
python -m eldenet.navigate mode=evaluate policy=dwa sensor=noisy physics=kinematic density=80 episodes=100
python -m eldenet.navigate mode=evaluate sensor=noisy sensor.errors=packaged goal=odometry density=5
python -m eldenet.navigate mode=evaluate sensor=noisy sensor.errors=runs/fitted/range_errors.json
python -m eldenet.navigate mode=train output=runs/my-driver    6 to 8 minutes on one core
python -m eldenet.navigate mode=evaluate checkpoint=runs/my-driver density=80
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.compose import FROM_CHOICE, REQUIRED, listed
from eldenet.configurable import instantiate
from eldenet.navigation.policy_files import POLICY, policy_files
from eldenet.system.checks import at_least, one_of
from eldenet.system.extras import require
from eldenet.system.files import sole_writer, write_json, write_rows
from eldenet.system.resources import choose_resources

if TYPE_CHECKING:
    from eldenet.navigation.episodes import EpisodeSettings
    from eldenet.navigation.evaluation import Policy
    from eldenet.navigation.sensors import Sensor
    from eldenet.results.run_log import RunLog
    from eldenet.simulation.arenas import Arena


# --- settings -----------------------------------------------------------------------------------------------


@dataclass
class Arenas:
    """Section ``arena`` of the settings."""

    # open; rooms: nine rooms with doors; traps: a U-shaped wall between start and goal; office, maze and
    # corridor: walls 1.15 to 1.4 m apart
    kind: str = "open"


@dataclass
class ArenaOrFile(Arenas):
    """Section ``arena`` of a recording or an evaluation."""

    # BARN's worlds (barn_worlds.npz); mode=record: or a YAML file with an arena of your own
    # (docs/navigation.md#an-arena-of-your-own)
    file: str | None = None


@dataclass
class Robot:
    """Section ``robot`` of the settings: what drivers do not know."""

    size: float = 1.0  # of the footprint, relative to 0.60 x 0.50 m
    speed: float = 1.0  # speed and turn rate that it reaches, relative to the commands
    friction: float = 1.1  # between wheels and floor, for physics=wheels; 0.15: slippery


@dataclass
class Randomize:
    """Section ``training.randomize``: [least, greatest], drawn for each episode (size: for each arena)."""

    # [least, greatest] to draw from; of the robot's footprint, for each arena; such as [0.85,1.15]
    size: list[float] = field(default_factory=lambda: [1.0, 1.0])
    speed: list[float] = field(default_factory=lambda: [1.0, 1.0])  # that it reaches, relative to the command
    latency: list[float] = field(default_factory=lambda: [0.0, 0.0])  # added to the sensor's [s]


@dataclass
class Training:
    """Section ``training`` of the settings."""

    robots: int = 64  # parallel episodes
    # val arenas at every checkpoint, with 80 obstacles or the most that training has; 0: none
    validate: int = 100
    randomize: Randomize = field(default_factory=Randomize)
    arenas: dict[str, Any] = REQUIRED  # see eldenet/navigation/tasks.py

    def __post_init__(self) -> None:
        at_least(0, **{"training.validate": self.validate})


@dataclass(frozen=True)
class NavigateSettings:
    """What all modes of ``python -m eldenet.navigate`` read."""

    mode: str = "record"  # record (a video of one episode), evaluate, train
    sensor: dict[str, Any] = REQUIRED  # mixed: for training
    arena: Arenas = field(default_factory=Arenas)
    pedestrians: int = 0  # walking people in each arena; mode=train: their largest number
    # known: true distance and bearing, as from a beacon at the goal; fixes: from a noisy position once a
    # second and a filter that calibrates the odometry; odometry: drifts with the odometry
    goal: str = "known"
    time_limit: float = 60.0  # of an episode [s]
    seed: int = 0
    runtime: dict[str, Any] = field(default_factory=lambda: {"threads": "auto"})  # of torch
    output: str = "runs/navigate-${mode}-${now:%Y%m%d-%H%M%S}"  # folder for the results


@dataclass(frozen=True)
class DriveSettings(NavigateSettings):
    """mode=record and mode=evaluate: a driver in arenas."""

    # dqn; paper_literal, paper_state (dqn with that observer and learner); astar_dwa, astar_online_dwa,
    # astar_online_dqn (plans far, steers near), plan_when_stuck (dqn, and A* where it gets nowhere), dwa,
    # straight
    policy: dict[str, Any] = REQUIRED
    # run folder of a training, its policy.safetensors, or a list of these, which drive together by the mean
    # of their values; null: the packaged policy; planners have none
    checkpoint: Any = field(default=None, metadata=FROM_CHOICE)
    observer: dict[str, Any] | None = field(
        default=None, metadata=FROM_CHOICE
    )  # of policy=paper_literal and paper_state
    learner: dict[str, Any] | None = field(default=None, metadata=FROM_CHOICE)  # the same
    density: Any = 40  # number of obstacles; mode=evaluate: or a list of them, [5,20,40,80]
    split: str = "test"  # seed stream of the arenas: test, or val to choose between settings
    physics: str = "wheels"  # wheels or kinematic
    # true: no single reading decides; lone readings are dropped, narrow gaps filled; false: off; null: on if
    # single columns may be wrong (depth_camera; false_near, false_far, stuck of ranges)
    range_filter: bool | None = None
    # true: correct ranges that are all too long or too short, as the robot's own motion shows; needs wheels
    # that do not slip
    range_scale: bool = False
    # the driver knows sensor.latency and its last commands, and decides for the pose that they lead to
    predict_latency: bool = True
    robot: Robot = field(default_factory=Robot)

    def __post_init__(self) -> None:
        if any(type(density) is not int for density in listed(self.density)):
            raise ValueError(f"density={self.density}: give a whole number, or a list of them")


@dataclass(frozen=True)
class NavigateRecordSettings(DriveSettings):
    """mode=record: a video of one episode."""

    arena: ArenaOrFile = field(default_factory=ArenaOrFile)
    world: int = 0  # number of the arena
    course: str | None = None  # triangle: the paper's course around three way-points, not a random arena
    video: str = "gif"  # gif, webp (smaller) or mp4

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(listed(self.density)) != 1:
            raise ValueError(f"density={self.density}: mode=record only records one arena: give one number")
        if self.course is not None and self.arena.file is not None:
            raise ValueError(f"course={self.course} and arena.file={self.arena.file}: give only one of them")


@dataclass(frozen=True)
class NavigateEvaluateSettings(DriveSettings):
    """mode=evaluate: success, time and path length over many arenas, the same for every driver."""

    mode: str = "evaluate"
    arena: ArenaOrFile = field(default_factory=ArenaOrFile)
    episodes: int = 500  # arenas per density, one episode each
    robots: int = 32  # episodes that run at once

    def __post_init__(self) -> None:
        super().__post_init__()
        if not listed(self.density):
            raise ValueError(f"density={self.density}: give a number of obstacles, or a list of them")
        at_least(1, episodes=self.episodes, robots=self.robots)


@dataclass(frozen=True)
class NavigateTrainSettings(NavigateSettings):
    """mode=train: a new driver; physics is kinematic."""

    mode: str = "train"
    observer: dict[str, Any] = REQUIRED
    learner: dict[str, Any] = REQUIRED
    policy: dict[str, Any] | None = field(
        default=None, metadata=FROM_CHOICE
    )  # paper_literal or paper_state set observer and learner
    checkpoint: Any = field(default=None, metadata=FROM_CHOICE)  # stays null: the driver is new
    training: Training = field(default_factory=Training)

    def __post_init__(self) -> None:
        if self.policy is not None and self.policy.get("path", "planner") is not None:
            raise ValueError(
                "mode=train trains a new driver: remove checkpoint=; policy may be paper_literal or "
                "paper_state"
            )


# --- what the settings stand for ----------------------------------------------------------------------------


def episode_settings(s: DriveSettings) -> "EpisodeSettings":
    """Return the conditions of every episode."""
    from eldenet.navigation.episodes import EpisodeSettings

    return EpisodeSettings(
        physics=s.physics,
        goal=s.goal,
        time_limit=s.time_limit,
        seed=s.seed,
        range_filter=s.range_filter,
        range_scale=s.range_scale,
        robot_size=s.robot.size,
        robot_speed=s.robot.speed,
        robot_friction=s.robot.friction,
    )


def load_driver(s: DriveSettings, robots: int) -> "Policy":
    """Return the driver of ``robots`` robots; with ``predict_latency`` it knows the sensor's latency."""
    from eldenet.navigation.latency import Predictive

    driver: Policy = instantiate(s.policy, "policy")(robots=robots)
    latency = s.sensor["latency"] if s.predict_latency else 0.0
    return Predictive(driver, latency, robots) if latency else driver


def arenas_of(s: NavigateEvaluateSettings, density: Any) -> "Sequence[Arena]":
    """Return the arenas of an evaluation: those with ``density`` obstacles, or those of its file.

    Raises:
        ValueError: the file has one arena, or the settings are out of range.
    """
    from eldenet.navigation.tasks import frozen_arenas
    from eldenet.simulation.barn import read_barn

    if s.arena.file is not None:
        if s.arena.file.endswith((".yaml", ".yml")):
            raise ValueError(f"arena.file={s.arena.file}: one arena is for mode=record; give barn_worlds.npz")
        return [world.arena for world in read_barn(s.arena.file)[: s.episodes]]
    return frozen_arenas(density, s.episodes, split=s.split, pedestrians=s.pedestrians, kind=s.arena.kind)


def _arena_of(s: NavigateRecordSettings) -> "Arena":
    from eldenet.simulation.arena_files import read_arena
    from eldenet.simulation.arenas import generate_arena, triangle_course
    from eldenet.simulation.barn import read_barn

    if s.arena.file is not None and s.arena.file.endswith(".npz"):
        worlds = read_barn(s.arena.file)
        if not 0 <= s.world < len(worlds):
            raise ValueError(f"world={s.world}: give 0 to {len(worlds) - 1}")
        return worlds[s.world].arena
    if s.arena.file is not None:
        return read_arena(s.arena.file)
    if s.course is not None:
        one_of("course", s.course, ("triangle",))
        return triangle_course()
    (density,) = listed(s.density)
    return generate_arena(s.split, density, s.world, pedestrians=s.pedestrians, kind=s.arena.kind)


# --- modes --------------------------------------------------------------------------------------------------


def navigate(s: NavigateSettings) -> None:
    """Run the mode of the settings; results go to ``s.output``.

    Raises:
        ValueError: a setting does not fit, the folder holds results of another mode or command, or another
            process writes into it.
        FileNotFoundError: there is no such policy, arena or file of the sensor.
    """
    if isinstance(s, NavigateTrainSettings):
        require("mode=train", "gymnasium")
    if isinstance(s, NavigateRecordSettings) and s.video == "mp4":
        require("video=mp4", "av")
    folder = Path(s.output)
    if isinstance(s, DriveSettings):
        policy_files(s.policy.get("path"))
        refuse_to_replace(folder, s.mode)
    from eldenet.results.run_log import RunLog

    choose_resources(device="cpu", precision="fp32", **s.runtime)
    with sole_writer(folder):
        log = RunLog(folder)
        if isinstance(s, NavigateRecordSettings):
            record(s, log)
        elif isinstance(s, NavigateEvaluateSettings):
            evaluate(s, log)
        elif isinstance(s, NavigateTrainSettings):
            train(s, log)
        log.close()


def refuse_to_replace(folder: Path, mode: str) -> None:
    """Keep the ``run.json`` of another mode or command; the same mode may run again.

    Raises:
        ValueError: ``folder`` has one.
    """
    from eldenet.results.run_record import RUN_FILE, read_record

    if not (folder / RUN_FILE).is_file():
        return
    stored = read_record(folder / RUN_FILE)
    before = stored.get("mode", "evaluate" if "driver" in stored else "another command")
    if before != mode:
        raise ValueError(f"output={folder} holds results of {before}: give another output")


def record(s: NavigateRecordSettings, log: "RunLog") -> None:
    """Record a video of one episode."""
    from eldenet.navigation.visualization import VIDEO_FORMATS, record_episode
    from eldenet.simulation.arenas import arenas_hash
    from eldenet.simulation.robot import ROBOT

    one_of("video", s.video, VIDEO_FORMATS)
    arena, episode = _arena_of(s), episode_settings(s)
    driver, sensor = load_driver(s, 1), instantiate(s.sensor, "sensor")
    path = Path(s.output) / f"{driver.name}-{arena.name}.{s.video}"
    with log.bar("recording", round(s.time_limit / ROBOT.period), unit="frames") as bar:
        event, seconds = record_episode(arena, driver, sensor, path, episode, advance=bar.advance)
    outcome = event.name.lower()
    found = {"arena": arenas_hash([arena]), "outcome": outcome, "seconds": seconds, "video": path.name}
    _write_record(s, sensor, driver, found)
    log.say(f"{driver.name} in {arena.name}: {outcome} after {seconds:.1f} s; video: {path}")


def evaluate(s: NavigateEvaluateSettings, log: "RunLog") -> None:
    """Run the driver through the arenas; write a CSV row per episode."""
    from eldenet.navigation.evaluation import as_rows, run_episodes, summarize
    from eldenet.results.run_record import RUN_FILE
    from eldenet.simulation.arenas import arenas_hash

    folder, episode = Path(s.output), episode_settings(s)
    driver, sensor = load_driver(s, 1), instantiate(s.sensor, "sensor")
    load = functools.partial(load_driver, s)
    metrics, hashes, table = {}, {}, []
    for density in listed(s.density) if s.arena.file is None else [Path(s.arena.file).stem]:
        arenas = arenas_of(s, density)
        with log.bar(f"{density} obstacles", len(arenas), unit="episodes") as bar:
            rows = run_episodes(arenas, load, sensor, episode, robots=s.robots, advance=bar.advance)
        hashes[str(density)] = arenas_hash(arenas)
        write_rows(folder / f"episodes_{density}.csv", *as_rows(rows))
        metrics[str(density)] = found = summarize(rows)
        interval = f"{found['success_low']:.1f} to {found['success_high']:.1f}"
        rates = [f"{found[name]:.1f}" for name in ("collision", "timeout", "seconds")]
        table.append([str(density), f"{found['success']:.1f}", interval, *rates, f"{found['spl']:.3f}"])
    _write_record(s, sensor, driver, {"metrics": metrics, "arenas": hashes})
    filtered = "range filter, " if episode.filters(sensor) else ""
    driven = f"{s.episodes} {s.split} arenas ({s.arena.kind}) per density"
    if s.arena.file is not None:
        driven = f"{len(rows)} arenas of {s.arena.file}"
    title = f"{driver.name}, {s.physics}, goal {s.goal}, {filtered}{driven}: {folder / RUN_FILE}"
    log.table(title, ["obstacles", "success [%]", "95 %", "collision", "time-out", "time [s]", "SPL"], table)


def train(s: NavigateTrainSettings, log: "RunLog") -> None:
    """Train a driver; continue if the folder has an unfinished training."""
    from eldenet.navigation.dqn import DQN
    from eldenet.navigation.env import ArenaNavVectorEnv
    from eldenet.navigation.episodes import Randomization
    from eldenet.navigation.training import train as train_driver

    folder, sensor = Path(s.output), instantiate(s.sensor, "sensor")
    env = ArenaNavVectorEnv(
        s.training.robots,
        sensor=sensor,
        arenas=instantiate(s.training.arenas, "training.arenas"),
        time_limit=s.time_limit,
        goal=s.goal,
        randomization=Randomization(**asdict(s.training.randomize)),
        **s.observer,
    )
    learner = DQN(env, instantiate(s.learner, "learner")(seed=s.seed))
    note = train_driver(learner, sensor, folder, log, validate=s.training.validate, config=asdict(s))
    log.say(f"policy in {folder / POLICY}; {note['cpu_seconds']:.0f} s of processor time")


def _write_record(s: DriveSettings, sensor: "Sensor", driver: "Policy", found: Mapping[str, Any]) -> None:
    """Write ``run.json``: results, driver, sensor files, seed, settings, versions and the command."""
    from eldenet.navigation.provenance import driver_identity, sensor_identity
    from eldenet.results.run_record import RUN_FILE, environment

    content = {
        "mode": s.mode,
        "policy": driver.name,
        "driver": driver_identity(driver),
        "inputs": sensor_identity(sensor),
        **found,
        "seed": s.seed,
        "config": asdict(s),
        **environment(),
    }
    write_json(Path(s.output) / RUN_FILE, content)


@entry_point(NavigateSettings)
def main(s: NavigateSettings) -> None:
    """Refuse settings that a given arena replaces, then run the mode."""
    file = s.arena.file if isinstance(s, NavigateRecordSettings | NavigateEvaluateSettings) else None
    course = s.course if isinstance(s, NavigateRecordSettings) else None
    if file is not None or course is not None:
        given = f"course={course}" if file is None else f"arena.file={file}"
        unread = ["density", "pedestrians", "split", "arena.kind"]
        if file is None or not file.endswith(".npz"):
            unread.append("world")
        refuse_unread(unread, f"not read with {given}, which describes the whole arena; leave it out")
    navigate(s)


if __name__ == "__main__":
    main()

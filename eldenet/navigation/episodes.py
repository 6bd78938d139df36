"""Robots that drive through arenas: many at once, each in a slot with its own arena.

Each slot draws its random numbers from its episode's own seed, so an episode ends the same alone or among
others.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from eldenet.navigation.latency import MAX_LATENCY
from eldenet.navigation.localization import Localizer
from eldenet.navigation.observer import Senses
from eldenet.navigation.range_filter import RangeFilter
from eldenet.navigation.range_scale import RangeScale
from eldenet.navigation.sensors import (
    LATENCY_STEP,
    SUBSTEPS,
    Odometry,
    Sensor,
    SensorInstance,
    SensorScan,
)
from eldenet.simulation.arena_mjcf import FRICTION
from eldenet.simulation.arena_world import PHYSICS, ArenaWorld
from eldenet.simulation.arenas import Arena
from eldenet.simulation.robot import ROBOT
from eldenet.system.checks import one_of

GOAL_RADIUS = 0.5  # [m]
TIME_LIMIT = 60.0  # [s]
GOALS = ("known", "fixes", "odometry")
FIX_EVERY = 5  # control periods between two positions for goal="fixes"
FIX_DEVIATION = 0.15  # standard deviation of their x and y [m]
SIZES, SPEEDS = (0.5, 1.5), (0.5, 2.0)  # limits, relative to ROBOT; BARN's robots drive at up to 2 m/s


class Event(IntEnum):
    """How a control step ended."""

    NONE = 0
    GOAL = 1
    COLLISION = 2
    TIMEOUT = 3


@dataclass(frozen=True)
class EpisodeSettings:
    """Conditions of an episode, the same for every driver.

    Attributes:
        physics: "kinematic" or "wheels"; see :class:`~eldenet.simulation.arena_world.ArenaWorld`.
        goal: source of the goal's distance and bearing. "known": the true ones, as with a beacon at the goal;
            "fixes": a :class:`~eldenet.navigation.localization.Localizer` that gets a noisy position every
            second and calibrates the odometry; "odometry": the odometry alone, so they drift with it. The
            true pose decides when an episode ends.
        time_limit: [s].
        seed: of the sensors' errors; those in arena ``k`` come from ``(seed, k)``.
        range_filter: pass all ranges through a :class:`~eldenet.navigation.range_filter.RangeFilter`; None:
            if single columns of the sensor may be wrong.
        range_scale: correct ranges that are all too long or too short, with a
            :class:`~eldenet.navigation.range_scale.RangeScale`.
        robot_size: of its footprint, relative to :data:`~eldenet.simulation.robot.ROBOT`; no driver knows it.
        robot_speed: speed and turn rate that it reaches, relative to the commands; no driver knows it.
        robot_friction: between its wheels and the floor, for physics="wheels"; no driver knows it.

    Raises:
        ValueError: unknown physics or goal, a time limit, size, speed or friction out of range, or a friction
            without wheels.
    """

    physics: str = "kinematic"
    goal: str = "known"
    time_limit: float = TIME_LIMIT
    seed: int = 0
    range_filter: bool | None = False
    range_scale: bool = False
    robot_size: float = 1.0
    robot_speed: float = 1.0
    robot_friction: float = FRICTION

    def __post_init__(self) -> None:
        one_of("physics", self.physics, PHYSICS)
        one_of("goal", self.goal, GOALS)
        if not 0 < self.time_limit < math.inf:
            raise ValueError(f"time_limit={self.time_limit}: give a finite number of seconds above 0")
        for name, (low, high) in {"size": SIZES, "speed": SPEEDS, "friction": (0.05, 2.0)}.items():
            value = getattr(self, f"robot_{name}")
            if not low <= value <= high:
                raise ValueError(f"robot.{name}={value}: give {low} to {high}")
        if self.robot_friction != FRICTION and self.physics != "wheels":
            raise ValueError(
                f"robot.friction={self.robot_friction} has no effect with physics={self.physics}: choose "
                "physics=wheels"
            )

    def filters(self, sensor: Sensor) -> bool:
        """Return whether ranges of a sensor are filtered."""
        return getattr(sensor, "wrong_columns", False) if self.range_filter is None else self.range_filter


@dataclass(frozen=True)
class Randomization:
    """What a training draws for each episode, each from a range (least, greatest).

    Attributes:
        size: of the footprint, times ``settings.robot_size``; drawn for each arena.
        speed: that the robot reaches, times ``settings.robot_speed``.
        latency: added to the sensor's [s]; the sum is rounded up to :data:`LATENCY_STEP`.

    Raises:
        ValueError: a range is out of its limits or not in order.
    """

    size: Sequence[float] = (1.0, 1.0)
    speed: Sequence[float] = (1.0, 1.0)
    latency: Sequence[float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        limits = {"size": SIZES, "speed": SPEEDS, "latency": (0.0, MAX_LATENCY)}
        for name, (low, high) in limits.items():
            ends = getattr(self, name)
            if len(ends) != 2 or not low <= ends[0] <= ends[1] <= high:
                raise ValueError(
                    f"training.randomize.{name}={list(ends)}: give [least, greatest] within {low} to {high}"
                )


FIXED = Randomization()  # every episode has the same robot


class Episodes:
    """``count`` robots that drive at the same time.

    Args:
        count: number of robots, each in its slot.
        sensor: of every robot.
        settings: of every episode.
        randomization: drawn for each episode.

    Attributes:
        worlds: of each slot, once it has started.
        scans: last scan of each slot.
        poses: true x, y [m] and heading [rad] of each robot ``(N, 3)``.
        travelled: way that each robot has driven ``(N,)`` [m].
    """

    def __init__(
        self,
        count: int,
        sensor: Sensor,
        settings: EpisodeSettings = EpisodeSettings(),
        randomization: Randomization = FIXED,
    ) -> None:
        self.count, self.sensor, self.settings = count, sensor, settings
        self.randomization = randomization
        self._speeds = np.full(count, settings.robot_speed)
        self._latencies = np.full(count, sensor.latency)  # [s]
        self.worlds: dict[int, ArenaWorld] = {}
        self.scans: dict[int, SensorScan] = {}
        self._sensors: dict[int, SensorInstance] = {}
        self._odometry: dict[int, Odometry] = {}
        self._filtered = settings.filters(sensor)
        self._filters = [RangeFilter() for _ in range(count)]
        self._scales = [RangeScale() for _ in range(count)]
        self._localizers: dict[int, Localizer] = {}  # for goal="fixes" only
        self._rngs: dict[int, np.random.Generator] = {}
        self.poses = np.zeros((count, 3))
        self.travelled = np.zeros(count)
        self._commands: list[list[tuple[float, float]]] = [[] for _ in range(count)]  # since the start
        self._reached = np.zeros(count, np.intp)  # way-points so far
        self._steps = np.zeros(count, np.intp)

    def start(self, slot: int, arena: Arena, seed: Sequence[int]) -> None:
        """Put a slot's robot at the start of an arena; ``seed`` is that of its sensor's errors."""
        stream = np.random.SeedSequence(tuple(seed))
        fixes, robot = stream.spawn(2)
        size = self._randomize(slot, np.random.Generator(np.random.PCG64(robot)))
        world = self.worlds.get(slot)
        if (
            world is not None
            and world.arena.name == arena.name
            and world.arena.obstacles == arena.obstacles
            and world.arena.side == arena.side
        ):  # keep the world, and so the robot's size: building one takes longer than an episode
            world.arena = arena
            world.place(arena.start)
        else:
            world = self.worlds[slot] = ArenaWorld(
                arena, self.settings.physics, size, self.settings.robot_friction
            )
        rng = np.random.Generator(np.random.PCG64(stream))
        self._sensors[slot] = self.sensor.begin(world, rng)
        self._filters[slot].reset()
        self._scales[slot].reset()
        drift = self.sensor.drift
        self._odometry[slot] = Odometry(drift, rng, world.pose)
        if self.settings.goal == "fixes":
            self._localizers[slot] = Localizer(world.pose, deviation=FIX_DEVIATION, **drift._asdict())
            self._rngs[slot] = np.random.Generator(np.random.PCG64(fixes))
        self.poses[slot] = world.pose
        self.travelled[slot] = 0.0
        self._commands[slot] = []
        self._reached[slot] = self._steps[slot] = 0

    def _randomize(self, slot: int, rng: np.random.Generator) -> float:
        """Draw a slot's speed and latency, and return the size of its robot."""
        drawn = self.randomization
        size, speed, latency = (
            rng.uniform(low, high) for low, high in (drawn.size, drawn.speed, drawn.latency)
        )
        self._speeds[slot] = self.settings.robot_speed * speed
        self._latencies[slot] = self.sensor.latency + latency
        return self.settings.robot_size * size

    @property
    def seconds(self) -> np.ndarray:
        """Time since the start in each slot ``(N,)`` [s]."""
        return self._steps * ROBOT.period

    def waypoint(self, slot: int) -> tuple[float, float]:
        """Next way-point of a slot in the world frame [m]."""
        return self.worlds[slot].arena.waypoints[self._reached[slot]]

    def goals(self) -> np.ndarray:
        """True distance [m] and bearing [rad] of each slot's next way-point ``(N, 2)``."""
        return self._goals_from(self.poses)

    def _goals_from(self, poses: np.ndarray) -> np.ndarray:
        """As :meth:`goals`, from other poses ``(N, 3)``."""
        points = np.array([self.waypoint(slot) for slot in range(self.count)])
        dx, dy = (points - poses[:, :2]).T
        bearing = np.arctan2(dy, dx) - poses[:, 2]
        return np.stack([np.hypot(dx, dy), np.arctan2(np.sin(bearing), np.cos(bearing))], axis=1)

    def scan(self, slots: Sequence[int]) -> None:
        """Take a new scan in some slots."""
        for slot in slots:
            scan, odometry = self._sensors[slot].scan(), np.array(self._odometry[slot].pose)
            for used, part in (
                (self._filtered, self._filters[slot]),
                (self.settings.range_scale, self._scales[slot]),
            ):
                if used:
                    ranges, cautious = part(scan.ranges, odometry, scan.cautious)
                    scan = scan._replace(ranges=ranges, cautious=cautious)
            self.scans[slot] = scan

    def senses(self) -> Senses:
        """Ranges of the last scans, with odometry and goals as of now."""
        slots = range(self.count)
        scans = [self.scans[slot] for slot in slots]
        ranges = np.stack([scan.ranges for scan in scans])
        told = any(scan.cautious is not None for scan in scans)
        cautious = [scan.ranges if scan.cautious is None else scan.cautious for scan in scans]
        odometry = np.array([self._odometry[slot].pose for slot in slots])
        if self.settings.goal == "fixes":
            odometry = np.array([self._localizers[slot].odometry for slot in slots])
            goals = np.array([self._localizers[slot].towards(*self.waypoint(slot)) for slot in slots])
        else:
            goals = self._goals_from(odometry if self.settings.goal == "odometry" else self.poses)
        return Senses(ranges, odometry, goals, np.stack(cautious) if told else None)

    def sense(self, slots: Sequence[int] | None = None) -> Senses:
        """Scan in all slots, or in some of them, and return the senses of all."""
        self.scan(range(self.count) if slots is None else slots)
        return self.senses()

    def step(self, commands: np.ndarray, slots: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Drive every robot (or those of ``slots``) for one control period.

        Returns:
            Progress toward the way-point ``(N,)`` [m] and :class:`Event` ``(N,)``.

        Raises:
            ValueError: a command is not finite; its robot and those after it do not move.
        """
        progress, events = np.zeros(self.count), np.zeros(self.count, np.intp)
        for slot in range(self.count) if slots is None else slots:
            speed, turn = commands[slot].tolist()
            if not (math.isfinite(speed) and math.isfinite(turn)):
                raise ValueError(f"the driver commands {speed} m/s and {turn} rad/s: give finite numbers")
            self._commands[slot].append((speed, turn))
            progress[slot], events[slot] = self._drive(slot)
        return progress, events

    def _command(self, slot: int, substep: int) -> tuple[float, float]:
        """Command executed in a part of the current period: the newest that is as old as the latency."""
        late = math.ceil((self._latencies[slot] - substep * LATENCY_STEP) / ROBOT.period - 1e-9)
        number = len(self._commands[slot]) - 1 - max(late, 0)
        speed, turn = self._commands[slot][number] if number >= 0 else (0.0, 0.0)
        return speed * float(self._speeds[slot]), turn * float(self._speeds[slot])

    def _drive(self, slot: int) -> tuple[float, Event]:
        """Drive one robot for one period; progress is toward the way-point at its start."""
        world, waypoint = self.worlds[slot], self.waypoint(slot)
        distance = before = math.dist(self.poses[slot, :2], waypoint)
        event = Event.NONE
        self._steps[slot] += 1
        for substep in range(SUBSTEPS):
            last = world.pose
            collided = world.advance(*self._command(slot, substep), LATENCY_STEP)
            pose = world.pose
            self.travelled[slot] += math.dist(last[:2], pose[:2])
            self._odometry[slot].move(last, pose)
            distance = math.dist(pose[:2], waypoint)
            if collided:
                event = Event.COLLISION
                break
            if math.dist(pose[:2], self.waypoint(slot)) < GOAL_RADIUS:
                if self._reached[slot] + 1 == len(world.arena.waypoints):
                    event = Event.GOAL
                    break
                self._reached[slot] += 1  # the period continues toward the next one
        self.poses[slot] = world.pose
        if self.settings.goal == "fixes":
            self._localize(slot)
        if event is Event.NONE and self._steps[slot] * ROBOT.period >= self.settings.time_limit - 1e-9:
            event = Event.TIMEOUT
        return before - distance, event

    def _localize(self, slot: int) -> None:
        """Pass the odometry to the localizer, and a position when one is due."""
        self._localizers[slot].move(self._odometry[slot].pose)
        if self._steps[slot] % FIX_EVERY == 0:
            error = FIX_DEVIATION * self._rngs[slot].standard_normal(2)
            self._localizers[slot].fix(*(self.poses[slot, :2] + error).tolist())

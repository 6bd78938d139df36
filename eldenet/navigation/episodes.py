"""Robots that cross arenas: many at once, one arena each, told apart by slot.

A slot's random numbers come from its crossing's own seed, so a crossing ends the same alone or among others.
"""

import math
from collections.abc import Sequence
from enum import IntEnum

import numpy as np

from eldenet.navigation.localization import Fixes, Localizer
from eldenet.navigation.observer import Senses
from eldenet.navigation.sensors import Eye, Odometry, Sensor, Sight
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import Arena
from eldenet.simulation.robot import ROBOT

SUBSTEPS = 2  # of a control period, after each of which contacts are looked for: at most 10 cm apart
GOAL_RADIUS = 0.5  # [m]
TIME_LIMIT = 60.0  # [s]
GOALS = ("known", "fixes", "odometry")


class Event(IntEnum):
    """How a control step ended."""

    NONE = 0
    GOAL = 1
    COLLISION = 2
    TIMEOUT = 3


class Crossings:
    """``count`` robots under way.

    Args:
        count: of robots.
        sensor: what they see with.
        physics: "kinematic" or "wheels"; see :class:`~eldenet.simulation.arena_world.ArenaWorld`.
        time_limit: of a crossing [s].
        goal: where the robot takes the goal's distance and bearing from. "known": always the true ones, as
            with a beacon at the goal; "fixes": from a :class:`~eldenet.navigation.localization.Localizer`
            that gets a noisy position now and then, and calibrates the odometry; "odometry": from where the
            odometry believes it is, as on a robot without either, so that they drift with it. The true pose
            ends a crossing in all.
        fixes: how often "fixes" come and how good they are.

    Raises:
        ValueError: unknown goal.

    Attributes:
        worlds: one per slot.
        sights: what each slot's camera gave last, with its pictures where it has any.
    """

    def __init__(
        self,
        count: int,
        sensor: Sensor,
        *,
        physics: str = "kinematic",
        time_limit: float = TIME_LIMIT,
        goal: str = "known",
        fixes: Fixes = Fixes(),  # noqa: B008 - immutable
    ) -> None:
        if goal not in GOALS:
            raise ValueError(f"goal={goal!r}: choose one of {', '.join(GOALS)}")
        self.goal_from, self.fixes = goal, fixes
        self.count, self.sensor, self.physics, self.time_limit = count, sensor, physics, time_limit
        self.worlds: list[ArenaWorld | None] = [None] * count
        self.sights: list[Sight | None] = [None] * count
        self._eyes: list[Eye | None] = [None] * count
        self._odometry: list[Odometry | None] = [None] * count
        self._localizers: list[Localizer | None] = [None] * count  # of goal="fixes" alone
        self._rngs: list[np.random.Generator | None] = [None] * count
        self.poses = np.zeros((count, 3))  # where they are
        self.travelled = np.zeros(count)  # [m]
        self._waypoint = np.zeros(count, np.intp)
        self._steps = np.zeros(count, np.intp)

    def start(self, slot: int, arena: Arena, seed: Sequence[int]) -> None:
        """Put the robot of a slot at the start of an arena; ``seed`` is of its sensor's errors."""
        world = self.worlds[slot]
        if world is not None and world.arena.obstacles == arena.obstacles and world.arena.side == arena.side:
            world.arena = arena
            world.place(arena.start)
        else:
            world = self.worlds[slot] = ArenaWorld(arena, self.physics)
        stream = np.random.SeedSequence(tuple(seed))
        rng = np.random.Generator(np.random.PCG64(stream))
        self._eyes[slot] = self.sensor.begin(world, rng)
        self._odometry[slot] = Odometry(self.sensor.drift, rng, world.pose)
        if self.goal_from == "fixes":
            drift = self.sensor.drift
            self._localizers[slot] = Localizer(
                world.pose, deviation=self.fixes.deviation, distance=drift.distance, heading=drift.heading
            )
            self._rngs[slot] = np.random.Generator(np.random.PCG64(stream.spawn(1)[0]))
        self.poses[slot] = world.pose
        self.travelled[slot] = 0.0
        self._waypoint[slot] = self._steps[slot] = 0

    @property
    def seconds(self) -> np.ndarray:
        """Time under way of every slot ``(N,)`` [s]."""
        return self._steps * ROBOT.period

    def goal(self, slot: int) -> tuple[float, float]:
        """Next way-point of a slot in the world [m]."""
        world = self._world(slot)
        return world.arena.waypoints[self._waypoint[slot]]

    def goals(self) -> np.ndarray:
        """True distance [m] and bearing [rad] of every slot's next way-point ``(N, 2)``."""
        return self._goals_from(self.poses)

    def _goals_from(self, poses: np.ndarray) -> np.ndarray:
        points = np.array([self.goal(slot) for slot in range(self.count)])
        dx, dy = (points - poses[:, :2]).T
        bearing = np.arctan2(dy, dx) - poses[:, 2]
        return np.stack([np.hypot(dx, dy), np.arctan2(np.sin(bearing), np.cos(bearing))], axis=1)

    def look(self, slots: Sequence[int]) -> None:
        """Let the cameras of some slots look."""
        for slot in slots:
            self.sights[slot] = self._eyes[slot].look()  # type: ignore[union-attr]

    def senses(self) -> Senses:
        """What the robots sensed when they looked last, with odometry and goals as they are now."""
        ranges = np.stack([sight.ranges for sight in self.sights if sight is not None])
        odometry = np.array([odometry.pose for odometry in self._odometry if odometry is not None])
        if self.goal_from == "fixes":
            believed = [localizer for localizer in self._localizers if localizer is not None]
            odometry = np.array([localizer.odometry for localizer in believed])
            goals = np.array([one.towards(*self.goal(slot)) for slot, one in enumerate(believed)])
        else:
            goals = self._goals_from(odometry if self.goal_from == "odometry" else self.poses)
        return Senses(ranges, odometry, goals)

    def sense(self, slots: Sequence[int] | None = None) -> Senses:
        """Look and sense: all slots, or new looks of some and the last ones of the others."""
        self.look(range(self.count) if slots is None else slots)
        return self.senses()

    def step(self, commands: np.ndarray, slots: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Drive every robot (or those of ``slots``) for one control period.

        Returns:
            Progress towards the way-point ``(N,)`` [m] and :class:`Event` ``(N,)``.
        """
        progress, events = np.zeros(self.count), np.zeros(self.count, np.intp)
        for slot in range(self.count) if slots is None else slots:
            progress[slot], events[slot] = self._drive(
                slot, float(commands[slot, 0]), float(commands[slot, 1])
            )
        return progress, events

    def _drive(self, slot: int, speed: float, turn: float) -> tuple[float, Event]:
        """One robot, one period: collision is looked for before the goal.

        Progress is towards the way-point that the period began with.
        """
        world = self._world(slot)
        goal = self.goal(slot)
        before = math.dist(self.poses[slot, :2], goal)
        event = Event.NONE
        self._steps[slot] += 1
        distance = before
        for _ in range(SUBSTEPS):
            last = world.pose
            collided = world.advance(speed, turn, ROBOT.period / SUBSTEPS)
            pose = world.pose
            self.travelled[slot] += math.dist(last[:2], pose[:2])
            self._odometry[slot].move(last, pose)  # type: ignore[union-attr]
            distance = math.dist(pose[:2], goal)
            if collided:
                event = Event.COLLISION
                break
            if math.dist(pose[:2], self.goal(slot)) < GOAL_RADIUS:
                if self._waypoint[slot] + 1 == len(world.arena.waypoints):
                    event = Event.GOAL
                    break
                self._waypoint[slot] += 1  # a way-point on the way ends no period
        self.poses[slot] = world.pose
        self._localize(slot)
        if event is Event.NONE and self._steps[slot] * ROBOT.period >= self.time_limit - 1e-9:
            event = Event.TIMEOUT
        return before - distance, event

    def _localize(self, slot: int) -> None:
        """Tell the localizer what the wheels did, and where it is when a fix is due."""
        localizer, rng = self._localizers[slot], self._rngs[slot]
        if localizer is None or rng is None:
            return
        localizer.move(self._odometry[slot].pose)  # type: ignore[union-attr]
        due = max(1, round(self.fixes.period / ROBOT.period))
        if self._steps[slot] % due == 0:
            error = self.fixes.deviation * rng.standard_normal(2)
            localizer.fix(*(self.poses[slot, :2] + error).tolist())

    def _world(self, slot: int) -> ArenaWorld:
        world = self.worlds[slot]
        if world is None:
            raise ValueError(f"slot {slot} has no arena: call start first")
        return world

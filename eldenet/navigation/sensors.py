"""Interface of all sensors, the simulator's own ranges, and wheel odometry.

A :class:`Sensor` starts a :class:`SensorInstance` for each episode, which returns an
:class:`Observation` per scan.
:mod:`eldenet.navigation.noisy_ranges` adds a network's errors to the ranges,
:mod:`eldenet.navigation.cameras` runs the networks themselves.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np

from eldenet.boxes import Boxes3D
from eldenet.navigation.localization import Pose
from eldenet.navigation.observer import SECTORS
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.robot import ROBOT

FED_BY = ("simulator", "depth", "box")


class Observation(NamedTuple):
    """Result of one scan.

    Attributes:
        ranges: ``(columns,)`` [m].
        fed_by: ``(columns,)`` source of each column's range, as an index into :data:`FED_BY`.
        image: ``(H, W, 3)`` uint8 RGB, if there is a camera.
        depth: ``(H, W)`` [m], if there is a network.
        boxes: in the level camera frame, if there is a detector.
        cautious: ``(columns,)`` [m] how near things may be, if the network knows its sigma.
    """

    ranges: np.ndarray
    fed_by: np.ndarray
    image: np.ndarray | None = None
    depth: np.ndarray | None = None
    boxes: Boxes3D | None = None
    cautious: np.ndarray | None = None

    @property
    def sectors(self) -> np.ndarray:
        """Nearest range of each of the five sectors ``(5,)`` [m], right to left."""
        return np.asarray(self.ranges.reshape(SECTORS, -1).min(axis=1))

    @property
    def sectors_fed_by(self) -> tuple[str, ...]:
        """Source of each sector's nearest range: "simulator", "depth" or "box"."""
        nearest = self.ranges.reshape(SECTORS, -1).argmin(axis=1)[:, None]
        sources = np.take_along_axis(self.fed_by.reshape(SECTORS, -1), nearest, axis=1)[:, 0]
        return tuple(FED_BY[int(number)] for number in sources)


class SensorInstance(Protocol):
    """A sensor in one episode; scans once per control period."""

    def scan(self) -> Observation: ...  # noqa: D102


class Sensor(Protocol):
    """Starts a :class:`SensorInstance` for each episode; ``drift`` is that of the odometry used with it."""

    drift: "Drift"

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> SensorInstance: ...  # noqa: D102


class Drift(NamedTuple):
    """Errors of wheel odometry, drawn from normal distributions once per episode.

    Attributes:
        distance: standard deviation of the scale of distances.
        heading: standard deviation of the heading's drift [rad/m].
    """

    distance: float = 0.02
    heading: float = math.radians(1.0)


EXACT = Drift(0.0, 0.0)


class Odometry:
    """Pose estimate from the true motion with a scale error and a drifting heading."""

    def __init__(self, drift: Drift, rng: np.random.Generator, pose: Pose) -> None:
        self.scale = 1.0 + drift.distance * rng.standard_normal()
        self.turn_per_meter = drift.heading * rng.standard_normal()
        self.pose = pose

    def move(self, before: Pose, after: Pose) -> None:
        """Update the estimate with a true motion."""
        dx, dy = after[0] - before[0], after[1] - before[1]
        x, y, yaw = self.pose
        error = yaw - before[2]
        c, s = math.cos(error), math.sin(error)
        x += self.scale * (c * dx - s * dy)
        y += self.scale * (s * dx + c * dy)
        self.pose = (x, y, after[2] + error + self.turn_per_meter * math.hypot(dx, dy))


class Ranges:
    """The simulator's own ranges and exact odometry."""

    drift = EXACT

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> SensorInstance:
        """Return an instance that uses no random numbers."""
        return _TrueRanges(world)


class _TrueRanges:
    def __init__(self, world: ArenaWorld) -> None:
        self.world = world

    def scan(self) -> Observation:
        return Observation(self.world.ranges(), np.zeros(ROBOT.columns, np.intp))

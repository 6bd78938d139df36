"""What feeds the sectors: the interface of all sensors, the simulator's own ranges, and wheel odometry.

A :class:`Sensor` makes an :class:`Eye` per crossing; an eye looks and returns a :class:`Sight`. Ranges with a
network's errors are in :mod:`eldenet.navigation.noisy_ranges`, networks themselves in
:mod:`eldenet.navigation.cameras`.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np

from eldenet.boxes import Boxes3D
from eldenet.navigation.observer import SECTORS
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.robot import ROBOT

Pose = tuple[float, float, float]
FED_BY = ("simulator", "depth", "box")


class Sight(NamedTuple):
    """What one look gave.

    Attributes:
        ranges: ``(columns,)`` [m].
        fed_by: ``(columns,)`` numbers of :data:`FED_BY`: what each column rests on.
        image: ``(H, W, 3)`` uint8 RGB, where there is a camera.
        depth: ``(H, W)`` [m], where there is a network.
        boxes: in the level frame of the camera, where there is a detector.
    """

    ranges: np.ndarray
    fed_by: np.ndarray
    image: np.ndarray | None = None
    depth: np.ndarray | None = None
    boxes: Boxes3D | None = None

    @property
    def sectors(self) -> np.ndarray:
        """Nearest range of each of the five sectors ``(5,)`` [m], right to left."""
        return np.asarray(self.ranges.reshape(SECTORS, -1).min(axis=1))

    @property
    def sectors_fed_by(self) -> tuple[str, ...]:
        """What the nearest range of each sector rests on: "simulator", "depth" or "box"."""
        nearest = self.ranges.reshape(SECTORS, -1).argmin(axis=1)[:, None]
        sources = np.take_along_axis(self.fed_by.reshape(SECTORS, -1), nearest, axis=1)[:, 0]
        return tuple(FED_BY[int(number)] for number in sources)


class Eye(Protocol):
    """Looks, once a control period."""

    def look(self) -> Sight: ...  # noqa: D102


class Sensor(Protocol):
    """Makes the eye of one crossing. ``drift`` is the odometry's that goes with it."""

    drift: "Drift"

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> Eye: ...  # noqa: D102


class Drift(NamedTuple):
    """Errors of wheel odometry, each drawn once a crossing from a normal distribution.

    Attributes:
        distance: standard deviation of the scale of distances.
        heading: standard deviation of the heading's drift [rad/m].
    """

    distance: float = 0.02
    heading: float = math.radians(1.0)


EXACT = Drift(0.0, 0.0)


class Odometry:
    """Where the robot believes it is: its true motion with a scale error and a heading that drifts."""

    def __init__(self, drift: Drift, rng: np.random.Generator, pose: Pose) -> None:
        self.scale = 1.0 + drift.distance * rng.standard_normal()
        self.turn_per_meter = drift.heading * rng.standard_normal()
        self.pose = pose

    def move(self, before: Pose, after: Pose) -> None:
        """Take over a true motion."""
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

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> Eye:
        """An eye that needs no random numbers."""
        return _TrueEye(world)


class _TrueEye:
    def __init__(self, world: ArenaWorld) -> None:
        self.world = world

    def look(self) -> Sight:
        return Sight(self.world.ranges(), np.zeros(ROBOT.columns, np.intp))

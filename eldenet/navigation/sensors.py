"""Interface of all sensors, the simulator's own ranges, and wheel odometry.

A :class:`Sensor` starts a :class:`SensorInstance` for each episode, which returns a
:class:`SensorScan` each time.
:mod:`eldenet.navigation.noisy_ranges` adds a network's errors to the ranges,
:mod:`eldenet.navigation.cameras` runs the networks themselves.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from eldenet.boxes import Boxes3D
from eldenet.navigation.latency import MAX_LATENCY, milliseconds_hint
from eldenet.navigation.localization import EXACT, Drift, Pose
from eldenet.navigation.observer import SECTORS
from eldenet.navigation.ranges import LEAST_VIEW
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.robot import ALL_ROUND, ROBOT, front

FED_BY = ("simulator", "depth", "box")
#: Parts of a control period: a command may take effect at each start, contact is checked by each end.
SUBSTEPS = 2
LATENCY_STEP = ROBOT.period / SUBSTEPS  # [s]
FULL_VIEW = round(math.degrees(ROBOT.field_of_view), 1)  # [degrees]
BURST = 5  # scans in a row that are lost, in the mean


class SensorScan(NamedTuple):
    """What a sensor measures at one time.

    Attributes:
        ranges: ``(columns,)`` [m]: the camera's, or a lidar's all round.
        fed_by: ``(columns,)`` source of each column's range, as an index into :data:`FED_BY`.
        image: ``(H, W, 3)`` uint8 RGB, of a camera.
        depth: ``(H, W)`` [m], of a camera: its network's, or without one the renderer's.
        boxes: in the level camera frame, of a camera with a lifter.
        cautious: ``(columns,)`` [m] how near things may be, 0 in columns out of view; None: as ``ranges``.
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
        return np.asarray(front(self.ranges).reshape(SECTORS, -1).min(axis=1))

    @property
    def sectors_fed_by(self) -> tuple[str, ...]:
        """Source of each sector's nearest range: "simulator", "depth" or "box"."""
        nearest = front(self.ranges).reshape(SECTORS, -1).argmin(axis=1)[:, None]
        sources = np.take_along_axis(front(self.fed_by).reshape(SECTORS, -1), nearest, axis=1)[:, 0]
        return tuple(FED_BY[int(number)] for number in sources)


class SensorInstance(Protocol):
    """A sensor in one episode; scans once per control period."""

    def scan(self) -> SensorScan: ...  # noqa: D102


class Sensor(Protocol):
    """Starts a :class:`SensorInstance` for each episode.

    Attributes:
        drift: of the odometry used with it.
        latency: from a scan until the command that was decided on it takes effect [s], a multiple of
            :data:`LATENCY_STEP`; until then earlier commands last, and at the start the robot stands.

    A sensor whose single columns may be wrong says so by an attribute ``wrong_columns``.
    """

    drift: Drift
    latency: float

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> SensorInstance: ...  # noqa: D102


class SimulatedSensor:
    """Base of the sensors here: what they have in common.

    Args:
        drift: of the odometry, or its two values by name.
        latency: from a scan until its command takes effect [s].

    Raises:
        ValueError: a value of the drift is not a standard deviation, or the latency is out of range or not a
            multiple of :data:`LATENCY_STEP`.
    """

    def __init__(self, *, drift: Drift | Mapping[str, float] = EXACT, latency: float = 0.0) -> None:
        self.drift, self.latency = drift if isinstance(drift, Drift) else Drift(**drift), latency
        for name, value in self.drift._asdict().items():
            if not 0 <= value < math.inf:
                raise ValueError(
                    f"sensor.drift.{name}={value}: give a finite standard deviation of 0 or more"
                )
        steps = latency / LATENCY_STEP
        if not (0 <= latency <= MAX_LATENCY and abs(steps - round(steps)) < 1e-6):
            raise ValueError(
                f"sensor.latency={latency}: give 0 to {MAX_LATENCY} s in steps of {LATENCY_STEP}, as 0.2"
                + milliseconds_hint(latency)
            )


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


class Ranges(SimulatedSensor):
    """The simulator's own ranges and exact odometry; on request with wrong readings, drift and latency.

    Args:
        false_near: share of the columns, redrawn in each scan, that read as nearest.
        false_far: share of the columns, redrawn in each scan, that read as if nothing were there.
        stuck: columns, drawn once per episode, that always read as nearest.
        factor: of all ranges: 0.85 reads everything 15 % too near.
        view: field of view [degrees]: of a camera, or wider, of a lidar at its place; columns beside it are
            never seen.
        lost: share of the scans that are lost, in bursts of one second on average; the previous scan is
            repeated. The first scan of an episode is never lost.

    ``drift`` and ``latency`` are those of :class:`SimulatedSensor`.

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(
        self,
        *,
        false_near: float = 0.0,
        false_far: float = 0.0,
        stuck: int = 0,
        factor: float = 1.0,
        view: float = FULL_VIEW,
        lost: float = 0.0,
        drift: Drift | Mapping[str, float] = EXACT,
        latency: float = 0.0,
    ) -> None:
        super().__init__(drift=drift, latency=latency)
        for name, value, low, high in (
            ("false_near", false_near, 0, 1),
            ("false_far", false_far, 0, 1),
            ("stuck", stuck, 0, ROBOT.columns),
            ("factor", factor, 0.5, 2),
            ("view", view, LEAST_VIEW, 360),
            ("lost", lost, 0, 0.5),
        ):
            if not low <= value <= high:
                raise ValueError(f"sensor.{name}={value}: give {low:g} to {high:g}")
        self.false_near, self.false_far, self.stuck = false_near, false_far, stuck
        self.factor, self.lost, self.view = factor, lost, view
        self.layout = ROBOT if view <= FULL_VIEW else ALL_ROUND  # whose columns a scan has
        self.wrong_columns = bool(false_near or false_far or stuck)

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> SensorInstance:
        """Return an instance, which uses no random numbers without wrong readings."""
        wrong = self.wrong_columns or self.lost or self.factor != 1
        whole = _WrongRanges(self, world, rng) if wrong else _TrueRanges(self, world)
        return whole if self.view == FULL_VIEW else _NarrowView(whole, self)


class _TrueRanges:
    def __init__(self, sensor: Ranges, world: ArenaWorld) -> None:
        self.layout, self.world = sensor.layout, world

    def scan(self) -> SensorScan:
        return SensorScan(self.world.ranges(self.layout), np.zeros(self.layout.columns, np.intp))


class Centers(SimulatedSensor):
    """Distances to the centers of the objects in view, as an ideal detector with 3D boxes would give them.

    The column of an object's center has the distance to it, the others see nothing: walls are no objects. A
    center beside the view counts in the outermost column. For ``observer=paper`` alone: planners and the
    memory take ranges for surfaces.

    The arguments are those of :class:`SimulatedSensor`.
    """

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> SensorInstance:
        """Return an instance, which uses no random numbers."""
        return _TrueCenters(world)


class _TrueCenters:
    def __init__(self, world: ArenaWorld) -> None:
        self.world = world

    def scan(self) -> SensorScan:
        ranges = np.full(ROBOT.columns, ROBOT.far)
        x, y, _ = ROBOT.camera_center(self.world.pose)
        dx, dy = (self.world.centers() - (x, y)).T
        bearing = np.arctan2(dy, dx) - self.world.pose[2]
        bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
        column = (bearing / ROBOT.field_of_view + 0.5) * ROBOT.columns
        column = np.clip(column, 0, ROBOT.columns - 1).astype(np.intp)
        np.minimum.at(ranges, column, np.hypot(dx, dy))
        return SensorScan(np.maximum(ranges, ROBOT.near), np.zeros(ROBOT.columns, np.intp))


class _NarrowView:
    def __init__(self, whole: SensorInstance, sensor: Ranges) -> None:
        self.whole = whole
        self.unseen = np.abs(sensor.layout.column_angles) > math.radians(sensor.view) / 2

    def scan(self) -> SensorScan:
        scan = self.whole.scan()
        return scan._replace(
            ranges=np.where(self.unseen, ROBOT.far, scan.ranges),
            cautious=np.where(self.unseen, 0.0, scan.ranges),
        )


class _WrongRanges:
    def __init__(self, sensor: Ranges, world: ArenaWorld, rng: np.random.Generator) -> None:
        self.sensor, self.world, self.rng = sensor, world, rng
        self.layout = sensor.layout
        self.stuck = rng.permutation(self.layout.columns)[: sensor.stuck]
        self.last: np.ndarray | None = None
        self.losing = False

    def scan(self) -> SensorScan:
        if self.sensor.lost and self.last is not None:
            self.losing = self.rng.random() < self._chance_to_lose()
            if self.losing:
                return SensorScan(self.last.copy(), np.zeros(self.layout.columns, np.intp))
        ranges, chance = self.world.ranges(self.layout), self.rng.random(self.layout.columns)
        hit = ranges < ROBOT.far
        ranges[hit] = np.clip(self.sensor.factor * ranges[hit], self.layout.near, ROBOT.far)
        ranges[chance < self.sensor.false_near] = ROBOT.near
        ranges[chance > 1 - self.sensor.false_far] = ROBOT.far
        ranges[self.stuck] = ROBOT.near
        self.last = ranges
        return SensorScan(ranges.copy(), np.zeros(self.layout.columns, np.intp))

    def _chance_to_lose(self) -> float:
        """Of the next scan: a burst goes on, or a new one begins as often as the share asks for."""
        lost = self.sensor.lost
        return 1 - 1 / BURST if self.losing else lost / (1 - lost) / BURST

"""What feeds the sectors: the simulator's ranges, ranges with a network's errors, or a network itself.

A :class:`Sensor` makes an :class:`Eye` per crossing; an eye looks and returns a :class:`Sight`.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from eldenet.navigation.ranges import depth_to_ranges, footprints_to_ranges
from eldenet.robot import ROBOT
from eldenet.simulation.arena_world import ArenaWorld

Pose = tuple[float, float, float]
FED_BY = ("simulator", "depth", "boxes")


class Sight(NamedTuple):
    """What one look gave.

    Attributes:
        ranges: ``(columns,)`` [m].
        fed_by: ``(columns,)`` numbers of :data:`FED_BY`: what each column rests on.
        image: ``(H, W, 3)`` uint8 RGB, where there is a camera.
        depth: ``(H, W)`` [m], where there is a network.
        boxes: whatever the detector's boxes are, where there is one.
    """

    ranges: np.ndarray
    fed_by: np.ndarray
    image: np.ndarray | None = None
    depth: np.ndarray | None = None
    boxes: Any = None


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
        self.turn_per_metre = drift.heading * rng.standard_normal()
        self.pose = pose

    def move(self, before: Pose, after: Pose) -> None:
        """Take over a true motion."""
        dx, dy = after[0] - before[0], after[1] - before[1]
        x, y, yaw = self.pose
        error = yaw - before[2]
        c, s = math.cos(error), math.sin(error)
        x += self.scale * (c * dx - s * dy)
        y += self.scale * (s * dx + c * dy)
        self.pose = (x, y, after[2] + error + self.turn_per_metre * math.hypot(dx, dy))


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


class NoisyRanges:
    """The simulator's ranges with the errors of a depth network.

    Relative errors, as depth networks make them: a scale that wanders from frame to frame (correlation
    ``memory``), a smooth error over neighbouring columns, and an error of each column.

    Args:
        scale: standard deviation of the frame's scale.
        smooth: standard deviation of the error that about four neighbouring columns share.
        column: standard deviation of each column's own error.
        memory: correlation of a frame's scale with the frame before.
        drift: of the odometry.
    """

    def __init__(
        self,
        scale: float = 0.08,
        smooth: float = 0.05,
        column: float = 0.03,
        memory: float = 0.8,
        drift: Drift | dict[str, float] = Drift(),  # noqa: B008 - immutable
    ) -> None:
        if min(scale, smooth, column) < 0 or not 0 <= memory < 1:
            raise ValueError(
                f"scale={scale}, smooth={smooth}, column={column}, memory={memory}: deviations from 0, "
                "the memory is in [0, 1)"
            )
        self.scale, self.smooth, self.column, self.memory = scale, smooth, column, memory
        self.drift = Drift(**drift) if isinstance(drift, dict) else drift

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> Eye:
        """An eye with its own error process."""
        return _NoisyEye(self, world, rng)


class _NoisyEye:
    def __init__(self, sensor: NoisyRanges, world: ArenaWorld, rng: np.random.Generator) -> None:
        self.sensor, self.world, self.rng = sensor, world, rng
        self.scale = sensor.scale * rng.standard_normal()

    def look(self) -> Sight:
        s, rng = self.sensor, self.rng
        self.scale = s.memory * self.scale + math.sqrt(1 - s.memory**2) * s.scale * rng.standard_normal()
        coarse = rng.standard_normal(ROBOT.columns // 4 + 2)
        at = np.arange(ROBOT.columns) / 4 + rng.random()
        shared = s.smooth * np.interp(at, np.arange(len(coarse)), coarse)
        own = s.column * rng.standard_normal(ROBOT.columns)
        ranges = self.world.ranges()
        wrong = ranges * np.exp(self.scale + shared + own)
        wrong[ranges >= ROBOT.far] = ROBOT.far
        return Sight(np.clip(wrong, ROBOT.near, ROBOT.far), np.zeros(ROBOT.columns, np.intp))


class Camera:
    """A rendered RGB frame, a depth network, and the nearest range in each column of its depth.

    Args:
        predictor: frame ``(H, W, 3)`` uint8 RGB -> depth ``(H, W)`` [m], such as
            :class:`eldenet.predictor.DepthPredictor`; None: the renderer's own depth (what a perfect network
            would give).
        boxes: ``(frame, depth, intrinsics) -> footprints (K, 5)``, a row for every detected object: middle
            ahead of and left of the camera [m], yaw [rad], half length, half width [m]. An object's columns
            are its near face, and the other columns come from depth.
        size: of the frame, ``(height, width)`` [px].
        light: brightness of the lamps, as a share of a normal day's.
        drift: of the odometry.
    """

    def __init__(
        self,
        predictor: Callable[[np.ndarray], np.ndarray] | None = None,
        boxes: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None,
        *,
        size: tuple[int, int] = (120, 160),
        light: float = 1.0,
        drift: Drift = Drift(),  # noqa: B008 - immutable
    ) -> None:
        self.predictor, self.boxes, self.size, self.light, self.drift = predictor, boxes, size, light, drift

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> Eye:
        """An eye with a view of the arena."""
        from eldenet.simulation.arena_view import ArenaView

        return _CameraEye(self, world, ArenaView(world.arena, self.size, light=self.light), rng)


class _CameraEye:
    def __init__(self, sensor: Camera, world: ArenaWorld, view: Any, rng: np.random.Generator) -> None:
        self.sensor, self.world, self.view, self.rng = sensor, world, view, rng

    def look(self) -> Sight:
        photo = self.view.photo(self.world.pose, self.world.time, int(self.rng.integers(2**31)))
        frame = photo.image
        depth = photo.depth if self.sensor.predictor is None else self.sensor.predictor(frame)
        ranges = depth_to_ranges(depth, self.view.intrinsics)
        fed_by = np.full(ROBOT.columns, FED_BY.index("depth"), np.intp)
        footprints = None
        if self.sensor.boxes is not None:
            footprints = self.sensor.boxes(frame, depth, self.view.intrinsics)
            faces = footprints_to_ranges(footprints)
            covered = faces < ROBOT.far
            ranges = np.where(covered, faces, ranges)
            fed_by[covered] = FED_BY.index("boxes")
        return Sight(ranges, fed_by, frame, depth, footprints)


def camera(
    checkpoint: str | None = None,
    *,
    size: tuple[int, int] = (120, 160),
    light: float = 1.0,
    drift: Drift | dict[str, float] = Drift(),  # noqa: B008 - immutable
) -> Camera:
    """A :class:`Camera` with the depth network of a run folder, model folder or Hub id; None: true depth."""
    predictor = None
    if checkpoint is not None:
        from pathlib import Path

        from eldenet.model import DepthNet
        from eldenet.predictor import DepthPredictor

        inner = Path(checkpoint) / "model"
        folder = inner if (inner / "config.json").is_file() else checkpoint
        predictor = DepthPredictor(DepthNet.from_pretrained(folder))
    drift = Drift(**drift) if isinstance(drift, dict) else drift
    return Camera(predictor, size=(int(size[0]), int(size[1])), light=light, drift=drift)

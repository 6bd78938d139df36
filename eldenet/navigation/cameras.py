"""Sensors with a camera: rendered RGB, a depth network, and 3D boxes of detected objects."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D
from eldenet.deploy.predictor import for_camera
from eldenet.geometry import PinholeCamera, level_rotation
from eldenet.navigation.localization import USUAL, Drift
from eldenet.navigation.ranges import (
    CAUTION,
    MOST_TILTED,
    columns_of,
    depth_to_ranges,
    fill_unseen,
    footprints_to_ranges,
)
from eldenet.navigation.sensors import FED_BY, SensorInstance, SensorScan, SimulatedSensor
from eldenet.perception.detectors import Detector
from eldenet.perception.ground import flat_ground
from eldenet.perception.lifter import BoxLifter, Method
from eldenet.perception.priors import PRIORS, ClassPrior
from eldenet.simulation.arena_view import (
    ArenaView,
    Photo,
    camera_pose,
    robot_intrinsics,
    simulated_detections,
)
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.depth_camera import StereoArtifacts
from eldenet.simulation.robot import ROBOT
from eldenet.uncertainty import as_estimate
from eldenet.weights import find_checkpoint

FACES_VERSION = 2  # raise it whenever the near faces of boxes change: stored rows of `objects` name it
SIZE = (96, 128)  # of frames, (height, width) [px]
MAX_LIGHT = 10.0  # relative to a normal day; frames of 3 are glaring
IN_FRONT = 0.15  # share of a near face's range: what is nearer by more belongs to something else
_VEHICLE = ClassPrior((1.2, 0.7, 0.9), (0.05, 0.05, 0.1), "box")
#: Sizes of the objects in arenas (:func:`eldenet.simulation.arenas.draw_obstacles`); cars are small there.
ARENA_PRIORS = {
    **PRIORS,
    "cylinder": ClassPrior((0.65, 0.65, 1.1), (0.22, 0.22, 0.27), "upright"),
    "person": ClassPrior((0.5, 0.5, 1.7), (0.05, 0.05, 0.07), "upright"),
    "box": ClassPrior((0.7, 0.7, 1.1), (0.25, 0.25, 0.27), "box"),
    **dict.fromkeys(("vehicle", "car", "van", "truck", "bus"), _VEHICLE),
}


class Camera(SimulatedSensor):
    """A rendered RGB frame and a depth network; with a lifter, the near faces of objects too.

    Ranges are those that :func:`~eldenet.navigation.ranges.depth_to_ranges` finds. With a lifter, the near
    face of the box around a detected object replaces a column's range, unless that is well in front of it.

    A network that predicts sigma also says how near things may be: the low end of each pixel's interval of
    ``CAUTION``. The robot drives as slowly as that asks for, and forgets remembered obstacles only up to
    there.

    Args:
        predictor: frame ``(H, W, 3)`` uint8 RGB -> depth ``(H, W)`` [m], such as
            :class:`eldenet.deploy.predictor.DepthPredictor`, or an estimate with sigma; None: the renderer's
            own depth, as from a perfect network.
        lifter: from detections and depth to boxes; None: ranges from depth only.
        detector: finds objects in a frame, for the lifter; None: the simulator gives the box of each object
            with enough pixels, like an ideal detector.
        size: of the frame, ``(height, width)`` [px].
        light: brightness of the lamps, relative to a normal day.
        pitch: of the optical axis below the horizon [degrees]; a camera that looks down sees the foot of what
            is near.
        artifacts: of a depth camera, on the renderer's own depth (no predictor); None: that depth is exact.

    ``drift`` and ``latency`` are those of :class:`~eldenet.navigation.sensors.SimulatedSensor`.

    Attributes:
        sources: name -> name and file of each network, for ``run.json``.

    Raises:
        ValueError: frames too narrow for the driver's columns, or light or pitch out of range.
    """

    def __init__(
        self,
        predictor: Callable[[np.ndarray], Any] | None = None,
        lifter: BoxLifter | None = None,
        detector: Detector | None = None,
        *,
        size: tuple[int, int] = SIZE,
        light: float = 1.0,
        drift: Drift | dict[str, float] = USUAL,
        latency: float = 0.0,
        pitch: float = 0.0,
        artifacts: StereoArtifacts | None = None,
    ) -> None:
        super().__init__(drift=drift, latency=latency)
        if not 0 < light <= MAX_LIGHT:
            raise ValueError(
                f"sensor.light={light}: give a factor above 0, up to {MAX_LIGHT:g}; 1 is a normal day"
            )
        if not abs(math.radians(pitch)) <= MOST_TILTED:
            most = math.degrees(MOST_TILTED)
            raise ValueError(f"sensor.pitch={pitch}: give degrees from -{most:.1f} to {most:.1f}")
        height, width = (int(side) for side in size)
        intrinsics = robot_intrinsics((height, width))
        columns_of(width, intrinsics)  # raises if the frames are too narrow
        self.predictor = None if predictor is None else for_camera(predictor, intrinsics)
        self.lifter, self.detector, self.artifacts = lifter, detector, artifacts
        self.wrong_columns = artifacts is not None
        self.size, self.light, self.pitch = (height, width), light, math.radians(pitch)
        self.sources: dict[str, tuple[str, Any]] = {}

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> SensorInstance:
        """Return an instance with a view of the arena."""
        return CameraInstance(self, world, ArenaView(world.arena, self.size, light=self.light), rng)


class CameraInstance:
    """A camera in one arena; :attr:`photo` is its last frame with the renderer's depth."""

    def __init__(self, sensor: Camera, world: ArenaWorld, view: ArenaView, rng: np.random.Generator) -> None:
        self.sensor, self.world, self.view, self.rng = sensor, world, view, rng
        self.camera = PinholeCamera(view.intrinsics, level_rotation(sensor.pitch))
        self.photo: Photo
        if sensor.artifacts is not None:
            self.dead = sensor.artifacts.draw_dead(sensor.size[1], rng)

    def scan(self) -> SensorScan:
        """Render a frame, estimate its depth, and lift objects if there is a lifter."""
        sensor = self.sensor
        pose = self.world.pose
        mounted = camera_pose(pose, sensor.pitch)
        self.photo = self.view.photo(pose, self.world.time, int(self.rng.integers(2**31)), camera=mounted)
        frame = self.photo.image
        estimate = as_estimate(self._depth() if sensor.predictor is None else sensor.predictor(frame))
        depth, cautious = estimate.depth, None
        tilt = (sensor.pitch, 0.0)
        ranges = depth_to_ranges(depth, self.view.intrinsics, tilt=tilt)
        if estimate.sigma is not None:
            low = estimate.interval(CAUTION)[0]
            cautious = depth_to_ranges(depth, self.view.intrinsics, tilt=tilt, low=low)
        if np.isnan(ranges).any():
            ranges, cautious = fill_unseen(ranges, ranges if cautious is None else cautious)
        fed_by = np.full(ROBOT.columns, FED_BY.index("depth"), np.intp)
        if sensor.lifter is None:
            return SensorScan(ranges, fed_by, frame, depth, cautious=cautious)
        if sensor.detector is None:
            detections = simulated_detections(self.photo, self.world.arena)
        else:
            detections = sensor.detector(frame)
        boxes = sensor.lifter(estimate, detections, self.camera)
        faces = near_faces(boxes, detections, self.camera)
        by_box = (faces < ROBOT.far) & (ranges > faces * (1 - IN_FRONT))
        fed_by[by_box] = FED_BY.index("box")
        return SensorScan(np.where(by_box, faces, ranges), fed_by, frame, depth, boxes, cautious)

    def _depth(self) -> np.ndarray:
        """The renderer's own depth ``(H, W)`` [m], exact or as a depth camera measures it."""
        if self.sensor.artifacts is None:
            return self.photo.depth
        focal = float(self.view.intrinsics[0, 0])
        return self.sensor.artifacts.apply(self.photo.depth, focal, self.dead, self.rng)


def near_faces(boxes: Boxes3D, detections: Detections2D, camera: PinholeCamera) -> np.ndarray:
    """Range to the nearest box's near face in each column ``(columns,)`` [m]; ``far`` without one.

    A box only counts in the columns that its detection covers: the corners of a box around a round object
    stick out of its outline.
    """
    to_right = -np.array(ROBOT.column_angles)
    out = np.full(ROBOT.columns, ROBOT.far)
    for footprint, (left, top, right, bottom) in zip(footprints(boxes), detections.xyxy, strict=True):
        middle = (top + bottom) / 2
        x, _, z = camera.homography @ [[left, right], [middle, middle], [1, 1]]
        first, last = np.arctan2(x, z)
        seen = (to_right >= first) & (to_right <= last)
        out = np.minimum(out, np.where(seen, footprints_to_ranges(footprint[None]), ROBOT.far))
    return out


def footprints(boxes: Boxes3D) -> np.ndarray:
    """``(K, 5)`` center ahead of and left of the camera [m], yaw [rad], half length, half width [m]."""
    x, z, length, width, yaw = boxes.bev.T
    # the length axis (cos, -sin) in x, z is (-sin, -cos) ahead and to the left; the angle below points the
    # other way along it, which is the same rectangle
    return np.stack([z, -x, np.pi / 2 - yaw, length / 2, width / 2], axis=1)


def depth_network(source: str | None) -> Callable[[np.ndarray], Any] | None:
    """Network ``(H, W, 3)`` uint8 -> ``(H, W)`` [m] from a run folder, model, file or Hub id; None for None.

    One that predicts its sigma gives it too.

    Raises:
        ValueError: ``source`` is the name of a network, which would have random weights.
    """
    if source is None:
        return None
    import torch

    from eldenet.deploy import runtimes
    from eldenet.deploy.predictor import DepthPredictor

    find_checkpoint(source, "sensor.checkpoint", trained=True)
    network = runtimes.load(source, threads=torch.get_num_threads())
    return DepthPredictor(network, steady=False, uncertainty=network.distribution is not None)


def camera(
    checkpoint: str | None = None,
    *,
    size: tuple[int, int] = SIZE,
    light: float = 1.0,
    drift: Drift | dict[str, float] = USUAL,
    latency: float = 0.0,
    pitch: float = 0.0,
) -> Camera:
    """A camera with a network as :func:`depth_network` takes it; None: true depth."""
    sensor = Camera(
        depth_network(checkpoint), size=size, light=light, drift=drift, latency=latency, pitch=pitch
    )
    if checkpoint is not None:
        sensor.sources["depth"] = (checkpoint, checkpoint)
    return sensor


def depth_camera(
    *,
    size: tuple[int, int] = SIZE,
    light: float = 1.0,
    dead_columns: int = 1,
    drift: Drift | dict[str, float] = USUAL,
    latency: float = 0.0,
) -> Camera:
    """An RGB-D camera: no network, but depth with :class:`StereoArtifacts`."""
    artifacts = StereoArtifacts(dead_columns=dead_columns)
    return Camera(size=size, light=light, drift=drift, latency=latency, artifacts=artifacts)


def objects(
    checkpoint: str | None = None,
    *,
    detector: Detector | str | Path | None = None,
    method: Method = "refine",
    depth_sigma: float = 0.08,
    size: tuple[int, int] = SIZE,
    light: float = 1.0,
    drift: Drift | dict[str, float] = USUAL,
    latency: float = 0.0,
) -> Camera:
    """A camera with depth and the near faces of 3D boxes; see :class:`Camera` and :class:`BoxLifter`.

    ``detector`` may also be the path of an ONNX file for
    :class:`~eldenet.perception.onnx_detector.OnnxDetector`.
    """
    if isinstance(detector, str | Path):
        from eldenet.perception.onnx_detector import OnnxDetector

        detector = OnnxDetector(detector)
    sensor = camera(checkpoint, size=size, light=light, drift=drift, latency=latency)
    ground = flat_ground(ROBOT.camera_height)
    sensor.lifter = BoxLifter(method, priors=ARENA_PRIORS, ground=ground, depth_sigma=depth_sigma)
    sensor.detector = detector
    if (path := getattr(detector, "path", None)) is not None:
        sensor.sources["detector"] = (str(path), path)
    return sensor

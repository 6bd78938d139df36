"""What a camera feeds the sectors with: rendered RGB, a depth network, and 3D boxes of detected objects."""

from collections.abc import Callable, Iterator

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D
from eldenet.geometry import PinholeCamera, extent_of
from eldenet.navigation.ranges import check_view, depth_to_ranges, footprints_to_ranges
from eldenet.navigation.sensors import FED_BY, Drift, Eye, Sight
from eldenet.perception.detectors import Detector, FixedDetections
from eldenet.perception.ground import flat_ground
from eldenet.perception.lifter import BoxLifter, Method
from eldenet.perception.priors import PRIORS, ClassPrior
from eldenet.simulation.arena_view import ArenaView, Photo, robot_intrinsics
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import Arena
from eldenet.simulation.robot import ROBOT

FEWEST_PIXELS = 20  # of an object that the simulator's detections name
IN_FRONT = 0.15  # of a box's range: what depth shows nearer than that is something else
_VEHICLE = ClassPrior((1.2, 0.7, 0.9), (0.05, 0.05, 0.1), "box")
#: Sizes of what stands in arenas (:func:`eldenet.simulation.arenas.draw_obstacles`); cars are small there.
ARENA_PRIORS = {
    **PRIORS,
    "cylinder": ClassPrior((0.65, 0.65, 1.1), (0.22, 0.22, 0.27), "upright"),
    "person": ClassPrior((0.5, 0.5, 1.7), (0.05, 0.05, 0.07), "upright"),
    "box": ClassPrior((0.7, 0.7, 1.1), (0.25, 0.25, 0.27), "box"),
    **dict.fromkeys(("vehicle", "car", "van", "truck", "bus"), _VEHICLE),
}


class Camera:
    """A rendered RGB frame and a depth network; with a lifter, objects' near faces too.

    Each column's range is the nearest that depth shows there. With a lifter, the near face of the box around
    a detected object replaces it, unless depth shows something well in front of the face.

    Args:
        predictor: frame ``(H, W, 3)`` uint8 RGB -> depth ``(H, W)`` [m], such as
            :class:`eldenet.deploy.predictor.DepthPredictor`; None: the renderer's own depth (what a perfect
            network would give).
        lifter: from detections and depth to boxes; None: depth alone feeds the sectors.
        detector: what finds objects in a frame; None: the simulator says where each object that shows enough
            pixels is in the frame, as an ideal detector would.
        size: of the frame, ``(height, width)`` [px].
        light: brightness of the lamps, as a share of a normal day's.
        drift: of the odometry.

    Raises:
        ValueError: a detector without a lifter, or frames too narrow for the driver's columns.
    """

    def __init__(
        self,
        predictor: Callable[[np.ndarray], np.ndarray] | None = None,
        lifter: BoxLifter | None = None,
        detector: Detector | None = None,
        *,
        size: tuple[int, int] = (96, 128),
        light: float = 1.0,
        drift: Drift = Drift(),  # noqa: B008 - immutable
    ) -> None:
        if detector is not None and lifter is None:
            raise ValueError("a detector needs a lifter, which makes boxes of what it finds")
        check_view(size[1], robot_intrinsics(size))
        self.predictor, self.lifter, self.detector = predictor, lifter, detector
        self.size, self.light, self.drift = size, light, drift

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> Eye:
        """An eye with a view of the arena."""
        return CameraEye(self, world, ArenaView(world.arena, self.size, light=self.light), rng)


class CameraEye:
    """Looks into one arena; :attr:`photo` is what it saw last."""

    def __init__(self, sensor: Camera, world: ArenaWorld, view: ArenaView, rng: np.random.Generator) -> None:
        self.sensor, self.world, self.view, self.rng = sensor, world, view, rng
        self.camera = PinholeCamera(view.intrinsics)
        self.photo: Photo
        self.detector = sensor.detector or FixedDetections(self._simulated())

    def _simulated(self) -> Iterator[Detections2D]:
        while True:
            yield simulated_detections(self.photo, self.world.arena)

    def look(self) -> Sight:
        """Render, estimate depth, and find objects where there is a lifter."""
        sensor = self.sensor
        self.photo = self.view.photo(self.world.pose, self.world.time, int(self.rng.integers(2**31)))
        frame = self.photo.image
        depth = self.photo.depth if sensor.predictor is None else sensor.predictor(frame)
        ranges = depth_to_ranges(depth, self.view.intrinsics)
        fed_by = np.full(ROBOT.columns, FED_BY.index("depth"), np.intp)
        if sensor.lifter is None:
            return Sight(ranges, fed_by, frame, depth)
        detections = self.detector(frame)
        boxes = sensor.lifter(depth, detections, self.camera)
        faces = near_faces(boxes, detections, self.camera)
        by_box = (faces < ROBOT.far) & (ranges > faces * (1 - IN_FRONT))
        fed_by[by_box] = FED_BY.index("box")
        return Sight(np.where(by_box, faces, ranges), fed_by, frame, depth, boxes)


def simulated_detections(photo: Photo, arena: Arena) -> Detections2D:
    """Tight 2D boxes around what shows of each obstacle, from the renderer itself."""
    kinds = tuple(sorted({obstacle.kind for obstacle in arena.obstacles}))
    boxes, labels = [], []
    for number in np.unique(photo.obstacle[photo.obstacle >= 0]):
        rows, columns = np.nonzero(photo.obstacle == number)
        if len(rows) >= FEWEST_PIXELS:
            boxes.append(extent_of(rows, columns))
            labels.append(kinds.index(arena.obstacles[number].kind))
    if not boxes:
        return Detections2D.empty(kinds)
    return Detections2D(np.array(boxes, float), np.ones(len(boxes)), np.array(labels, np.int64), kinds)


def near_faces(boxes: Boxes3D, detections: Detections2D, camera: PinholeCamera) -> np.ndarray:
    """Range to the nearest box's near face in each column ``(columns,)`` [m]; ``far`` without one.

    A box counts in those columns alone that its detection covers: the corners of a box around something round
    stick out of what is seen.
    """
    k = camera.intrinsics
    at = k[0, 2] - k[0, 0] * np.tan(ROBOT.column_angles)  # pixel of each column's middle
    out = np.full(ROBOT.columns, ROBOT.far)
    for footprint, (left, _, right, _) in zip(footprints(boxes), detections.xyxy, strict=True):
        seen = (at >= left) & (at <= right)
        out = np.minimum(out, np.where(seen, footprints_to_ranges(footprint[None]), ROBOT.far))
    return out


def footprints(boxes: Boxes3D) -> np.ndarray:
    """``(K, 5)`` middle ahead of and left of the camera [m], yaw [rad], half length, half width [m]."""
    x, z, length, width, yaw = boxes.bev.T
    return np.stack([z, -x, np.pi / 2 + yaw, length / 2, width / 2], axis=1)


def depth_network(source: str | None) -> Callable[[np.ndarray], np.ndarray] | None:
    """The network of a run folder, model folder, exported file (.onnx, .xml) or Hub id; None of None."""
    if source is None:
        return None
    import torch

    from eldenet.deploy import runtimes
    from eldenet.deploy.predictor import DepthPredictor

    return DepthPredictor(runtimes.load(source, threads=torch.get_num_threads()))


def camera(
    checkpoint: str | None = None,
    *,
    size: tuple[int, int] = (96, 128),
    light: float = 1.0,
    drift: Drift | dict[str, float] = Drift(),  # noqa: B008 - immutable
) -> Camera:
    """Depth alone, of a network as :func:`depth_network` takes it; None: true depth."""
    drift = Drift(**drift) if isinstance(drift, dict) else drift
    height, width = (int(side) for side in size)
    return Camera(depth_network(checkpoint), size=(height, width), light=light, drift=drift)


def objects(
    checkpoint: str | None = None,
    *,
    detector: Detector | None = None,
    method: Method = "refine",
    depth_sigma: float = 0.08,
    size: tuple[int, int] = (96, 128),
    light: float = 1.0,
    drift: Drift | dict[str, float] = Drift(),  # noqa: B008 - immutable
) -> Camera:
    """Depth and the near faces of 3D boxes; see :class:`Camera` and :class:`BoxLifter`."""
    sensor = camera(checkpoint, size=size, light=light, drift=drift)
    ground = flat_ground(ROBOT.camera_height)
    sensor.lifter = BoxLifter(method, priors=ARENA_PRIORS, ground=ground, depth_sigma=depth_sigma)
    sensor.detector = detector
    return sensor

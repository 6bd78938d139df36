"""The frames of table 4: simulated streets and halls, and KITTI's object frames."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D
from eldenet.deploy.predictor import DepthPredictor
from eldenet.geometry import PinholeCamera
from eldenet.perception.detectors import Detector, merge_cyclists
from eldenet.perception.kitti_object import KittiObjects
from eldenet.perception.lifter import LARGE_SIDE, SMALL_SIDE
from eldenet.perception.matching_metrics import pair_up
from eldenet.simulation.street_views import StreetView, render_street

SIZES = {"street": (256, 832), "crossing": (256, 832), "hall": (240, 320)}
HEIGHTS = {"street": 1.65, "crossing": 1.65, "hall": 1.0}  # nominal height of the camera above the ground [m]
LEAST_HEIGHT = 18  # least height of simulated objects [px]: KITTI's 25 at the simulated size
EXACT_SIGMA = 0.01  # relative error of exact and LiDAR depth, from pixels of other objects

Sigma = tuple[float, float]  # depth_sigma, small_sigma


@dataclass
class Case:
    """One frame with all inputs of a method, and the truth."""

    name: str
    image: np.ndarray
    depth: np.ndarray
    detections: Detections2D
    camera: PinholeCamera
    truth: Boxes3D
    rows: np.ndarray  # pairs: truth[rows] matches detections[columns]
    columns: np.ndarray


@dataclass
class Setting:
    """Frames with one kind of depth and of 2D boxes, and the lifter's options for them."""

    depth: str
    boxes: str
    cases: list[Case]
    height: float
    sigma: Sigma
    resolution: str
    protocol: str


def render(split: str, first: int, count: int, kind: str) -> list[StreetView]:
    return [render_street(split, first + index, SIZES[kind], kind) for index in range(count)]


def simulated(views: list[StreetView], depth_of: Callable[[StreetView], np.ndarray]) -> list[Case]:
    """Return cases of objects that are visible to 30 % or more, not cut by the border, and not tiny."""
    cases = []
    for number, view in enumerate(views):
        tall = view.detections.xyxy[:, 3] - view.detections.xyxy[:, 1]
        kept = np.nonzero((view.visible >= 0.3) & ~view.truncated & (tall >= LEAST_HEIGHT))[0]
        depth = depth_of(view)
        cases.append(
            Case(f"{number}", view.image, depth, view.detections, view.camera, view.boxes, kept, kept)
        )
    return cases


def real(kitti: KittiObjects, detector: Detector | None, depth_of: Callable) -> Iterator[Case]:
    """Yield cases of cars and vans up to KITTI's "hard", with boxes of the detector or of the labels."""
    for name in kitti.names:
        image = kitti.image(name)
        depth = depth_of(name, image)
        if depth is None:
            continue
        labels = kitti.labels(name)
        labels = labels.select(np.array([kind != "DontCare" for kind in labels.types]))
        found = labels.detections if detector is None else merge_cyclists(detector(image))
        rows, columns = pair_up(labels.xyxy, found.xyxy)
        tall = labels.xyxy[:, 3] - labels.xyxy[:, 1]
        counts = (tall > 25) & (labels.occluded <= 2) & (labels.truncated <= 0.5)
        counts &= np.isin(np.array(labels.types), ("Car", "Van"))
        kept = counts[rows] if len(rows) else np.zeros(0, bool)
        yield Case(name, image, depth, found, kitti.camera(name), labels.boxes, rows[kept], columns[kept])


def relative_error(views: list[StreetView], predictor: DepthPredictor) -> Sigma:
    """Return the relative depth errors of large and small objects: ``depth_sigma`` and ``small_sigma``.

    They lie on a power law through the medians of the smaller and the larger half of the objects.
    """
    errors, sides = [], []
    for view in views:
        predicted = predictor(view.image)
        for number in range(len(view.boxes)):
            mine = (view.instance == number) & (view.depth > 0)
            if mine.sum() >= 100:
                errors.append(abs(np.log(np.median(predicted[mine]) / np.median(view.depth[mine]))))
                box = view.detections.xyxy[number]
                sides.append(np.log(min(box[2] - box[0], box[3] - box[1])))
    larger = np.array(sides) > np.median(sides)
    halves = [
        (np.median(np.array(sides)[half]), np.median(np.array(errors)[half])) for half in (~larger, larger)
    ]
    (small, wrong), (large, right) = halves
    slope = min(0.0, np.log(right / wrong) / (large - small))
    sigma = [1.4826 * wrong * np.exp(slope * (np.log(side) - small)) for side in (LARGE_SIDE, SMALL_SIDE)]
    return float(np.clip(sigma[0], EXACT_SIGMA, 0.5)), float(np.clip(sigma[1], EXACT_SIGMA, 0.5))

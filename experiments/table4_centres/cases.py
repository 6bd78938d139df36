"""The frames of table 4: simulated streets and halls, and KITTI's object frames."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D
from eldenet.geometry import PinholeCamera
from eldenet.perception.detectors import Detector, merge_cyclists
from eldenet.perception.kitti_object import KittiLabels, KittiObjects, to_labels
from eldenet.perception.matching_metrics import pair_up
from eldenet.simulation.street_views import StreetView, render_street
from eldenet.uncertainty import DepthEstimate

SIZES = {"street": (256, 832), "crossing": (256, 832), "hall": (240, 320)}
HEIGHTS = {"street": 1.65, "crossing": 1.65, "hall": 1.0}  # nominal height of the camera above the ground [m]
LEAST_HEIGHT = 18  # least height of simulated objects [px]: KITTI's 25 at the simulated size
SMALL = ("person", "pedestrian", "cyclist")
#: The objects of a row: name -> of small things alone, of the others alone, or None for all.
GROUPS = {"all": None, "people, cyclists": True, "vehicles": False}

Sigma = tuple[float | None, float | None]  # depth_sigma, small_sigma; None: the lifter's own


@dataclass
class Case:
    """One frame with all inputs of a method, and the truth."""

    name: str
    image: np.ndarray
    depth: np.ndarray | DepthEstimate
    detections: Detections2D
    camera: PinholeCamera
    truth: Boxes3D
    rows: np.ndarray  # pairs: truth[rows] matches detections[columns]
    columns: np.ndarray
    labels: KittiLabels  # the truth in KITTI's format, for its average precision

    def pairs_of(self, group: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows and columns of the pairs of one of ``GROUPS``."""
        names = np.array([name.lower() for name in self.truth.classes], object)[self.rows]
        small = GROUPS[group]
        chosen = np.ones(len(names), bool) if small is None else np.isin(names, SMALL) == small
        return self.rows[chosen], self.columns[chosen]


@dataclass
class Setting:
    """Frames with one kind of depth and of 2D boxes, and the lifter's options for them."""

    depth: str
    boxes: str
    cases: list[Case]
    height: float
    sigma: Sigma
    groups: tuple[str, ...]
    resolution: str
    protocol: str


def render(split: str, first: int, count: int, kind: str) -> list[StreetView]:
    return [render_street(split, first + index, SIZES[kind], kind) for index in range(count)]


def simulated(views: list[StreetView], depth_of: Callable) -> list[Case]:
    """Return cases of objects that are visible to 30 % or more, not cut by the border, and not tiny."""
    cases = []
    for number, view in enumerate(views):
        tall = view.detections.xyxy[:, 3] - view.detections.xyxy[:, 1]
        kept = np.nonzero((view.visible >= 0.3) & ~view.truncated & (tall >= LEAST_HEIGHT))[0]
        depth, labels = depth_of(view), as_labels(view)
        cases.append(
            Case(f"{number}", view.image, depth, view.detections, view.camera, view.boxes, kept, kept, labels)
        )
    return cases


def as_labels(view: StreetView) -> KittiLabels:
    """Return the objects as KITTI labels them: partly hidden below 80 % visible, largely below 40 %."""
    labels = to_labels(view.boxes, view.detections.xyxy)
    hidden = (view.visible < 0.8).astype(int) + (view.visible < 0.4)
    return replace(labels, occluded=hidden, truncated=view.truncated.astype(float))


def real(kitti: KittiObjects, detector: Detector | None, depth_of: Callable) -> Iterator[Case]:
    """Yield cases of objects up to KITTI's "hard", with boxes of the detector or of the labels."""
    for name in kitti.names:
        image = kitti.image(name)
        depth = depth_of(name, image)
        if depth is None:
            continue
        everything = labels = kitti.labels(name)
        labels = labels.select(np.array([kind != "DontCare" for kind in labels.types]))
        found = labels.detections if detector is None else merge_cyclists(detector(image))
        rows, columns = pair_up(labels.xyxy, found.xyxy)
        tall = labels.xyxy[:, 3] - labels.xyxy[:, 1]
        counts = (tall > 25) & (labels.occluded <= 2) & (labels.truncated <= 0.5)
        counts &= np.isin(np.array(labels.types), ("Car", "Van", "Pedestrian", "Cyclist"))
        kept = counts[rows] if len(rows) else np.zeros(0, bool)
        truth, camera = labels.boxes, kitti.camera(name)
        yield Case(name, image, depth, found, camera, truth, rows[kept], columns[kept], everything)

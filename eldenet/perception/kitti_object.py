"""KITTI's object benchmark on disk: images, calibration, labels, LiDAR; and its label format as output.

Geiger et al., "Are we ready for autonomous driving?", CVPR 2012. Label lines: type, truncated, occluded,
alpha, 2D box, height width length [m], location (middle of the lower face in rectified camera 0) [m],
rotation_y, score.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from eldenet.boxes import ArrayRows, Boxes3D, Detections2D
from eldenet.data.io import read_image
from eldenet.data.kitti_calibration import entry, projection_camera, read_scan
from eldenet.data.paths import find_root
from eldenet.geometry import PinholeCamera, nearest_points
from eldenet.system.files import read_text, write_text

TREE = """
training/
  image_2/000000.png  calib/000000.txt  label_2/000000.txt  velodyne/000000.bin (or velodyne_reduced/)
"""
_KITTI_OF = {
    "car": "Car", "van": "Van", "truck": "Truck", "bus": "Truck", "person": "Pedestrian",
    "pedestrian": "Pedestrian", "cyclist": "Cyclist", "train": "Tram", "tram": "Tram",
}  # fmt: skip
UNKNOWN = 3  # of ``occluded``
KITTI_NAMES = (
    "Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Cyclist", "Tram", "Misc", "DontCare",
)  # fmt: skip


@dataclass(frozen=True)
class KittiLabels(ArrayRows):
    """The lines of a label file, as arrays.

    Attributes:
        types: of the N objects ("Car", ..., "DontCare").
        truncated: ``(N,)`` share outside the image.
        occluded: ``(N,)`` 0 visible, 1 partly, 2 largely hidden, 3 unknown.
        alpha: ``(N,)`` observation angle [rad].
        xyxy: ``(N, 4)`` [px].
        size: ``(N, 3)`` length, width, height [m].
        location: ``(N, 3)`` middle of the lower face [m].
        yaw: ``(N,)`` rotation_y [rad].
        score: ``(N,)``; 1 for ground truth.
    """

    types: tuple[str, ...]
    truncated: np.ndarray
    occluded: np.ndarray
    alpha: np.ndarray
    xyxy: np.ndarray
    size: np.ndarray
    location: np.ndarray
    yaw: np.ndarray
    score: np.ndarray

    def __len__(self) -> int:
        return len(self.types)

    def select(self, chosen: np.ndarray | slice) -> Self:
        """The objects that ``chosen (N,)`` bool, or indices, pick."""
        types = tuple(self.types[index] for index in np.arange(len(self))[chosen])
        return replace(super().select(chosen), types=types)

    @property
    def _numbered(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """Number ``(N,)`` of each object's class, and the names: KITTI's, then others as they come."""
        names = tuple(dict.fromkeys((*KITTI_NAMES, *self.types)))
        return np.array([names.index(name) for name in self.types], np.int64), names

    @property
    def boxes(self) -> Boxes3D:
        """The 3D boxes in the frame of rectified camera 0."""
        label, names = self._numbered
        center = self.location - self.size[:, [2]] * np.array([0.0, 0.5, 0.0])
        return Boxes3D(center, self.size, self.yaw, self.score, label, names)

    @property
    def detections(self) -> Detections2D:
        """The labeled 2D boxes. They are projections of the 3D boxes: lifting them leaks the answer."""
        label, names = self._numbered
        return Detections2D(self.xyxy, self.score, label, names, "projected")


def read_labels(path: Path) -> KittiLabels:
    """Read a label file (15 columns) or a result file (16); an empty file has no objects.

    Raises:
        FileNotFoundError: the file does not exist.
        ValueError: a line is not a label; the message names it.
    """
    types, rows = [], []
    text = read_text(path, "fetch it again, it comes with KITTI's object labels")
    for number, line in enumerate(text.splitlines(), 1):
        columns = line.split()
        if not columns:
            continue
        try:
            values = [float(column) for column in columns[1:]]
        except ValueError:
            values = []
        if len(values) not in (14, 15) or not np.isfinite(values).all():
            raise ValueError(
                f"{path}, line {number}: {line[:60]!r} is not a type and 14 or 15 numbers, all finite"
            )
        types.append(columns[0])
        rows.append(values if len(values) == 15 else [*values, 1.0])
    table = np.array(rows, np.float64).reshape(-1, 15)
    return KittiLabels(
        tuple(types), table[:, 0], table[:, 1].astype(int), table[:, 2], table[:, 3:7],
        table[:, [9, 8, 7]], table[:, 10:13], table[:, 13], table[:, 14],
    )  # fmt: skip


def to_labels(boxes: Boxes3D, xyxy: np.ndarray, rotation: np.ndarray | None = None) -> KittiLabels:
    """Convert boxes to KITTI's results, with KITTI's class names.

    A doubtful box has ``occluded`` 3, KITTI's "unknown", the others -1.

    KITTI's frame has the camera's axes, but its origin is camera 0, not the color camera (P2's fourth column
    is the offset). So boxes are rotated and keep the origin of the level frame.

    Args:
        boxes: in a level frame.
        xyxy: ``(N, 4)`` 2D box of each [px].
        rotation: ``(3, 3)`` level from camera; None: the level frame has the camera's axes.
    """
    count = len(boxes)
    turn = np.eye(3) if rotation is None else rotation
    location = boxes.bottom_center @ turn
    along = np.stack([np.cos(boxes.yaw), np.zeros(count), -np.sin(boxes.yaw)], axis=1) @ turn
    yaw = np.arctan2(-along[:, 2], along[:, 0])
    alpha = yaw - np.arctan2(location[:, 0], location[:, 2])
    alpha = (alpha + np.pi) % (2 * np.pi) - np.pi
    types = tuple(_KITTI_OF.get(name.lower(), name.replace(" ", "_")) for name in boxes.classes)
    return KittiLabels(
        types, np.full(count, -1.0), np.where(boxes.doubtful, UNKNOWN, -1), alpha,
        np.asarray(xyxy, np.float64).reshape(-1, 4), boxes.size, location, yaw, boxes.score,
    )  # fmt: skip


def write_labels(path: Path, labels: KittiLabels) -> None:
    """Write a result file (16 columns)."""
    lines = []
    for i, kind in enumerate(labels.types):
        length, width, height = labels.size[i]
        numbers = [*labels.xyxy[i], height, width, length, *labels.location[i], labels.yaw[i]]
        numbers.append(labels.score[i])
        text = " ".join(f"{value:.4f}" for value in numbers)
        lines.append(f"{kind} {labels.truncated[i]:.2f} {labels.occluded[i]} {labels.alpha[i]:.4f} {text}\n")
    write_text(path, "".join(lines))


class KittiObjects:
    """Frames of the object benchmark that have an image, a calibration and labels.

    Args:
        root: folder with ``image_2`` ...; None: ``$ELDENET_DATA/kitti/object/training``.
        names: frames to use; None: all that are complete.

    Raises:
        FileNotFoundError: the folder does not exist.
    """

    def __init__(self, root: str | Path | None = None, names: Sequence[str] | None = None) -> None:
        self.root = find_root(root, "kitti/object/training", ("image_2", "calib", "label_2"), TREE)
        if names is None:
            names = sorted(path.stem for path in (self.root / "label_2").glob("*.txt"))
            names = [name for name in names if all(path.is_file() for path in self._files(name))]
        self.names = list(names)

    def _files(self, name: str) -> tuple[Path, Path]:
        return self.root / "image_2" / f"{name}.png", self.root / "calib" / f"{name}.txt"

    def image(self, name: str) -> np.ndarray:
        """The left color image ``(H, W, 3)`` uint8 RGB."""
        return read_image(self._files(name)[0])

    def camera(self, name: str) -> PinholeCamera:
        """The left color camera in the frame of rectified camera 0, which is the labels' frame.

        Raises:
            ValueError: the calibration lacks P2, or it is the projection of no camera.
        """
        return projection_camera(self._files(name)[1], "P2")

    def labels(self, name: str) -> KittiLabels:
        """Labels of a frame, including DontCare areas."""
        return read_labels(self.root / "label_2" / f"{name}.txt")

    def lidar_depth(self, name: str, size: tuple[int, int]) -> np.ndarray | None:
        """Sparse depth ``(height, width)`` float32 [m] of the LiDAR scan, 0 = unknown; None without one."""
        scans = [self.root / folder / f"{name}.bin" for folder in ("velodyne", "velodyne_reduced")]
        scan = next((path for path in scans if path.is_file()), None)
        if scan is None:
            return None
        calibration = self._files(name)[1]
        self.camera(name)  # refuses a P2 that is no camera's
        rigid, rectify = np.eye(4), np.eye(4)
        rigid[:3] = entry(calibration, "Tr_velo_to_cam", (3, 4))
        rectify[:3, :3] = entry(calibration, "R0_rect", (3, 3))
        points = read_scan(scan)[:, :3].astype(np.float64)
        points = points[points[:, 0] > 0.5]
        seen = np.column_stack([points, np.ones(len(points))]) @ (rectify @ rigid).T
        seen = seen @ entry(calibration, "P2", (3, 4)).T
        depth = seen[:, 2]
        columns, rows = (np.rint(seen[:, k] / depth).astype(int) for k in (0, 1))
        inside = (depth > 0) & (columns >= 0) & (columns < size[1]) & (rows >= 0) & (rows < size[0])
        return nearest_points(rows[inside], columns[inside], depth[inside].astype(np.float32), size)

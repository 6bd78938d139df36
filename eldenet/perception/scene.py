"""The whole chain: a picture in; depth, detections, boxes and how long each took, out."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D
from eldenet.geometry import PinholeCamera, check_intrinsics
from eldenet.perception.detectors import Detector, check_frame
from eldenet.perception.drawing import draw_bev, draw_boxes, picture_beside_bev
from eldenet.perception.kitti_object import to_labels, write_labels
from eldenet.perception.lifter import BoxLifter
from eldenet.perception.tracking import BoxTracker

STAGES = ("depth", "detect", "lift", "track")


@dataclass(frozen=True)
class Scene:
    """What was seen in one picture.

    Attributes:
        image: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` float32 [m].
        detections: of the detector.
        boxes: in the camera's level frame; with a tracker, its own.
        camera: of the picture.
        seconds: that each stage took.
    """

    image: np.ndarray
    depth: np.ndarray
    detections: Detections2D
    boxes: Boxes3D
    camera: PinholeCamera
    seconds: dict[str, float]

    @property
    def xyxy(self) -> np.ndarray:
        """``(N, 4)`` 2D box of every 3D box [px]: its detection, or with a tracker its projection.

        NaN for a track of which nothing is in the picture.
        """
        if self.boxes.velocity is None:  # no tracker's boxes (a detector may number its objects itself)
            return self.detections.xyxy
        return self.boxes.project(self.camera, self.depth.shape)

    @property
    def bev_size(self) -> tuple[int, int]:
        """(height, width) of the view from above that :meth:`picture` draws [px]."""
        tall = max(self.depth.shape[0], 240)
        return tall, max(200, round(tall * 0.9))

    def picture(self, reach: float | None = None) -> np.ndarray:
        """Boxes in the photo, beside the view from above: ``(h, w, 3)`` uint8 RGB.

        ``reach`` is the depth at that view's upper edge [m]; None: so that every box is in it.
        """
        width = self.depth.shape[1]
        heading_known = self.boxes.quality.get("heading", np.zeros(len(self.boxes))) == 1
        drawn = draw_boxes(self.image, self.boxes, self.camera, front=heading_known)
        panel = draw_bev(self.boxes, self.camera, width, size=self.bev_size, reach=reach)
        return picture_beside_bev(drawn, panel)

    def write_kitti(self, path: str | Path) -> None:
        """Boxes as a KITTI result file, along the camera's axes; those out of the picture are left out."""
        xyxy = self.xyxy
        seen = np.isfinite(xyxy).all(1)
        write_labels(Path(path), to_labels(self.boxes.select(seen), xyxy[seen], self.camera.rotation))

    def log_to_rerun(self, path: str = "world") -> None:
        """Send the scene to a rerun viewer (``pip install rerun-sdk``; ``rerun.init`` is the caller's)."""
        import rerun as rr

        height, width = self.depth.shape
        rr.log(path, rr.ViewCoordinates.RDF, static=True)
        pose = {"translation": self.camera.translation, "mat3x3": self.camera.rotation}
        rr.log(f"{path}/camera", rr.Transform3D(**pose))
        pinhole = rr.Pinhole(image_from_camera=self.camera.intrinsics, width=width, height=height)
        rr.log(f"{path}/camera", pinhole)
        rr.log(f"{path}/camera/image", rr.Image(self.image))
        rr.log(f"{path}/camera/depth", rr.DepthImage(self.depth, meter=1.0))
        turns = [rr.RotationAxisAngle(axis=(0, 1, 0), radians=float(yaw)) for yaw in self.boxes.yaw]
        boxes: Any = rr.Boxes3D(
            centers=self.boxes.center,
            sizes=self.boxes.size[:, [0, 2, 1]],
            rotation_axis_angles=turns,
            labels=self.boxes.classes,
        )
        rr.log(f"{path}/boxes", boxes)


class Perception:
    """``perception(image) -> Scene``.

    Args:
        depth_model: frame ``(H, W, 3)`` uint8 -> depth ``(H, W)`` [m], such as
            :class:`eldenet.deploy.predictor.DepthPredictor`.
        detector: frame -> detections.
        lifter: see :class:`~eldenet.perception.lifter.BoxLifter`.
        camera: of the pictures.
        tracker: gives identity and velocity over a video; None: every picture for itself.
    """

    def __init__(
        self,
        depth_model: Callable[[np.ndarray], np.ndarray],
        detector: Detector,
        lifter: BoxLifter,
        camera: PinholeCamera,
        *,
        tracker: BoxTracker | None = None,
    ) -> None:
        self.depth_model, self.detector, self.lifter = depth_model, detector, lifter
        self.camera, self.tracker = camera, tracker

    def __call__(
        self, image: np.ndarray, *, depth: np.ndarray | None = None, seconds: float = 1 / 30
    ) -> Scene:
        """Look at one picture.

        Args:
            image: ``(H, W, 3)`` uint8 RGB.
            depth: where it is known already [m]; the depth model is not asked then.
            seconds: since the picture before, for the tracker.

        Raises:
            ValueError: the picture is none, or its depth has another size.
        """
        check_frame(image)
        check_intrinsics(self.camera.intrinsics, (image.shape[0], image.shape[1]))
        clock = [time.perf_counter()]
        depth = self.depth_model(image) if depth is None else depth
        clock.append(time.perf_counter())
        if depth.shape != image.shape[:2]:
            raise ValueError(
                f"depth is {depth.shape}, the picture {image.shape[:2]}: both must have one size"
            )
        detections = self.detector(image)
        clock.append(time.perf_counter())
        boxes = self.lifter(depth, detections, self.camera)
        clock.append(time.perf_counter())
        if self.tracker is not None:
            boxes = self.tracker(boxes, seconds)
        clock.append(time.perf_counter())
        spans = dict(zip(STAGES, np.diff(clock).tolist(), strict=True))
        return Scene(image, depth, detections, boxes, self.camera, spans)

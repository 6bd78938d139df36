"""The whole pipeline: from an image to depth, detections and 3D boxes, with the time that each stage took."""

import time
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.boxes import Box3D, Boxes3D, Detections2D
from eldenet.deploy.predictor import check_frame, for_camera
from eldenet.deploy.viewer import WORLD, log_boxes, log_camera, log_depth
from eldenet.geometry import CameraLike, PinholeCamera, as_camera
from eldenet.perception.detectors import Detector
from eldenet.perception.drawing import draw_bev, draw_boxes, picture_beside_bev
from eldenet.perception.kitti_object import to_labels, write_labels
from eldenet.perception.lifter import BoxLifter
from eldenet.perception.tracking import BoxTracker
from eldenet.system.extras import require
from eldenet.system.files import write_rows
from eldenet.uncertainty import DepthEstimate, as_estimate

STAGES = ("depth", "detect", "lift", "track")


@dataclass(frozen=True)
class Scene:
    """The results for one image.

    Attributes:
        image: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` float32 [m].
        detections: of the detector.
        boxes: in the camera's level frame; with a tracker, its tracks.
        camera: of the image.
        seconds: time that each stage took.
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

        NaN for a track outside the image.
        """
        if self.boxes.velocity is None:  # not from a tracker
            return self.detections.xyxy
        return self.boxes.project(self.camera, self.depth.shape)

    @property
    def bev_size(self) -> tuple[int, int]:
        """(height, width) of the bird's-eye view that :meth:`picture` draws [px]."""
        tall = max(self.depth.shape[0], 240)
        return tall, max(200, round(tall * 0.9))

    def picture(self, reach: float | None = None) -> np.ndarray:
        """Draw the boxes in the image, beside a bird's-eye view: ``(h, w, 3)`` uint8 RGB.

        ``reach`` is the depth at the upper edge of that view [m]; None: it shows every box.
        """
        width = self.depth.shape[1]
        heading_known = self.boxes.quality.get("heading", np.zeros(len(self.boxes))) == 1
        drawn = draw_boxes(self.image, self.boxes, self.camera, front=heading_known)
        panel = draw_bev(self.boxes, self.camera, width, size=self.bev_size, reach=reach)
        return picture_beside_bev(drawn, panel)

    def write_kitti(self, path: str | Path) -> None:
        """Write the boxes inside the image as a KITTI result file, along the camera's axes."""
        xyxy = self.xyxy
        seen = np.isfinite(xyxy).all(1)
        write_labels(Path(path), to_labels(self.boxes.select(seen), xyxy[seen], self.camera.rotation))

    def write_intervals(self, path: str | Path) -> None:
        """Write each box's distance and its interval [m] as CSV, if the depth had a sigma."""
        rows = [(box.name, box.score, box.distance, *box.interval) for box in self.each if box.interval]
        if "distance_low" in self.boxes.quality:
            write_rows(Path(path), ("class", "score", "distance", "low", "high"), rows)

    @property
    def each(self) -> list[Box3D]:
        """The boxes one by one."""
        return [self.boxes[index] for index in range(len(self.boxes))]

    def log_to_rerun(self, path: str = WORLD) -> None:
        """Send the scene to a rerun viewer (``pip install -e '.[viewer]'``); call ``rerun.init`` before."""
        require("log_to_rerun", "rerun")
        import rerun as rr

        log_camera(rr.log, self.camera, (self.depth.shape[0], self.depth.shape[1]), path)
        rr.log(f"{path}/camera/image", rr.Image(self.image))
        log_depth(rr.log, DepthEstimate(self.depth), path)
        log_boxes(rr.log, self.boxes, path)


@dataclass(eq=False)
class Perception:
    """``perception(image) -> Scene``.

    Args:
        depth_model: image ``(H, W, 3)`` uint8 -> depth ``(H, W)`` [m], such as
            :class:`eldenet.deploy.predictor.DepthPredictor`, with or without sigma; None: every call gives
            the depth.
        camera: of the images, or its intrinsics, ``(3, 3)`` or ``(fx, fy, cx, cy)`` [px]; None: every call
            gives it.
        tracker: gives the boxes of a video identities and velocities; None: each image on its own.
    """

    depth_model: Callable[[np.ndarray], Any] | None
    detector: Detector
    lifter: BoxLifter
    camera: CameraLike | None
    _: KW_ONLY
    tracker: BoxTracker | None = None

    def __call__(
        self,
        image: np.ndarray,
        *,
        depth: np.ndarray | DepthEstimate | None = None,
        seconds: float = 1 / 30,
        camera: CameraLike | None = None,
    ) -> Scene:
        """Perceive one image.

        Args:
            image: ``(H, W, 3)`` uint8 RGB.
            depth: ``(H, W)`` [m] with or without sigma, if already known; else the depth model predicts it.
            seconds: since the previous image, for the tracker.
            camera: of this image, if it has its own.

        Raises:
            ValueError: the image is not uint8 RGB, depth or intrinsics do not fit it, or depth or camera are
                unknown.
        """
        check_frame(image)
        given = self.camera if camera is None else camera
        if given is None:
            raise ValueError("Perception has no camera: give camera=")
        camera = as_camera(given)
        clock = [time.perf_counter()]
        if depth is None:
            if self.depth_model is None:
                raise ValueError("Perception has no depth_model: give depth=")
            depth = for_camera(self.depth_model, camera.intrinsics)(image)
        clock.append(time.perf_counter())
        estimate = as_estimate(depth)
        if estimate.depth.shape != image.shape[:2]:
            raise ValueError(
                f"depth of {estimate.depth.shape}, but an image of {image.shape[:2]}: give both in the "
                "same size"
            )
        detections = self.detector(image)
        clock.append(time.perf_counter())
        boxes = self.lifter(estimate, detections, camera)
        clock.append(time.perf_counter())
        if self.tracker is not None:
            boxes = self.tracker(boxes, seconds, detections.xyxy)
        clock.append(time.perf_counter())
        spans = dict(zip(STAGES, np.diff(clock).tolist(), strict=True))
        return Scene(image, estimate.depth, detections, boxes, camera, spans)

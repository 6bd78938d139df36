"""Recordings for the Rerun viewer: picture, depth, colored points and boxes over time (``rerun-sdk``)."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.geometry import PinholeCamera, back_project
from eldenet.system.errors import writing
from eldenet.system.files import part_path
from eldenet.uncertainty import DepthEstimate, as_estimate

if TYPE_CHECKING:
    from eldenet.boxes import Boxes3D

WORLD = "world"
MOST_POINTS = 40_000  # of a cloud: a film of 500 frames stays below what a viewer holds
JPEG_QUALITY = 90


class RerunViewer:
    """Adds pictures to a Rerun recording; each is a step of the timeline "picture", of a film also of "time".

    Args:
        log: ``rerun.log``, or that of a recording.
        set_time: ``rerun.set_time``, or that of a recording.

    Attributes:
        pictures: added so far.
    """

    def __init__(self, log: Callable[..., Any], set_time: Callable[..., Any]) -> None:
        self.log, self.set_time = log, set_time
        self.pictures = 0
        self._start: float | None = None

    def show(
        self,
        name: str,
        photo: np.ndarray,
        depth: np.ndarray | DepthEstimate,
        time: float | None = None,
        camera: PinholeCamera | None = None,
    ) -> None:
        """Add a picture ``(H, W, 3)`` uint8 RGB and its depth ``(H, W)`` [m], with a camera its points too.

        ``time`` [s] is that of a film's frame.
        """
        import rerun as rr

        self.set_time("picture", sequence=self.pictures)
        if time is not None:
            self._start = time if self._start is None else self._start
            self.set_time("time", duration=time - self._start)
        estimate = as_estimate(depth)
        if camera is not None:
            log_camera(self.log, camera, estimate.depth.shape)
            known = np.where(np.isfinite(estimate.depth), estimate.depth, 0.0)
            if estimate.sigma is not None:
                known[estimate.unsure] = 0.0
            step = max(1, int(np.ceil(np.sqrt(known.size / MOST_POINTS))))
            points = back_project(known, camera.intrinsics)[::step, ::step].reshape(-1, 3)
            seen = points[:, 2] > 0
            points = points @ camera.rotation.T + camera.translation
            colors = photo[::step, ::step].reshape(-1, 3)
            cloud = rr.Points3D(points[seen], colors=colors[seen], radii=rr.Radius.ui_points(1.5))
            self.log(f"{WORLD}/points", cloud)
        image = rr.Image(photo).compress(jpeg_quality=JPEG_QUALITY)
        self.log(f"{WORLD}/camera/image", image)
        log_depth(self.log, estimate)
        self.log("name", rr.TextLog(name))
        self.pictures += 1

    def show_boxes(self, boxes: "Boxes3D") -> None:
        """Add the boxes of the picture that was shown last."""
        log_boxes(self.log, boxes)


def log_camera(
    log: Callable[..., Any], camera: PinholeCamera, size: tuple[int, int], path: str = WORLD
) -> None:
    """Log a camera of pictures of ``(height, width)``: x right, y down, z forward."""
    import rerun as rr

    log(path, rr.ViewCoordinates.RDF, static=True)
    log(f"{path}/camera", rr.Transform3D(translation=camera.translation, mat3x3=camera.rotation))
    log(
        f"{path}/camera",
        rr.Pinhole(
            image_from_camera=camera.intrinsics, width=size[1], height=size[0], image_plane_distance=0.5
        ),
    )


def log_depth(log: Callable[..., Any], estimate: DepthEstimate, path: str = WORLD) -> None:
    """Log depth, and sigma if there is one, ``(H, W)`` [m]; half precision is off by at most 0.05 %."""
    import rerun as rr

    log(f"{path}/camera/depth", rr.DepthImage(estimate.depth.astype(np.float16), meter=1.0))
    if estimate.sigma is not None:
        log(f"{path}/camera/sigma", rr.DepthImage(estimate.sigma.astype(np.float16), meter=1.0))


def log_boxes(log: Callable[..., Any], boxes: "Boxes3D", path: str = WORLD) -> None:
    """Log 3D boxes with their class, number and distance [m]."""
    import rerun as rr

    labels = [f"{box.name} {box.distance:.1f} m" for box in map(boxes.__getitem__, range(len(boxes)))]
    if boxes.track_id is not None:
        labels = [f"{label} #{number}" for label, number in zip(labels, boxes.track_id, strict=True)]
    turns = [rr.RotationAxisAngle(axis=(0, 1, 0), radians=float(yaw)) for yaw in boxes.yaw]
    shown: Any = rr.Boxes3D(
        centers=boxes.center, sizes=boxes.size[:, [0, 2, 1]], rotation_axis_angles=turns, labels=labels,
        class_ids=boxes.label,
    )  # fmt: skip
    log(f"{path}/boxes", shown)


@contextmanager
def open_recording(path: Path, *, points: bool) -> Iterator[RerunViewer]:
    """Yield a viewer that records to an ``.rrd`` file, which appears at the end, also after an error.

    Without pictures there is no file. With ``points`` the viewer opens with a view of the points.

    Raises:
        DiskError: the file cannot be written.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    recording = rr.RecordingStream("eldenet")
    flat = [rrb.Spatial2DView(origin=f"{WORLD}/camera/{kind}", name=kind) for kind in ("image", "depth")]
    views: list[Any] = [rrb.Vertical(*flat)]
    if points:
        # the depth image would show the points again, in false colors
        contents = [f"+ /{WORLD}/**", *(f"- /{WORLD}/camera/{kind}" for kind in ("depth", "sigma"))]
        views.insert(0, rrb.Spatial3DView(origin=WORLD, contents=contents, name="points"))
    layout = rrb.Blueprint(rrb.Horizontal(*views), collapse_panels=True)
    unfinished = part_path(path)
    viewer = RerunViewer(recording.log, recording.set_time)
    with writing(path.parent, path.name):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            recording.save(unfinished, default_blueprint=layout)
            yield viewer
        finally:
            recording.disconnect()
            if viewer.pictures:
                unfinished.replace(path)
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)

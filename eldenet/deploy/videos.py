"""Depth of the frames of a video or a camera, for ``eldenet.predict``."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.deploy.outputs import Results, in_time, open_video
from eldenet.deploy.stream import DepthStream, without_password
from eldenet.uncertainty import as_estimate
from eldenet.visualization import photo_beside_depth, visible_range

if TYPE_CHECKING:
    from eldenet.deploy.prediction import Timed
    from eldenet.results.run_log import RunLog
    from eldenet.system.signals import GracefulStop

RANGE_MEMORY = 0.9  # share of a video's color range that comes from the frame before


def predict_video(
    source: Path | str,
    name: str,
    predictor: "Timed",
    results: Results,
    log: "RunLog",
    stop: "GracefulStop",
    *,
    frames: int | None = None,
    timeout: float | None = 10.0,
) -> str:
    """Predict the frames of a video, or as many of a camera's as there is time for.

    Color becomes one .mp4 that shows each frame as long as it lasted; other formats are one file per frame. A
    camera runs until ``frames``, Ctrl-C, or ``timeout`` [s] without a new frame.

    Returns:
        Why the source ended early; empty where it is complete.

    Raises:
        ValueError: there was no frame.
    """
    shown = without_password(str(source))
    per_frame = [kind for kind in results.formats if kind != "color"]
    span = results.depth_range
    with DepthStream(source, predictor, timeout=timeout) as stream:
        stop.wake = stream.stop
        rate = results.frames_per_second = stream.frames_per_second
        with (
            log.bar("predicting", frames or stream.announced) as bar,
            open_video(results.folder / f"{name}_depth.mp4", rate) as video,
        ):
            add = in_time(video, rate)
            for _, photo, depth, taken in stream:
                camera = predictor.lens.camera_of(photo.shape)
                results.write(
                    f"{name}/{results.images:06d}", photo, depth, per_frame, time=taken, camera=camera
                )
                if "color" in results.formats:
                    shown_depth = as_estimate(depth)
                    span = results.depth_range or _follow(span, visible_range(shown_depth.depth))
                    unsure = results.shown_unsure(shown_depth)
                    add(photo_beside_depth(photo, shown_depth.depth, *span, unsure=unsure), taken)
                lost = f", {stream.dropped} dropped" if stream.drop else ""
                bar.advance(1, f"now {stream.fps:.0f} frames/s{lost}")
                if results.images == frames or stop:
                    break
            if not results.images and not stop:
                raise ValueError(
                    f"{shown} gave no frame: another program may be using it, or it sends nothing"
                    if stream.drop
                    else f"{shown} holds no frame that can be read: it is truncated, damaged or not a video"
                )
            speed, too_soon = bar.rate, stream.ended_too_soon
    origin = f" of {Path(shown).name}" + (f" ({stream.dropped} dropped)" if stream.drop else "")
    results.say(log, f"{results.images} frame{'s' * (results.images != 1)}{origin}", speed, stop)
    return f"{shown} {too_soon}" if too_soon and not stop and results.images != frames else ""


def _follow(span: tuple[float, float] | None, now: tuple[float, float]) -> tuple[float, float]:
    """Move the range of the colors slowly, so that a video does not flicker."""
    if span is None:
        return now
    near, far = (RANGE_MEMORY * old + (1 - RANGE_MEMORY) * new for old, new in zip(span, now, strict=True))
    return near, far

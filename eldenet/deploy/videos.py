"""The frames of a video or a camera, for ``eldenet.predict``."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from eldenet.deploy.outputs import Results
    from eldenet.results.run_log import RunLog
    from eldenet.system.signals import GracefulStop

    Predictor = Callable[[np.ndarray], np.ndarray]  # frame -> depth [m]

RANGE_MEMORY = 0.9  # of a video's colors: the share of the range that the frame before decides


def predict_video(
    source: Path | str,
    name: str,
    predictor: "Predictor",
    results: "Results",
    log: "RunLog",
    stop: "GracefulStop",
    *,
    frames: int | None = None,
) -> str:
    """Predict the frames of a video, or those of a camera that there is time for.

    Color becomes one .mp4, which shows each frame as long as it lasted; the others one file a frame. A
    camera runs until ``frames`` or Ctrl-C.

    Returns:
        What broke off the source too soon, and how much of it was read; empty where nothing did.

    Raises:
        ValueError: there was no frame.
    """
    from eldenet.deploy.outputs import in_time, open_video
    from eldenet.deploy.stream import DepthStream, without_password
    from eldenet.visualization import photo_beside_depth, visible_range

    shown = without_password(str(source))
    file = results.folder / f"{name}_depth.mp4"
    per_frame = [kind for kind in results.formats if kind != "color"]
    span = results.depth_range
    with DepthStream(source, predictor) as stream:
        stop.wake = stream.stop
        rate = results.frames_per_second = stream.frames_per_second
        with (
            log.bar("predicting", frames or stream.announced) as bar,
            open_video(file, rate, lambda film: results.note(film, name)) as film,
        ):
            add = in_time(film, rate)
            for _, photo, depth, taken in stream:
                results.write(f"{name}/{results.images:06d}", photo, depth, per_frame, time=taken)
                if "color" in results.formats:
                    span = results.depth_range or _follow(span, visible_range(depth))
                    add(photo_beside_depth(photo, depth, *span), taken)
                lost = f", {stream.dropped} dropped" if stream.drop else ""
                bar.advance(1, f"now {stream.fps:.0f} frames/s{lost}")
                if results.images == frames or stop:
                    break
            if not results.images and not stop:
                raise ValueError(
                    f"{shown} gave no frame: in use elsewhere, or nothing sends there"
                    if stream.drop
                    else f"{shown} holds no frame that can be read: it is cut, damaged or no video"
                )
            speed, too_soon = bar.rate, stream.ended_too_soon
    origin = f" of {Path(shown).name}" + (f" ({stream.dropped} dropped)" if stream.drop else "")
    results.say(log, f"{results.images} frame{'s' * (results.images != 1)}{origin}", speed, stop)
    return f"{shown} {too_soon}" if too_soon and not stop and results.images != frames else ""


def _follow(span: tuple[float, float] | None, now: tuple[float, float]) -> tuple[float, float]:
    """The colors' range, moving slowly, so that a video does not flicker."""
    if span is None:
        return now
    near, far = (RANGE_MEMORY * old + (1 - RANGE_MEMORY) * new for old, new in zip(span, now, strict=True))
    return near, far

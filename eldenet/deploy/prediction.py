"""Depth of a picture, a folder of pictures, a video, a bag of ROS or a camera, written to files."""

import re
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.data.bags import Bag, is_bag
from eldenet.data.io import HEIF_ENDINGS, read_image
from eldenet.deploy.lens import Lens
from eldenet.deploy.outputs import Results, name_results
from eldenet.deploy.stream import DepthStream, is_live
from eldenet.deploy.video_files import in_time, is_video_file, open_video
from eldenet.system.escaping import without_password
from eldenet.system.extras import require
from eldenet.uncertainty import as_estimate
from eldenet.visualization import photo_beside_depth, visible_range

if TYPE_CHECKING:
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.results.run_log import RunLog
    from eldenet.system.signals import GracefulStop

RANGE_MEMORY = 0.9  # share of a video's color range that comes from the frame before
REMEMBERED = 10_000  # pictures whose times are kept: a camera may run for days


@dataclass(frozen=True)
class Source:
    """What ``source`` names, and the names of its results.

    Attributes:
        names: picture -> name of its results; a video or camera is one entry.
        is_video: whether it is a video, a bag of ROS, a camera or an address.
        is_live: whether it is a camera or an address.
        bag: the bag of ROS that the video is, if it is one.
    """

    names: dict[Path | str, str]
    is_video: bool
    is_live: bool
    bag: Bag | None = None


class TimedPredictor:
    """A depth predictor that finds each picture's lens, and records that and how long each picture took.

    Attributes:
        seconds: that each of the last pictures took.
        max_depth: largest depth that the network can predict [m]; None: any.
    """

    def __init__(self, predictor: "DepthPredictor", lens: Lens) -> None:
        self.predictor, self.lens = predictor, lens
        self.max_depth = predictor.max_depth
        self.seconds: deque[float] = deque(maxlen=REMEMBERED)

    def __call__(self, frame: np.ndarray, path: Path | None = None) -> Any:
        """Depth ``(H, W)`` [m] of a frame, with its sigma if the network predicts it.

        ``path`` is that of the photo: its EXIF, or KITTI's calibration beside it, may know the lens.
        """
        focal = self.lens.focal_of(frame.shape, path)
        start = time.perf_counter()
        depth = self.predictor(frame, focal=focal)
        self.seconds.append(time.perf_counter() - start)
        self.lens.origins[self.lens.found] += 1
        return depth


def find_source(
    given: str, output: Path, frames: int | None, topic: str | None = None, intrinsics: Any = None
) -> Source:
    """Find the pictures or the video that ``source`` names; ``frames`` limits the pictures.

    ``topic`` and ``intrinsics`` are those of :class:`~eldenet.data.bags.Bag`.

    Raises:
        FileNotFoundError: there is no such source.
        ValueError: a file is neither picture nor video, or a folder or bag gives no pictures.
    """
    if is_live(given):
        require(f"source={without_password(given)}", "av")
        name = re.sub(r"\W+", "_", without_password(given)).strip("_")
        return Source({given: name}, is_video=True, is_live=True)
    path = Path(given).expanduser()
    if is_bag(path):
        require(f"source={given}", "av")
        bag = Bag(path, topic, intrinsics)
        name = path.name if path.is_dir() else path.stem
        return Source({path: name}, is_video=True, is_live=False, bag=bag)
    if path.is_file() and is_video_file(path):
        require(f"source={given}", "av")
        return Source({path: path.stem}, is_video=True, is_live=False)
    source = Source(dict(islice(name_results(path, output).items(), frames)), is_video=False, is_live=False)
    if any(Path(picture).suffix.lower() in HEIF_ENDINGS for picture in source.names):
        require("reading HEIC pictures", "pillow_heif")  # not only when its turn comes
    return source


def predict_pictures(
    names: Mapping[Path | str, str],
    predictor: TimedPredictor,
    results: Results,
    log: "RunLog",
    stop: "GracefulStop",
    *,
    skip_unreadable: bool = False,
) -> None:
    """Predict the pictures of ``names``, picture -> name of its results, that are not done yet.

    Raises:
        ValueError: a picture cannot be read, or the lens does not fit it; with ``skip_unreadable``: none of
            them can be.
    """
    done = {path for path, name in names.items() if results.goes_on and results.has(name, Path(path))}
    pictures = {path: name for path, name in names.items() if path not in done}
    if done:
        log.say(f"{len(done)} of {len(names)} pictures were done before the command stopped")
    with log.bar("predicting", len(pictures)) as bar:
        for path, name in pictures.items():
            if stop:
                break
            try:
                photo = read_image(path, upright=True)
                camera = predictor.lens.camera_of(photo.shape, Path(path))
                depth = predictor(photo, Path(path))
            except (ValueError, OSError) as error:
                said = str(error) if str(path) in str(error) else f"{path}: {error}"
                if not skip_unreadable and len(pictures) > 1:
                    count = f"{results.images} of {len(pictures)} pictures are done"
                    raise ValueError(f"{said} ({count}; on_error=skip skips such files)") from error
                if not skip_unreadable:
                    raise type(error)(said) from error
                results.skipped.append(said)
            else:
                results.write(name, photo, depth, results.formats, camera=camera)
            bar.advance(1)
        rate = results.images / max(bar.done, 1) * bar.rate
    if pictures and not results.images and not stop:
        raise ValueError(f"none of {len(pictures)} pictures could be read; the first: {results.skipped[0]}")
    of = f" of {len(pictures)}" if stop else ""
    results.summarize(log, f"{results.images}{of} picture{'s' * (results.images != 1)}", rate, stop)


def predict_video(
    source: Path | str | Bag,
    name: str,
    predictor: TimedPredictor,
    results: Results,
    log: "RunLog",
    stop: "GracefulStop",
    *,
    frames: int | None = None,
    timeout: float | None = 10.0,
) -> str:
    """Predict the frames of a video or a bag, or as many of a camera's as there is time for.

    Color becomes one .mp4 that shows each frame as long as it lasted; other formats are one file per frame. A
    camera runs until ``frames``, Ctrl-C, or ``timeout`` [s] without a new frame.

    Returns:
        Why the source ended early; empty where it is complete.

    Raises:
        ValueError: there was no frame.
    """
    shown = str(source.path) if isinstance(source, Bag) else without_password(str(source))
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
    results.summarize(log, f"{results.images} frame{'s' * (results.images != 1)}{origin}", speed, stop)
    return f"{shown} {too_soon}" if too_soon and not stop and results.images != frames else ""


def _follow(span: tuple[float, float] | None, now: tuple[float, float]) -> tuple[float, float]:
    """Move the range of the colors slowly, so that a video does not flicker."""
    if span is None:
        return now
    near, far = (RANGE_MEMORY * old + (1 - RANGE_MEMORY) * new for old, new in zip(span, now, strict=True))
    return near, far

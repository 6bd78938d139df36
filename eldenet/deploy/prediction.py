"""Depth of a picture, a folder of pictures, a video or a camera, written to files."""

import re
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import eldenet
from eldenet.deploy.lens import Lens
from eldenet.deploy.outputs import Results, name_results
from eldenet.deploy.stream import DepthStream, is_live, without_password
from eldenet.deploy.video_files import in_time, is_video_file, open_video
from eldenet.deploy.viewer import RerunViewer, open_recording
from eldenet.system.extras import require
from eldenet.uncertainty import NO_SIGMA, as_estimate
from eldenet.visualization import photo_beside_depth, visible_range
from eldenet.weights import BEST, find_checkpoint

if TYPE_CHECKING:
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.deploy.runtimes import Runtime
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import Resources
    from eldenet.system.signals import GracefulStop

RANGE_MEMORY = 0.9  # share of a video's color range that comes from the frame before
REMEMBERED = 10_000  # pictures whose times are kept: a camera may run for days


@dataclass(frozen=True)
class Source:
    """What ``source`` names, and the names of its results.

    Attributes:
        names: picture -> name of its results; a video or camera is one entry.
        is_video: whether it is a video or a camera.
        is_live: whether it is a camera or an address.
    """

    names: dict[Path | str, str]
    is_video: bool
    is_live: bool


@dataclass(frozen=True)
class PredictionSetup:
    """The settings of ``configs/predict.yaml``, checked; it explains those that are not listed here.

    Attributes:
        source: pictures or video.
        results: writes the results.
        resources: threads and device.
        skip_unreadable: list pictures that cannot be read instead of stopping.
        intrinsics: ``(3, 3)`` of the pictures [px], or None.
        recording: ``.rrd`` file for the Rerun viewer, or None.
        boxes: ``boxes(results, names, log, seconds, max_depth)`` is entered before the pictures are
            predicted, and gives what :attr:`Results.also` calls; None: no 3D boxes.
    """

    source: Source
    results: Results
    resources: "Resources"
    skip_unreadable: bool
    recording: Path | None
    boxes: Callable[..., AbstractContextManager[Any]] | None
    intrinsics: np.ndarray | None
    focal: float | None
    fov: float | None
    checkpoint: str
    engine: str
    input_size: tuple[int, int] | None
    max_side: int
    frames: int | None
    camera_timeout: float | None
    steady: bool
    sharp: bool
    trusted_modules: Sequence[str]


def predict(setup: PredictionSetup) -> Results:
    """Load the network, predict, write the results, and say what was done.

    Raises:
        ValueError: a picture cannot be read, or the network cannot run here.
        KeyboardInterrupt: Ctrl-C, after the current picture; a camera ends without.
        OSError: the source ended early; earlier results are written.
    """
    from eldenet.results.run_log import RunLog
    from eldenet.system.signals import GracefulStop

    source, results = setup.source, setup.results
    names = list(source.names.values())
    log = RunLog(results.folder)
    network = open_predictor(setup, log)
    lens = Lens(network.canonical_px, intrinsics=setup.intrinsics, focal=setup.focal, fov=setup.fov)
    predictor = Timed(network, lens)
    boxes: AbstractContextManager[Any] = nullcontext()
    viewer: AbstractContextManager[RerunViewer | None] = nullcontext()
    if setup.boxes is not None:
        boxes = setup.boxes(results, names, log, predictor.seconds, predictor.max_depth)
    if setup.recording is not None:
        known = any(value is not None for value in (setup.intrinsics, setup.focal, setup.fov, setup.boxes))
        viewer = open_recording(setup.recording, points=known)
    broken = ""
    done = {path for path, name in source.names.items() if results.goes_on and results.has(name, Path(path))}
    with GracefulStop() as stop, viewer as results.viewer, boxes as results.also:
        if source.is_video:
            ((path, name),) = source.names.items()
            broken = predict_video(
                path, name, predictor, results, log, stop, frames=setup.frames, timeout=setup.camera_timeout
            )
        else:
            predict_pictures(setup, predictor, log, stop, done)
    points = setup.boxes is not None or setup.recording is not None or "ply" in results.formats
    if results.images and (line := lens.describe(points=points)):
        log.say(line)
    if results.images and setup.recording is not None:
        log.say(f"recording: rerun {setup.recording}")
    if not stop or source.is_live:
        results.end()
    if broken:
        raise OSError(f"{broken}; earlier results are in {results.folder}")
    if not source.is_live:
        stop.obey()
    return results


class Timed:
    """A depth predictor that finds each picture's lens and records how long each picture took.

    Attributes:
        seconds: of each of the last pictures.
        max_depth: of the network [m], or None.
    """

    def __init__(self, predictor: "DepthPredictor", lens: Lens) -> None:
        self.predictor, self.lens = predictor, lens
        self.max_depth = predictor.max_depth
        self.seconds: deque[float] = deque(maxlen=REMEMBERED)

    def __call__(self, frame: np.ndarray, path: Path | None = None) -> Any:
        """Depth ``(H, W)`` [m] of a frame, with its sigma if the network predicts it.

        ``path`` is of the photo, whose EXIF may know the lens.
        """
        focal = self.lens.focal_of(frame.shape, path)
        start = time.perf_counter()
        depth = self.predictor(frame, focal=focal)
        self.seconds.append(time.perf_counter() - start)
        return depth


def find_source(given: str, output: Path, frames: int | None) -> Source:
    """Find the pictures or the video that ``source`` names; ``frames`` limits the pictures.

    Raises:
        FileNotFoundError: there is no such source.
        ValueError: a file is neither picture nor video, or a folder holds no pictures.
    """
    if is_live(given):
        require(f"source={without_password(given)}", "av")
        name = re.sub(r"\W+", "_", without_password(given)).strip("_")
        return Source({given: name}, is_video=True, is_live=True)
    path = Path(given).expanduser()
    if path.is_file() and is_video_file(path):
        require(f"source={given}", "av")
        return Source({path: path.stem}, is_video=True, is_live=False)
    return Source(dict(islice(name_results(path, output).items(), frames)), is_video=False, is_live=False)


def open_predictor(setup: PredictionSetup, log: "RunLog") -> "DepthPredictor":
    """Load the network: an exported file under its runtime, a model under torch unless ``engine`` says else.

    Raises:
        ValueError: the runtime cannot run it here.
    """
    from eldenet.deploy import runtimes
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.results.run_log import untrained_note

    checkpoint, size, max_side = setup.checkpoint, setup.input_size, setup.max_side
    resources = setup.resources
    network: DepthNet | Runtime
    device = None  # a runtime has its own
    kind = find_checkpoint(checkpoint, "checkpoint").kind
    if kind == "exported":
        network = runtimes.load(checkpoint, setup.engine, threads=resources.threads, device=resources.device)
        log.say(f"{checkpoint}: {network.runtime}, {network.precision}, {network.threads} threads")
    else:
        network = model = eldenet.load(checkpoint, trusted_modules=setup.trusted_modules)
        default = " (the default; checkpoint=... takes others)" if checkpoint == BEST else ""
        log.say(f"weights: {checkpoint}{default}")
        if setup.engine in ("auto", "torch"):
            device = resources.device
        else:
            network = runtimes.load(
                model, setup.engine, threads=resources.threads, device=resources.device, size=size
            )
    predictor = DepthPredictor(
        network,
        size,
        max_side=max_side,
        device=device,
        steady=setup.steady and setup.source.is_video,
        sharp=setup.sharp and not setup.source.is_video and setup.boxes is None,
        uncertainty=knows_sigma(setup, network),
    )
    if kind == "network":
        log.say(untrained_note(checkpoint))
    elif predictor.input_size is None:
        log.say(
            f"note: {checkpoint} does not say at which size it was trained, so it sees pictures at their own "
            f"(longer side at most {max_side} px): if the depth looks wrong, give input_size=[h,w]"
        )
    return predictor


def knows_sigma(setup: PredictionSetup, network: "DepthNet | Runtime") -> bool:
    """Return whether the network predicts its sigma, which the pictures then show.

    Raises:
        ValueError: it predicts none, but ``formats`` asks for it.
    """
    if "sigma" in setup.results.formats and network.distribution is None:
        raise ValueError(f"formats has sigma: {NO_SIGMA}")
    return network.distribution is not None


def predict_pictures(
    setup: PredictionSetup,
    predictor: Timed,
    log: "RunLog",
    stop: "GracefulStop",
    done: Collection[Path | str] = (),
) -> None:
    """Predict the pictures that are not ``done``; unreadable ones stop it or are listed at the end."""
    from eldenet.data.io import read_image

    results = setup.results
    pictures = {path: name for path, name in setup.source.names.items() if path not in done}
    if done:
        log.say(f"{len(done)} of {len(setup.source.names)} pictures were done before the command stopped")
    with log.bar("predicting", len(pictures)) as bar:
        for path, name in pictures.items():
            if stop:
                break
            try:
                photo = read_image(path, upright=True)
            except (ValueError, OSError) as error:
                if not setup.skip_unreadable and len(pictures) > 1:
                    count = f"{results.images} of {len(pictures)} pictures are done"
                    raise ValueError(f"{error} ({count}; on_error=skip skips such files)") from error
                if not setup.skip_unreadable:
                    raise
                results.skipped.append(str(error))
            else:
                camera = predictor.lens.camera_of(photo.shape, Path(path))
                results.write(name, photo, predictor(photo, Path(path)), results.formats, camera=camera)
            bar.advance(1)
        rate = results.images / max(bar.done, 1) * bar.rate
    if pictures and not results.images and not stop:
        raise ValueError(f"none of {len(pictures)} pictures could be read; the first: {results.skipped[0]}")
    of = f" of {len(pictures)}" if stop else ""
    results.summarize(log, f"{results.images}{of} picture{'s' * (results.images != 1)}", rate, stop)


def predict_video(
    source: Path | str,
    name: str,
    predictor: Timed,
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
    results.summarize(log, f"{results.images} frame{'s' * (results.images != 1)}{origin}", speed, stop)
    return f"{shown} {too_soon}" if too_soon and not stop and results.images != frames else ""


def _follow(span: tuple[float, float] | None, now: tuple[float, float]) -> tuple[float, float]:
    """Move the range of the colors slowly, so that a video does not flicker."""
    if span is None:
        return now
    near, far = (RANGE_MEMORY * old + (1 - RANGE_MEMORY) * new for old, new in zip(span, now, strict=True))
    return near, far

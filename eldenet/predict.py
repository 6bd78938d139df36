"""``python -m eldenet.predict``: depth of a picture, a folder of pictures, a video, or a camera."""

import re
import time
from collections import deque
from contextlib import AbstractContextManager, nullcontext
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point, refuse_unread

if TYPE_CHECKING:
    from collections.abc import Callable

    from omegaconf import DictConfig

    from eldenet.deploy.outputs import Results
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import Resources
    from eldenet.system.signals import GracefulStop

    Predictor = Callable[[np.ndarray], np.ndarray]  # frame -> depth [m]


@entry_point("predict")
def main(config: "DictConfig", folder: Path) -> None:
    """Predict and write; ``folder`` is not used, results go to ``output``."""
    if not config.boxes:
        refuse_unread(("perception",), "3D boxes are made with boxes=true alone")
    try:
        predict(config)
    except KeyboardInterrupt:
        raise SystemExit(130) from None  # as shells count it


def predict(config: "DictConfig") -> "Results":
    """Check everything that can be checked, load the network, predict, write, say what was done.

    Raises:
        KeyboardInterrupt: Ctrl-C ended it, after the picture in work was finished; a camera ends so without.
        OSError: the source broke off; what came before it is written.
    """
    from eldenet.deploy.manifest import Written
    from eldenet.deploy.stream import is_live, without_password
    from eldenet.deploy.videos import predict_video
    from eldenet.perception.box_results import box_results
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import choose_resources
    from eldenet.system.signals import GracefulStop

    given = str(config.source)
    live, source = is_live(given), Path(given).expanduser()
    kind = kind_of(source, live=live)
    is_video = kind == "video"
    results = read_settings(config, is_video=is_video)
    names = name_sources(source, kind, given if live else "", results.folder)
    names = dict(islice(names.items(), config.frames))  # one name stands for all frames of a video
    named = list(names.values())
    files = [file for name in named for file in results.files(name, is_video=is_video)]
    results.refuse_to_overwrite(list(names), files)
    resources = choose_resources(**cfg.plain(config.runtime))
    log = RunLog(results.folder)
    predictor = Timed(open_predictor(config, resources, log))
    about = {"source": without_password(given), "checkpoint": str(config.checkpoint)}
    results.video, broken = named[0] if is_video else "", ""
    with Written(results.folder, kind, names, about) as results.written, GracefulStop() as stop:
        boxes: AbstractContextManager[Any] = nullcontext()
        if config.boxes:
            perception = cfg.build_perception(config, results.intrinsics, is_video=is_video)
            boxes = box_results(perception, results, named, log, predictor.seconds, is_video=is_video)
        with boxes as results.also:
            if is_video:
                stream = given if live else source
                broken = predict_video(stream, named[0], predictor, results, log, stop, frames=config.frames)
            else:
                predict_pictures(names, predictor, results, log, stop, skip=config.on_error == "skip")
        results.written.ended = {"ended": str(stop) or broken or "complete", "images": results.images}
    if broken:
        raise OSError(f"{broken}; what came before that is in {results.folder}")
    if not live:
        stop.obey()
    return results


class Timed:
    """A depth predictor that keeps the times [s] of the last images in ``seconds``."""

    def __init__(self, predictor: "Predictor") -> None:
        self.predictor = predictor
        self.seconds: deque[float] = deque(maxlen=10_000)

    def __call__(self, frame: np.ndarray) -> np.ndarray:
        """Depth ``(H, W)`` [m] of a frame."""
        start = time.perf_counter()
        depth = self.predictor(frame)
        self.seconds.append(time.perf_counter() - start)
        return depth


def kind_of(source: Path, *, live: bool) -> str:
    """Whether it is a "video" (or a camera), a "folder" or a "picture".

    Raises:
        ValueError: a file that is neither a picture nor a video.
    """
    from eldenet.deploy.video_files import is_video_file

    if live or (source.is_file() and is_video_file(source)):
        return "video"
    return "folder" if source.is_dir() else "picture"


def name_sources(source: Path, kind: str, address: str, output: Path) -> dict[Path, str]:
    """Results' names by what they are of; ``address`` is a camera's or a stream's."""
    from eldenet.deploy.outputs import name_results
    from eldenet.deploy.stream import without_password

    if kind != "video":
        return name_results(source, output)
    return {source: re.sub(r"\W+", "_", without_password(address)).strip("_") if address else source.stem}


def open_predictor(config: "DictConfig", resources: "Resources", log: "RunLog") -> "DepthPredictor":
    """The network behind ``checkpoint``: an exported file under the fastest runtime, a model under torch.

    Raises:
        ValueError: a runtime that is unknown, or does not run such a file here.
    """
    import eldenet
    from eldenet.deploy import runtimes
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.system.checks import one_of

    one_of("engine", str(config.engine), ("auto", *runtimes.RUNTIMES))
    engine = str(config.engine)
    size = cfg.plain(config.input_size)
    is_file = Path(str(config.checkpoint)).suffix in runtimes.READS
    by_torch = not is_file and engine in ("auto", *runtimes.TORCH)
    # of the others "auto" is the CPU: an accelerator needs another build of them
    device = resources.device if by_torch or config.runtime.device != "auto" else "cpu"
    if is_file:
        network = runtimes.load(str(config.checkpoint), engine, threads=resources.threads, device=device)
        log.say(f"{config.checkpoint}: {network.runtime}, {network.precision}, {network.threads} threads")
        predictor = DepthPredictor(network, size, max_side=config.max_side)
    else:
        model = eldenet.load(config.checkpoint, trusted_modules=cfg.plain(config.trusted_modules))
        if engine in ("auto", "torch"):
            predictor = DepthPredictor(model, size, max_side=config.max_side, device=device)
        else:
            network = runtimes.load(model, engine, threads=resources.threads, device=device, size=size)
            predictor = DepthPredictor(network, size, max_side=config.max_side)
    say_what_is_doubtful(config, predictor, log)
    return predictor


def say_what_is_doubtful(config: "DictConfig", predictor: "DepthPredictor", log: "RunLog") -> None:
    """Say why this network's depth may mean nothing, or less than it could."""
    from eldenet.zoo import note_if_untrained

    if note := note_if_untrained(config.checkpoint):
        log.say(note)
    elif predictor.input_size is None:
        log.say(
            f"note: {config.checkpoint} does not say at which size it was trained: it sees pictures at their "
            f"own (longer side at most {config.max_side} px): if the depth looks wrong, give input_size=[h,w]"
        )


def read_settings(config: "DictConfig", *, is_video: bool) -> "Results":
    """Check the settings that speak of results."""
    from eldenet.deploy.outputs import ENDING, Results
    from eldenet.geometry import pinhole
    from eldenet.system.checks import one_of

    one_of("on_error", str(config.on_error), ("stop", "skip"))
    if config.frames is not None and not (isinstance(config.frames, int) and config.frames >= 1):
        raise ValueError(f"frames={config.frames}: give a whole number above 0, or null for all")
    camera, span = _numbers(config, "intrinsics", 4), _numbers(config, "depth_range", 2)
    if camera is not None and not (camera[0] > 0 and camera[1] > 0):
        raise ValueError(f"intrinsics={camera}: give [fx, fy, cx, cy] in pixels, focal lengths above 0")
    if span is not None and not 0 <= span[0] < span[1]:
        raise ValueError(f"depth_range={span}: give [near, far] in meters, 0 <= near < far")
    if config.formats is None:
        formats = (
            ["color"]
            if is_video
            else ["depth", "color"] + ["ply"] * (camera is not None and not config.boxes)
        )
    else:
        formats = cfg.listed(config.formats)
    for name in formats:
        one_of("formats", str(name), tuple(ENDING))
    if not formats:
        raise ValueError(f"formats is empty: give some of {', '.join(ENDING)}")
    if ("ply" in formats) != (camera is not None) and not (config.boxes and camera is not None):
        raise ValueError(
            "a point cloud needs intrinsics=[fx,fy,cx,cy] of the source's pictures [px]"
            if camera is None
            else f"intrinsics are for point clouds, and formats={formats} asks for none: add ply"
        )
    matrix = None if camera is None else pinhole(*camera)
    near_far = None if span is None else (span[0], span[1])
    return Results(Path(config.output).expanduser(), tuple(formats), matrix, near_far, bool(config.overwrite))


def predict_pictures(
    pictures: dict[Path, str],
    predictor: "Predictor",
    results: "Results",
    log: "RunLog",
    stop: "GracefulStop",
    *,
    skip: bool,
) -> None:
    """Predict every picture; with ``skip``, those that cannot be read are listed instead."""
    from eldenet.data.io import read_image

    with log.bar("predicting", len(pictures)) as bar:
        for path, name in pictures.items():
            if stop:
                break
            try:
                photo = read_image(path, upright=True)
            except (ValueError, OSError) as error:
                if not skip and len(pictures) > 1:
                    done = f"{results.images} of {len(pictures)} pictures are done"
                    raise ValueError(f"{error} ({done}; on_error=skip goes past such files)") from error
                if not skip:
                    raise
                results.skipped.append(str(error))
            else:
                results.write(name, photo, predictor(photo), results.formats)
            bar.advance(1)
        rate = results.images / max(bar.done, 1) * bar.rate
    if not results.images and not stop:
        raise ValueError(f"none of {len(pictures)} pictures could be read, such as: {results.skipped[0]}")
    of = f" of {len(pictures)}" if stop else ""
    results.say(log, f"{results.images}{of} picture{'s' * (results.images != 1)}", rate, stop)


def _numbers(config: "DictConfig", name: str, count: int) -> list[float] | None:
    given = cfg.plain(config[name])
    if given is None:
        return None
    try:
        numbers = [float(value) for value in given]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        meaning = {"intrinsics": "[fx, fy, cx, cy] in pixels", "depth_range": "[near, far] in meters"}[name]
        raise ValueError(f"{name}={given}: give {meaning}, {count} numbers")
    return numbers


if __name__ == "__main__":
    main()

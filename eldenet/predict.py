"""``python -m eldenet.predict``: depth of a picture, a folder of pictures, a video, or a camera."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldenet import config as cfg

if TYPE_CHECKING:
    from collections.abc import Callable

    from omegaconf import DictConfig

    from eldenet.predictions import Results
    from eldenet.predictor import DepthPredictor
    from eldenet.resources import Resources
    from eldenet.runlog import RunLog

    Predictor = Callable[[np.ndarray], np.ndarray]  # frame -> depth [m]

VIDEO_ENDINGS = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")
RANGE_MEMORY = 0.9  # of a video's colours: the share of the range that the frame before decides


@cfg.entry_point("predict")
def main(config: "DictConfig", folder: Path) -> None:
    """Predict and write; ``folder`` is not used, results go to ``output``."""
    predict(config)


def predict(config: "DictConfig") -> "Results":
    """Check everything that can be checked, load the network, predict, write, say what was done."""
    import eldenet
    from eldenet.predict_boxes import Timed, box_results
    from eldenet.predictions import name_results
    from eldenet.resources import choose_resources
    from eldenet.runlog import RunLog
    from eldenet.runtimes.stream import is_live, without_password

    live = is_live(str(config.source))
    source = Path(str(config.source)).expanduser()
    is_video = live or (source.is_file() and source.suffix.lower() in VIDEO_ENDINGS)
    results = read_settings(config, is_video=is_video)
    if live:
        names = {source: re.sub(r"\W+", "_", without_password(str(config.source))).strip("_")}
    else:
        names = {source: source.stem} if is_video else name_results(source, results.folder)
    files = [file for name in names.values() for file in results.files(name, is_video=is_video)]
    results.refuse_to_overwrite(list(names), files)
    resources = choose_resources(**cfg.plain(config.runtime))
    log = RunLog(results.folder)
    predictor = open_predictor(config, resources, log)
    if str(config.checkpoint) in eldenet.list_models():
        log.say(f"note: {config.checkpoint} is a freshly initialised network: its depth means nothing")
    elif predictor.input_size is None:
        log.say(
            f"note: {config.checkpoint} does not say at which size it was trained: it sees pictures at their "
            f"own (longer side at most {config.max_side} px): if the depth looks wrong, give input_size=[h,w]"
        )
    timed = Timed(predictor)
    named = list(names.values())
    with box_results(config, results, named, log, timed.seconds, is_video=is_video) as results.also:
        if is_video:
            stream = str(config.source) if live else source
            predict_video(stream, names[source], timed, results, log, frames=config.frames)
        else:
            predict_pictures(names, timed, results, log, skip=config.on_error == "skip")
    return results


def open_predictor(config: "DictConfig", resources: "Resources", log: "RunLog") -> "DepthPredictor":
    """The network behind ``checkpoint``: an exported file under the fastest runtime, a model under torch.

    Raises:
        ValueError: a runtime that is unknown, or does not run such a file here.
    """
    import eldenet
    from eldenet import runtimes
    from eldenet.data.roots import one_of
    from eldenet.predictor import DepthPredictor

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
        return DepthPredictor(network, size, max_side=config.max_side)
    model = eldenet.load(config.checkpoint, trusted_modules=cfg.plain(config.trusted_modules))
    if engine in ("auto", "torch"):
        return DepthPredictor(model, size, max_side=config.max_side, device=device)
    return DepthPredictor(
        runtimes.load(model, engine, threads=resources.threads, device=device, size=size),
        size,
        max_side=config.max_side,
    )


def read_settings(config: "DictConfig", *, is_video: bool) -> "Results":
    """Check the settings that speak of results."""
    from eldenet.data.roots import one_of
    from eldenet.geometry import pinhole
    from eldenet.predictions import ENDING, Results

    one_of("on_error", str(config.on_error), ("stop", "skip"))
    if config.frames is not None and not (isinstance(config.frames, int) and config.frames >= 1):
        raise ValueError(f"frames={config.frames}: give a whole number above 0, or null for all")
    camera, span = _numbers(config, "intrinsics", 4), _numbers(config, "depth_range", 2)
    if camera is not None and not (camera[0] > 0 and camera[1] > 0):
        raise ValueError(f"intrinsics={camera}: give [fx, fy, cx, cy] in pixels, focal lengths above 0")
    if span is not None and not 0 <= span[0] < span[1]:
        raise ValueError(f"depth_range={span}: give [near, far] in metres, 0 <= near < far")
    formats = cfg.plain(config.formats)
    if formats is None:
        formats = (
            ["colour"]
            if is_video
            else ["depth", "colour"] + ["ply"] * (camera is not None and not config.boxes)
        )
    formats = [formats] if isinstance(formats, str) else formats
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
    pictures: dict[Path, str], predictor: "Predictor", results: "Results", log: "RunLog", *, skip: bool
) -> None:
    """Predict every picture; with ``skip``, those that cannot be read are listed instead."""
    from eldenet.data.io import read_image

    with log.bar("predicting", len(pictures)) as bar:
        for path, name in pictures.items():
            try:
                photo = read_image(path, upright=True)
            except (ValueError, FileNotFoundError) as error:
                if not skip:
                    raise
                results.skipped.append(str(error))
            else:
                results.write(name, photo, predictor(photo), results.formats)
                results.images += 1
            bar.advance(1)
        rate = results.images / max(len(pictures), 1) * bar.rate
    if not results.images:
        raise ValueError(f"none of {len(pictures)} pictures could be read, such as: {results.skipped[0]}")
    say_what_was_done(log, results, f"{results.images} picture{'s' * (results.images != 1)}", rate)


def predict_video(
    source: Path | str,
    name: str,
    predictor: "Predictor",
    results: "Results",
    log: "RunLog",
    *,
    frames: int | None = None,
) -> None:
    """Predict the frames of a video, or those of a camera that there is time for.

    Colour becomes one .mp4, which shows each frame as long as it lasted; the others one file a frame. A
    camera runs until ``frames`` or Ctrl-C.
    """
    from eldenet.legend import photo_beside_depth, visible_range
    from eldenet.predictions import in_time, open_video
    from eldenet.runtimes.stream import DepthStream, without_password

    shown = without_password(str(source))
    file = results.folder / f"{name}_depth.mp4"
    per_frame = [kind for kind in results.formats if kind != "colour"]
    span = results.depth_range
    with DepthStream(source, predictor) as stream:
        total = frames or stream.announced
        rate = results.frames_per_second = stream.frames_per_second
        with log.bar("predicting", total) as bar, open_video(file, rate) as film:
            add = in_time(film, rate)
            try:
                for _, photo, depth, taken in stream:
                    results.write(f"{name}/{results.images:06d}", photo, depth, per_frame, time=taken)
                    if "colour" in results.formats:
                        span = results.depth_range or _follow(span, visible_range(depth))
                        add(photo_beside_depth(photo, depth, *span), taken)
                    results.images += 1
                    lost = f", {stream.dropped} dropped" if stream.drop else ""
                    bar.advance(1, f"now {stream.fps:.0f} frames/s{lost}")
                    if results.images == frames:
                        break
            except KeyboardInterrupt:
                if not stream.drop:
                    raise
            if not results.images and stream.drop:
                raise ValueError(f"{shown} gave no frame: in use elsewhere, or nothing sends there")
            if not results.images:
                raise ValueError(f"{shown} holds no frame that can be read: it is cut, damaged or no video")
            speed, too_soon = bar.rate, stream.ended_too_soon
    origin = f" of {Path(shown).name}" + (f" ({stream.dropped} dropped)" if stream.drop else "")
    say_what_was_done(log, results, f"{results.images} frame{'s' * (results.images != 1)}{origin}", speed)
    if too_soon and results.images != frames:
        log.say(f"{shown} {too_soon}")


def say_what_was_done(log: "RunLog", results: "Results", what: str, rate: float) -> None:
    """Say what was written, how fast, where, and what was not."""
    written = " + ".join(results.formats)
    log.say(f"{what}: {written} in {results.folder} ({rate:.1f} images/s, reading and writing included)")
    if results.skipped:
        log.say(f"skipped {len(results.skipped)}:")
        for line in results.skipped:
            log.say(f"  {line}")
    if results.too_far:
        log.say(f"{results.too_far} pixels are farther than 65.535 m: 0 (unknown) in the depth files")


def _follow(span: tuple[float, float] | None, now: tuple[float, float]) -> tuple[float, float]:
    """The colours' range, moving slowly, so that a video does not flicker."""
    if span is None:
        return now
    near, far = (RANGE_MEMORY * old + (1 - RANGE_MEMORY) * new for old, new in zip(span, now, strict=True))
    return near, far


def _numbers(config: "DictConfig", name: str, count: int) -> list[float] | None:
    given = cfg.plain(config[name])
    if given is None:
        return None
    try:
        numbers = [float(value) for value in given]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        meaning = {"intrinsics": "[fx, fy, cx, cy] in pixels", "depth_range": "[near, far] in metres"}[name]
        raise ValueError(f"{name}={given}: give {meaning}, {count} numbers")
    return numbers


if __name__ == "__main__":
    main()

"""``python -m eldenet.predict``: depth of a picture, a folder of pictures, or a video."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldenet import config as cfg

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.predictions import Results
    from eldenet.predictor import DepthPredictor
    from eldenet.runlog import RunLog

VIDEO_ENDINGS = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")
RANGE_MEMORY = 0.9  # of a video's colours: the share of the range that the frame before decides


@cfg.entry_point("predict")
def main(config: "DictConfig", folder: Path) -> None:
    """Predict and write; ``folder`` is not used, results go to ``output``."""
    predict(config)


def predict(config: "DictConfig") -> "Results":
    """Check everything that can be checked, load the network, predict, write, say what was done."""
    import eldenet
    from eldenet.predict_boxes import box_results
    from eldenet.predictions import name_results
    from eldenet.predictor import DepthPredictor
    from eldenet.resources import choose_resources
    from eldenet.runlog import RunLog

    source = Path(config.source).expanduser()
    is_video = source.is_file() and source.suffix.lower() in VIDEO_ENDINGS
    results = read_settings(config, is_video=is_video)
    names = {source: source.stem} if is_video else name_results(source, results.folder)
    files = [file for name in names.values() for file in results.files(name, is_video=is_video)]
    results.refuse_to_overwrite(list(names), files)
    resources = choose_resources(**cfg.plain(config.runtime))
    model = eldenet.load(config.checkpoint, trusted_modules=cfg.plain(config.trusted_modules))
    predictor = DepthPredictor(
        model, cfg.plain(config.input_size), max_side=config.max_side, device=resources.device
    )
    log = RunLog(results.folder)
    if str(config.checkpoint) in eldenet.list_models():
        log.say(f"note: {config.checkpoint} is a freshly initialised network: its depth means nothing")
    elif predictor.input_size is None:
        log.say(
            f"note: {config.checkpoint} does not say at which size it was trained: it sees pictures at their "
            f"own (longer side at most {config.max_side} px): if the depth looks wrong, give input_size=[h,w]"
        )
    video = source if is_video else None
    with box_results(config, results, list(names.values()), video, log) as results.also:
        if is_video:
            predict_video(source, predictor, results, log)
        else:
            predict_pictures(names, predictor, results, log, skip=config.on_error == "skip")
    return results


def read_settings(config: "DictConfig", *, is_video: bool) -> "Results":
    """Check the settings that speak of results."""
    from eldenet.data.roots import one_of
    from eldenet.geometry import pinhole
    from eldenet.predictions import ENDING, Results

    one_of("on_error", str(config.on_error), ("stop", "skip"))
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
    pictures: dict[Path, str], predictor: "DepthPredictor", results: "Results", log: "RunLog", *, skip: bool
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


def predict_video(source: Path, predictor: "DepthPredictor", results: "Results", log: "RunLog") -> None:
    """Predict every frame of a video; colour becomes one .mp4, the others one file a frame."""
    import cv2

    from eldenet.legend import photo_beside_depth, visible_range
    from eldenet.predictions import open_video

    file = results.folder / f"{source.stem}_depth.mp4"
    capture = cv2.VideoCapture(str(source))
    announced = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    per_second = float(capture.get(cv2.CAP_PROP_FPS))
    per_second = per_second if 0 < per_second <= 1000 else 30.0
    per_frame = [name for name in results.formats if name != "colour"]
    span = results.depth_range
    try:
        with log.bar("predicting", announced) as bar, open_video(file, per_second) as add:
            while True:
                complete, frame = capture.read()
                if not complete:
                    break
                photo = cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
                depth = predictor(photo)
                results.write(f"{source.stem}/{results.images:06d}", photo, depth, per_frame)
                if "colour" in results.formats:
                    span = results.depth_range or _follow(span, visible_range(depth))
                    add(photo_beside_depth(photo, depth, *span))
                results.images += 1
                bar.advance(1)
            if not results.images:
                raise ValueError(f"{source} holds no frame that can be read: it is cut, damaged or no video")
            rate = bar.rate
    finally:
        capture.release()
    say_what_was_done(
        log, results, f"{results.images} frame{'s' * (results.images != 1)} of {source.name}", rate
    )
    if results.images < announced:
        log.say(f"{source} announces {announced} frames, {results.images} could be read: it may be cut")


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

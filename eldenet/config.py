"""What commands whose settings are not a dataclass yet are built from."""

import functools
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from eldenet.compose import listed, plain
from eldenet.configurable import check_arguments
from eldenet.configurable import instantiate as build_part
from eldenet.system.checks import one_of
from eldenet.system.extras import require
from eldenet.system.resources import choose_resources
from eldenet.weights import BEST, find_checkpoint

if TYPE_CHECKING:
    import numpy as np

    from eldenet.deploy.prediction import PredictionSetup
    from eldenet.results.studies.plan import Composition
    from eldenet.results.studies.runner import StudySetup, Training


def instantiate(config: Any, **arguments: Any) -> Any:
    """Build what a node describes."""
    return build_part(
        plain(config), config._get_full_key(None) if OmegaConf.is_config(config) else "", **arguments
    )


def build_protocol(config: DictConfig) -> Any:
    """Build the protocol named on the command line, else the data set's own."""
    chosen = config.get("protocol")
    return instantiate(chosen if chosen is not None else config.data.protocol)


def build_split(
    config: DictConfig, split: str, protocol: Any, *, augment: bool = False, **options: Any
) -> Any:
    """Open one split, as :func:`eldenet.evaluation.splits.open_split` does."""
    from eldenet.evaluation.splits import open_split

    augmentation = plain(config.augmentation) if augment else None
    return open_split(plain(config.data), split, protocol, augmentation=augmentation, **options)


def check_sources(config: DictConfig, *names: str) -> None:
    """Check the networks that these settings name."""
    for name in names:
        if config[name] is not None:
            find_checkpoint(str(config[name]), name)


# --- settings that several commands read --------------------------------------------------------------------


def _settings_in(folder: Path, config: DictConfig) -> Any:
    """Return the resolved settings of a run in ``folder``, as ``run.json`` stores them."""
    return plain(OmegaConf.merge(config, {"output": str(folder)}))


def _filled(setup: Any, config: DictConfig, **given: Any) -> Any:
    """Fill a dataclass from the settings that its fields name; those in ``given`` are checked already."""
    names = [field.name for field in fields(setup) if field.name not in given]
    return setup(**{name: plain(config[name]) for name in names}, **given)


def _check_types(config: DictConfig, target: Any, *names: str) -> None:
    """Raise ValueError for the first of these settings that is of another type than the class's field."""
    check_arguments(target, {name: plain(config[name]) for name in names})


def _numbers(config: DictConfig, name: str, meaning: str) -> tuple[float, ...] | None:
    """Return a setting such as ``[near, far] in meters`` as numbers, or None for null.

    Raises:
        ValueError: it is not a list of as many finite numbers.
    """
    given = plain(config[name])
    if given is None:
        return None
    count = meaning.count(",") + 1
    try:
        numbers = tuple(float(value) for value in given)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{name}={given}: give {meaning}, {count} numbers, or null")
    return numbers


def _camera(config: DictConfig) -> "np.ndarray | None":
    """Return the setting ``intrinsics`` as ``(3, 3)`` [px], or None for null.

    Raises:
        ValueError: it does not describe a camera.
    """
    from eldenet.geometry import intrinsic_matrix

    return None if config.intrinsics is None else intrinsic_matrix(plain(config.intrinsics))


def _size(config: DictConfig, name: str, otherwise: str = "null") -> tuple[int, int] | None:
    """Return a setting ``[height, width]`` [px], or None for null; ``otherwise``: what the error offers too.

    Raises:
        ValueError: it is not such a pair.
    """
    given = plain(config[name])
    if given is None:
        return None
    pair = isinstance(given, list) and [type(side) for side in given] == [int, int]
    if not pair or min(given) < 1:
        raise ValueError(f"{name}={given}: give [height, width] in pixels, or {otherwise}")
    return given[0], given[1]


# --- data sets: splits, and check_data ----------------------------------------------------------------------


# --- train, evaluate, adapt, train_detector -----------------------------------------------------------------


# --- predict, export, demo ----------------------------------------------------------------------------------


def build_prediction(config: DictConfig) -> "PredictionSetup":
    """Return the setup of ``python -m eldenet.predict``; all else is checked before torch is loaded.

    Raises:
        ValueError: a setting or the source is wrong.
        FileNotFoundError: there is no such source.
    """
    from eldenet.data.kitti_calibration import object_camera
    from eldenet.deploy import runtimes
    from eldenet.deploy.lens import needs_lens
    from eldenet.deploy.outputs import ENDING, Results
    from eldenet.deploy.prediction import PredictionSetup, find_source
    from eldenet.geometry import focal_of_fov
    from eldenet.results.fingerprints import fingerprint

    if config.checkpoint is None:
        config.checkpoint = BEST
    check_sources(config, "checkpoint")
    checkpoint, engine = str(config.checkpoint), str(config.engine)
    one_of("engine", engine, ("auto", *runtimes.RUNTIMES))
    runtimes.check_installed(checkpoint, engine)
    one_of("on_error", str(config.on_error), ("stop", "skip"))
    _check_types(config, PredictionSetup, "frames", "focal", "fov", "max_side", "steady", "sharp")
    _check_types(config, Results, "overwrite")
    if type(config.boxes) is not bool:
        raise ValueError(f"boxes={config.boxes}: give true or false")
    wait = config.camera_timeout
    if wait is not None and not (isinstance(wait, int | float) and 0 < wait <= threading.TIMEOUT_MAX):
        raise ValueError(f"camera_timeout={wait}: give seconds above 0, or null to wait forever")
    camera = _camera(config)
    given = [name for name in ("intrinsics", "focal", "fov") if config[name] is not None]
    if len(given) > 1:
        raise ValueError(f"{' and '.join(given)} are given: give only one of them")
    if config.focal is not None and not config.focal > 0:
        raise ValueError(f"focal={config.focal}: give fx of the source's pictures in pixels, above 0")
    if config.fov is not None:
        focal_of_fov(config.fov, 1)
    span = _numbers(config, "depth_range", "[near, far] in meters")
    if span and not 0 <= span[0] < span[1]:
        raise ValueError(f"depth_range={list(span)}: give [near, far] in meters, 0 <= near < far")
    size = _size(config, "input_size")
    output = Path(config.output).expanduser()
    source = find_source(str(config.source), output, config.frames)
    with_points = camera is not None and not config.boxes
    formats = ["color"] if source.is_video else ["depth", "color", *["ply"] * with_points]
    if config.formats is not None:
        formats = [str(name) for name in listed(config.formats)]
    for name in formats:
        if name == "colour":
            raise ValueError("formats: 'colour' is now called 'color'")
        one_of("formats", name, tuple(ENDING))
    if not formats:
        raise ValueError(f"formats is empty: give at least one of {', '.join(ENDING)}")
    if not given and (config.boxes or "ply" in formats):
        needs_lens("boxes" if config.boxes else "point clouds", list(source.names), is_video=source.is_video)
    results = Results(
        output,
        tuple(formats),
        (span[0], span[1]) if span else None,
        config.overwrite,
        one_size=camera is not None,
    )
    recording = None
    if config.viewer is not None:
        one_of("viewer", str(config.viewer), ("rerun",))
        require("viewer=rerun", "rerun")
        recording = output / "predict.rrd"
        results.refuse_to_overwrite([], [recording])
    if not (config.boxes or recording or source.is_live):
        deciding = ("checkpoint", "source", "engine", "input_size", "max_side", "depth_range", "sharp")
        results.settings = {name: str(config[name]) for name in (*deciding, "intrinsics", "focal", "fov")}
        results.settings |= {"formats": formats, "weights": fingerprint(checkpoint)}
    files = [file for name in source.names.values() for file in results.files(name, is_video=source.is_video)]
    results.refuse_to_overwrite(list(map(Path, source.names)), files)
    boxes = None
    if config.boxes:
        of_kitti = not given and not source.is_video and all(map(object_camera, map(Path, source.names)))
        boxes = _build_boxes(config, of_kitti=of_kitti, is_video=source.is_video)
    exported = find_checkpoint(checkpoint, "checkpoint").kind == "exported"
    by_torch = not exported and engine in ("auto", *runtimes.TORCH)
    return _filled(
        PredictionSetup,
        config,
        source=source,
        results=results,
        resources=choose_resources(**plain(config.runtime), for_torch=by_torch),
        input_size=size,
        intrinsics=camera,
        boxes=boxes,
        recording=recording,
        skip_unreadable=config.on_error == "skip",
    )


def _build_boxes(config: DictConfig, *, of_kitti: bool, is_video: bool) -> Callable[..., Any]:
    """Return what adds 3D boxes to the results of ``predict``: detector, lifter and, for a video, tracker.

    ``of_kitti``: all pictures have KITTI's calibration, so their camera's height is known.

    Raises:
        ValueError: no detector was given, or not as a file's path.
    """
    from eldenet.data.kitti_calibration import CAMERA_HEIGHT
    from eldenet.perception.box_results import box_results
    from eldenet.perception.scene import Perception

    if isinstance(config.perception.detector, str):
        raise ValueError(
            f"perception.detector={config.perception.detector}: give the file as perception.detector.path"
        )
    if config.perception.detector.get("path", "") is None:
        raise ValueError(
            "boxes need a detector: give perception.detector.path=<file>.onnx, see docs/boxes.md"
        )
    detector = instantiate(config.perception.detector)
    lifter = instantiate(config.perception.lifter)
    tracker = instantiate(config.perception.tracker) if is_video else None
    if of_kitti and lifter.camera_height is None:
        lifter.camera_height = CAMERA_HEIGHT
    perception = Perception(None, detector, lifter, None, tracker=tracker)
    by_depth = config.perception.lifter.get("method") != "no_depth"
    return functools.partial(box_results, perception, is_video=is_video, check_sizes=by_depth)


# --- study and report ---------------------------------------------------------------------------------------


def training_composition() -> "Composition":
    """Return the functions that turn a study's overrides of ``eldenet.train`` into settings and networks."""
    from eldenet.compose import compose as settings_of
    from eldenet.results.studies.plan import Composition
    from eldenet.train import TrainSettings

    def settings(overrides: Sequence[str]) -> dict[str, Any]:
        return asdict(settings_of(TrainSettings, overrides))

    return Composition(settings, lambda model: build_part(model, "model"))


def study_training() -> "Training":
    """Return how a study's runs are trained: as ``eldenet.train`` trains."""
    from eldenet.compose import compose as settings_of
    from eldenet.results.studies.runner import Training
    from eldenet.train import TrainSettings, train
    from eldenet.training.resume import check_finished

    def settings(overrides: Sequence[str], folder: Path) -> TrainSettings:
        return settings_of(TrainSettings, [*overrides, f"output='{folder}'"])

    return Training(
        lambda overrides, folder: train(settings(overrides, folder)),
        lambda overrides, where, record: check_finished(where, record, asdict(settings(overrides, where))),
        training_composition(),
    )


def build_study(config: DictConfig) -> "StudySetup":
    """Return the setup of ``python -m eldenet.study``: which runs are trained, and where."""
    from eldenet.results.studies.runner import StudySetup

    return StudySetup(
        study=config.study,
        runs=Path(config.runs),
        rows=plain(config.rows),
        job=config.row,
        seeds=None if config.seeds is None else listed(config.seeds),
        rerun=config.rerun,
        given=plain(config.given),
    )

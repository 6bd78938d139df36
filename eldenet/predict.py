"""``python -m eldenet.predict``: depth of a picture, a folder of pictures, a video, a bag of ROS, or a camera.

python -m eldenet.predict source=photo.jpg
python -m eldenet.predict checkpoint=runs/my-run source=photo.jpg
python -m eldenet.predict checkpoint=runs/my-run source=photos/ on_error=skip
python -m eldenet.predict checkpoint=runs/my-run source=video.mp4
python -m eldenet.predict checkpoint=exports/my-run.onnx source=camera:0 frames=500
python -m eldenet.predict checkpoint=runs/my-run source=photo.jpg boxes=true 'intrinsics=[721.5,721.5,609.6,172.9]' perception.detector.path=yolox.onnx
Put a name that has spaces or special characters in quotes: 'source=my photo (1).jpg'
"""  # noqa: E501

import math
import threading
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import eldenet
from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.compose import REQUIRED, listed
from eldenet.configurable import instantiate
from eldenet.data.bags import is_bag
from eldenet.deploy.predictor import MAX_SIDE
from eldenet.geometry import focal_length, intrinsic_matrix
from eldenet.system.checks import at_least, check_size, one_of
from eldenet.system.extras import require
from eldenet.system.resources import choose_resources
from eldenet.uncertainty import NO_SIGMA
from eldenet.weights import BEST, find_checkpoint

if TYPE_CHECKING:
    from eldenet.deploy.outputs import Results
    from eldenet.deploy.prediction import Source
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.deploy.runtimes import Runtime
    from eldenet.model import DepthNet
    from eldenet.perception.scene import Perception
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import Resources

RECORDING = "predict.rrd"  # for the Rerun viewer


@dataclass(frozen=True)
class PredictSettings:
    """What ``python -m eldenet.predict`` reads."""

    runtime: dict[str, Any] = REQUIRED
    # a run folder, a model folder, a Hub id, or an exported file (.onnx, .xml); null: the package's best
    # weights for indoor pictures
    checkpoint: str | None = None
    # a picture, a folder of pictures (with subfolders, without hidden ones), a video, a bag of ROS, a camera
    # (camera:0, /dev/video0, /dev/v4l/by-id/...) or an address (rtsp://...); cameras and addresses drop
    # frames that come in too fast
    source: str = REQUIRED
    topic: str | None = None  # of a bag's pictures; null: the only one with colors
    # torch, torch_channels_last, torch_compile, onnxruntime, openvino; auto: torch for a model, the fastest
    # installed runtime for a file
    engine: str = "auto"
    # number of pictures in a folder, or of frames from a video or camera; null: all, or until Ctrl-C
    frames: int | None = None
    # seconds without a new frame after which a camera or an address counts as lost; null: never
    camera_timeout: float | None = 10.0
    output: str = "runs/predict-${now:%Y%m%d-%H%M%S}"  # folder for the results; subfolders as in source
    # any of [depth, color, ply, sigma]; null: depth and color, plus ply if intrinsics are given; for a video
    # only color. depth: 16-bit PNG [mm], 0 = unknown; color: photo, depth and scale [m] (a video: mp4); ply:
    # point cloud; sigma: standard deviation of the depth as 16-bit PNG [mm] and as a picture [% of the
    # depth], and color is pale where the network is unsure
    formats: Any = None
    # [fx, fy, cx, cy] of the source's pictures [px]: for meters, point clouds and boxes; null: for KITTI's
    # image_2/000001.png, those of calib/000001.txt, and for a bag those of its CameraInfo
    intrinsics: Any = None
    focal: float | None = None  # alternative: fx of the source's pictures [px]
    # or their horizontal field of view [degrees]; with focal or fov, the principal point is the picture's
    # center; all null: each photo's EXIF, else the network's canonical camera
    fov: float | None = None
    # (height, width) that the network sees [px]; null: the size of its training (after training on crops: of
    # a whole frame at that scale), else the picture's own, limited by max_side
    input_size: Any = None
    max_side: int = MAX_SIDE  # longest side of pictures for a network without a training size [px]
    # [near, far] of the colors [m]; null: each picture's own (in a video it changes slowly)
    depth_range: Any = None
    steady: bool = True  # false: predict every frame of a video on its own, so that its depth may flicker
    # move the edges of the depth to the picture's, about 0.1 s a picture; not for videos or boxes
    sharp: bool = True
    # rerun: also record picture, depth, points (with the lens) and boxes over time, predict.rrd, for the
    # Rerun viewer: pip install -e '.[viewer]'
    viewer: str | None = None
    # true: also write 3D boxes, <name>_boxes.png and .txt (KITTI's format); needs the lens and
    # perception.detector.path, see docs/boxes.md
    boxes: bool = False
    perception: dict[str, Any] = REQUIRED  # of boxes=true
    # what to do with a picture that cannot be read: stop, or skip it and list it at the end
    on_error: str = "stop"
    overwrite: bool = False  # true: replace existing files of the same name
    trusted_modules: Any = field(default_factory=list)  # packages whose classes foreign weights may name

    def __post_init__(self) -> None:
        one_of("on_error", self.on_error, ("stop", "skip"))
        if self.viewer is not None:
            one_of("viewer", self.viewer, ("rerun",))
        at_least(1, frames=self.frames, max_side=self.max_side)
        wait = self.camera_timeout
        if wait is not None and not 0 < wait <= threading.TIMEOUT_MAX:
            raise ValueError(f"camera_timeout={wait}: give seconds above 0, or null to wait forever")
        focal_length(self.intrinsics, self.fov, None, self.focal)
        check_size("input_size", self.input_size)
        span = self.depth_range
        pair = isinstance(span, list) and len(span) == 2 and all(type(end) in (int, float) for end in span)
        if span is not None and not (pair and 0 <= span[0] < span[1] < math.inf):
            raise ValueError(f"depth_range={span}: give [near, far] in meters, 0 <= near < far, or null")

    @property
    def lenses(self) -> list[str]:
        """Names of the settings that say which lens the source has: one, or none."""
        return [name for name in ("intrinsics", "focal", "fov") if getattr(self, name) is not None]


def predict(s: PredictSettings) -> "Results":
    """Load the network, predict, write the results, and say what was done.

    All that can be checked without torch is checked before it is loaded.

    Raises:
        ValueError: a setting is wrong, a picture cannot be read, or the network cannot run here.
        FileNotFoundError: there is no such source.
        KeyboardInterrupt: Ctrl-C, after the current picture; not with a camera, which ends so.
        SystemExit: another signal, likewise.
        OSError: the source ended early; earlier results are written.
    """
    from eldenet.deploy import runtimes
    from eldenet.deploy.lens import Lens
    from eldenet.deploy.prediction import TimedPredictor, find_source, predict_pictures, predict_video
    from eldenet.deploy.stream import refuse_missing_camera
    from eldenet.deploy.viewer import RerunViewer, open_recording
    from eldenet.results.run_log import RunLog
    from eldenet.system.signals import GracefulStop

    s = replace(s, checkpoint=s.checkpoint or BEST)
    find_checkpoint(str(s.checkpoint), "checkpoint")
    one_of("engine", s.engine, ("auto", *runtimes.RUNTIMES))
    runtimes.check_installed(str(s.checkpoint), s.engine)
    source = find_source(s.source, Path(s.output).expanduser(), s.frames, s.topic, s.intrinsics)
    if source.is_live:
        refuse_missing_camera(s.source)
    origin = "given"
    if source.bag is not None and (source.bag.knows_lens or not s.lenses):
        if s.focal or s.fov:
            raise ValueError(f"{s.lenses[0]}: the CameraInfo of a bag says the lens; intrinsics= replaces it")
        if s.intrinsics is None:
            origin = "from CameraInfo"
        s = replace(s, intrinsics=source.bag.intrinsics)
    results = open_results(s, source)
    recording = results.folder / RECORDING if s.viewer is not None else None
    perception = open_perception(s, source) if s.boxes else None

    log = RunLog(results.folder)
    network = open_predictor(s, log, formats=results.formats, is_video=source.is_video)
    camera = None if s.intrinsics is None else intrinsic_matrix(s.intrinsics)
    lens = Lens(
        network.canonical_px,
        known_fov=network.known_fov,
        intrinsics=camera,
        focal=s.focal,
        fov=s.fov,
        origin=origin,
    )
    predictor = TimedPredictor(network, lens)
    boxes: AbstractContextManager[Any] = nullcontext()
    viewer: AbstractContextManager[RerunViewer | None] = nullcontext()
    if perception is not None:
        from eldenet.perception.box_results import box_results

        boxes = box_results(
            perception,
            results,
            list(source.names.values()),
            log,
            predictor.seconds,
            predictor.max_depth,
            is_video=source.is_video,
            check_sizes=s.perception["lifter"].get("method") != "no_depth",
        )
    if recording is not None:
        viewer = open_recording(recording, points=bool(s.lenses) or s.boxes)
    broken = ""
    with GracefulStop() as stop, viewer as results.viewer, boxes as results.also:
        if source.is_video:
            ((path, name),) = source.names.items()
            broken = predict_video(
                source.bag or path,
                name,
                predictor,
                results,
                log,
                stop,
                frames=s.frames,
                timeout=s.camera_timeout,
            )
        else:
            skip = s.on_error == "skip"
            predict_pictures(source.names, predictor, results, log, stop, skip_unreadable=skip)
    points = s.boxes or recording is not None or "ply" in results.formats
    if results.images and (line := lens.describe(points=points)):
        log.say(line)
    if results.images and s.boxes and not source.is_video:
        say_precision(source, results.folder, log)
    if results.images and recording is not None:
        log.say(f"recording: rerun {recording}")
    if not stop or source.is_live:
        results.end()
    if broken:
        raise OSError(f"{broken}; earlier results are in {results.folder}")
    if not source.is_live:
        stop.obey()
    return results


def say_precision(source: "Source", folder: Path, log: "RunLog") -> None:
    """Print KITTI's AP of the boxes in ``folder``, if the pictures come with labels."""
    from eldenet.perception.kitti_ap import DIFFICULTIES, precision_rows

    written = {Path(path): folder / f"{name}_boxes.txt" for path, name in source.names.items()}
    rows = precision_rows({path: file for path, file in written.items() if file.is_file()})
    if rows:
        log.table("KITTI's AP (R40) by the labels in label_2 [%]", ["IoU", *DIFFICULTIES], rows)
        if any(" of " in cell for row in rows for cell in row):
            log.say("of: the most that KITTI's AP can be with fewer than 41 objects")


def open_results(s: PredictSettings, source: "Source") -> "Results":
    """Return what writes the results, in the formats that the settings ask for.

    Raises:
        ValueError: there is no such format, a format needs the lens, or a result already exists.
    """
    from eldenet.deploy.lens import require_lens
    from eldenet.deploy.outputs import ENDING, Results
    from eldenet.results.fingerprints import fingerprint

    with_points = s.intrinsics is not None and not s.boxes
    formats = ["color"] if source.is_video else ["depth", "color", *["ply"] * with_points]
    if s.formats is not None:
        formats = [str(name) for name in listed(s.formats)]
    for name in formats:
        one_of("formats", name, tuple(ENDING))
    if not formats:
        raise ValueError(f"formats is empty: give at least one of {', '.join(ENDING)}")
    if not s.lenses and (s.boxes or "ply" in formats):
        require_lens("boxes" if s.boxes else "point clouds", list(source.names), is_video=source.is_video)
    results = Results(
        Path(s.output).expanduser(),
        tuple(formats),
        (float(s.depth_range[0]), float(s.depth_range[1])) if s.depth_range else None,
        s.overwrite,
        one_size=s.intrinsics is not None,
    )
    if s.viewer is not None:
        require("viewer=rerun", "rerun")
        results.refuse_to_overwrite([], [results.folder / RECORDING])
    if not (s.boxes or s.viewer or source.is_live):
        of_network = ("checkpoint", "engine", "input_size", "max_side", "steady", "sharp")
        deciding = (*of_network, "source", "topic", "intrinsics", "focal", "fov", "depth_range")
        results.settings = {name: str(getattr(s, name)) for name in deciding}
        results.settings |= {"formats": formats, "weights": fingerprint(str(s.checkpoint))}
    files = [file for name in source.names.values() for file in results.files(name, is_video=source.is_video)]
    results.refuse_to_overwrite(list(map(Path, source.names)), files)
    return results


def open_perception(s: PredictSettings, source: "Source") -> "Perception":
    """Return what finds 3D boxes: detector, lifter and, for a video, tracker.

    Raises:
        ValueError: no detector was given, or not as a file's path, or a tracker's setting for pictures.
    """
    from eldenet.data.kitti_calibration import CAMERA_HEIGHT, object_camera
    from eldenet.perception.scene import Perception

    detector = s.perception["detector"]
    if isinstance(detector, str):
        raise ValueError(f"perception.detector={detector}: give the file as perception.detector.path")
    if detector.get("path", "") is None:
        raise ValueError(
            "boxes need a detector: give perception.detector.path=<file>.onnx, see docs/boxes.md"
        )
    if not source.is_video:
        refuse_unread(("perception.tracker",), "objects are tracked in videos, and source= is none")
    parts = ("detector", "lifter", *["tracker"] * source.is_video)
    built = {name: instantiate(s.perception[name], f"perception.{name}") for name in parts}
    of_kitti = not s.lenses and not source.is_video and all(map(object_camera, map(Path, source.names)))
    if of_kitti and built["lifter"].camera_height is None:
        built["lifter"].camera_height = CAMERA_HEIGHT
    return Perception(None, built["detector"], built["lifter"], None, tracker=built.get("tracker"))


def open_runtime(
    model: "DepthNet", engine: str, size: tuple[int, int] | None, resources: "Resources"
) -> "Runtime":
    """Return a model under a runtime, for pictures of any size as under torch, or else of ``size`` [px].

    Raises:
        ValueError: the network has no graph for any size, and no ``size`` is given.
    """
    from eldenet.deploy import runtimes

    # where the model states no size, the graph is made at this one
    model.info = {"input_size": size} | model.info
    load = partial(runtimes.load, model, engine, threads=resources.threads, device=resources.device)
    try:
        return load()
    except ValueError:
        if size is None:
            raise
        return load(size=size)


def open_predictor(
    s: PredictSettings, log: "RunLog", *, formats: tuple[str, ...] = (), is_video: bool = False
) -> "DepthPredictor":
    """Load the network: an exported file under its runtime, a model under torch unless ``engine`` says else.

    Raises:
        ValueError: the runtime cannot run it here; ``formats`` has sigma, which the network does not predict.
    """
    from eldenet.deploy import runtimes
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.results.run_log import untrained_note

    checkpoint, size = str(s.checkpoint), check_size("input_size", s.input_size)
    kind = find_checkpoint(checkpoint, "checkpoint").kind
    by_torch = kind != "exported" and s.engine in ("auto", *runtimes.TORCH)
    resources = choose_resources(**s.runtime, for_torch=by_torch)
    network: DepthNet | Runtime
    device = None  # a runtime has its own
    if kind == "exported":
        network = runtimes.load(checkpoint, s.engine, threads=resources.threads, device=resources.device)
        log.say(f"{checkpoint}: {network.runtime}, {network.precision}, {network.threads} threads")
        license = network.metadata.get("license")
    else:
        network = model = eldenet.load(checkpoint, trusted_modules=listed(s.trusted_modules))
        default = " (the default; checkpoint=... takes others)" if checkpoint == BEST else ""
        log.say(f"weights: {checkpoint}{default}")
        license = model.info.get("license")
        if s.engine in ("auto", "torch"):
            device = resources.device
        else:
            network = open_runtime(model, s.engine, size, resources)
    if license:
        log.say(f"license of the weights: {license}")
    if "sigma" in formats and network.distribution is None:
        raise ValueError(f"formats has sigma: {NO_SIGMA}")
    predictor = DepthPredictor(
        network,
        size,
        max_side=s.max_side,
        device=device,
        steady=s.steady and is_video,
        sharp=s.sharp and not is_video and not s.boxes,
        uncertainty=network.distribution is not None,
    )
    if kind == "network":
        log.say(untrained_note(checkpoint))
    elif predictor.input_size is None:
        log.say(
            f"note: {checkpoint} does not say at which size it was trained, so it sees pictures at their own "
            f"(longer side at most {s.max_side} px): if the depth looks wrong, give input_size=[h,w]"
        )
    return predictor


@entry_point(PredictSettings)
def main(s: PredictSettings) -> None:
    """Refuse settings that nothing reads, then predict."""
    if not is_bag(Path(s.source).expanduser()):
        refuse_unread(("topic",), "source= is no bag of ROS or does not exist; only bags have topics")
    if not s.boxes:
        refuse_unread(("perception",), "only boxes=true makes 3D boxes")
    predict(s)


if __name__ == "__main__":
    main()

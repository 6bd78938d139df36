"""Export a trained network for other runtimes, and check the file against torch."""

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import eldenet
from eldenet.data.io import IMAGE_ENDINGS, read_image
from eldenet.data.splits import evenly_spaced
from eldenet.deploy import runtimes
from eldenet.deploy.metadata import describe
from eldenet.deploy.predictor import DepthPredictor, as_image
from eldenet.geometry import resize_image, size_of_aspect
from eldenet.system.files import safe_stem
from eldenet.system.onnx_files import read_graph
from eldenet.uncertainty import DepthEstimate
from eldenet.weights import find_checkpoint, name_of

if TYPE_CHECKING:
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog

ENDINGS = {"onnx": ".onnx", "openvino": ".xml"}
PRECISIONS = {"onnx": ("fp32", "int8"), "openvino": ("fp32", "bf16", "int8")}
UNTRAINED_SIZE = (224, 224)
FP32_TOLERANCE = 1e-3  # an fp32 file with a larger median relative difference is wrong, not rounded
INT8_TOLERANCE = 0.02  # an int8 file with a larger median relative difference is worth a warning
CAMERA_TOLERANCE = 5e-3  # with camera=: OpenCV rounds resized pictures to gray levels, the graph does not


@dataclass(frozen=True)
class ExportSetup:
    """The settings of ``configs/export.yaml``, checked; it explains each."""

    checkpoint: str
    format: str
    precision: str
    size: tuple[int, int] | None
    camera: tuple[int, int] | None
    batch: int | None
    opset: int
    output: Path | None
    overwrite: bool
    pictures: str | None
    calibration: int
    checks: int
    license: str | None
    trusted_modules: Sequence[str]


@dataclass(frozen=True)
class Target:
    """What to write: the settings, completed by the model where they leave something open."""

    setup: ExportSetup
    name: str
    size: tuple[int, int]
    output: Path


def export(setup: ExportSetup) -> Path:
    """Write the file, compare it with torch, and print what it contains.

    Raises:
        ValueError: the file already exists, the pictures are missing, or an fp32 file differs from torch.
    """
    from eldenet.deploy.onnx_export import quantize_onnx, write_onnx
    from eldenet.deploy.openvino_export import quantize_openvino, write_openvino
    from eldenet.results.run_log import RunLog, untrained_note

    model = eldenet.load(setup.checkpoint, trusted_modules=setup.trusted_modules)
    target = target_of(setup, model)
    size, output, log = target.size, target.output, RunLog(target.output.parent)
    if find_checkpoint(setup.checkpoint).kind == "network":
        log.say(untrained_note(setup.checkpoint))
    if setup.pictures is None:
        log.say("pictures for the check: rendered rooms (yours: pictures=folder)")
    pictures = read_pictures(setup.pictures, setup.checks, "test")
    metadata = describe(model, target.name, size, camera_size=setup.camera, license=setup.license)
    metadata["precision"] = setup.precision
    with tempfile.TemporaryDirectory() as temporary:
        is_graph = setup.format == "onnx" and setup.precision == "fp32"  # all other files are made from it
        graph = write_onnx(
            model,
            output if is_graph else Path(temporary) / "fp32.onnx",
            size,
            batch=setup.batch,
            opset=setup.opset,
            camera_size=setup.camera,
            metadata=metadata,
        )
        if setup.precision == "int8":
            frames = read_pictures(setup.pictures, setup.calibration, "train")
            inputs = batches(frames, target)
            log.say(f"int8: scales from {len(frames)} pictures")
            if setup.format == "onnx":
                quantize_onnx(graph, output, inputs)
            else:
                quantize_openvino(graph, output, inputs, metadata)
        elif setup.format == "openvino":
            write_openvino(graph, output, metadata)
    compare_with_torch(target, model, pictures, log)
    say_contents(output, log)
    return output


def target_of(setup: ExportSetup, model: "DepthNet") -> Target:
    """Name, size and output file of an export.

    Raises:
        ValueError: the output already exists.
    """
    from eldenet.model import size_of_frames

    height, width = setup.size or size_of_frames(model.info) or UNTRAINED_SIZE
    size = (int(height), int(width))
    if setup.camera is not None and setup.size is None:
        stretch = model.info.get("stretch") or 1.0
        size = size_of_aspect(size, (setup.camera[0], setup.camera[1] * stretch))
    name = name_of(setup.checkpoint, model.info)
    default = f"exports/{safe_stem(name)}-{size[0]}x{size[1]}-{setup.precision}{ENDINGS[setup.format]}"
    output = setup.output or Path(default)
    if output.exists() and not setup.overwrite:
        raise ValueError(f"{output} already exists: give another output=, or overwrite=true")
    return Target(setup, name, size, output)


def read_pictures(source: str | None, count: int, split: str) -> list[np.ndarray]:
    """Up to ``count`` pictures ``(H, W, 3)`` uint8 RGB, evenly spread over a folder or a pattern.

    Without a source they are frames of the built-in rooms.

    Raises:
        ValueError: the source holds no pictures.
    """
    if source is None:
        from eldenet.data.rooms import Rooms

        rooms = Rooms(split, frames=count)
        return [rooms.load_frame(index).image for index in range(len(rooms))]
    folder = Path(source).expanduser()
    paths = sorted(folder.iterdir() if folder.is_dir() else folder.parent.glob(folder.name))
    paths = [path for path in paths if path.suffix.lower() in IMAGE_ENDINGS]
    if not paths:
        raise ValueError(
            f"pictures={source} holds no pictures: give a folder, or a pattern such as 'photos/*.jpg'"
        )
    return [read_image(paths[index], upright=True) for index in evenly_spaced(len(paths), count)]


def batches(frames: Sequence[np.ndarray], target: Target) -> list[np.ndarray]:
    """Pictures as the file takes them: one array each, repeated to a fixed batch."""
    camera = target.setup.camera
    resized = [resize_image(frame, camera or target.size) for frame in frames]
    inputs = [frame[None] if camera else as_image(frame) for frame in resized]
    return [np.repeat(each, target.setup.batch or 1, axis=0) for each in inputs]


def compare_with_torch(
    target: Target, model: "DepthNet", pictures: Sequence[np.ndarray], log: "RunLog"
) -> None:
    """Print the differences between torch and the file under each installed runtime, of depth and sigma.

    Raises:
        ValueError: an output of an fp32 file differs from torch's.
    """
    setup, output = target.setup, target.output
    seen = [resize_image(picture, setup.camera or target.size) for picture in pictures]
    outputs = ("depth",) if model.distribution is None else ("depth", "sigma")
    predictor = DepthPredictor(model, target.size, steady=False, uncertainty="sigma" in outputs)
    if setup.camera is None:
        predictor.stretch = 1.0  # these pictures have the file's size already
    reference = [predictor(frame) for frame in seen]
    if not predictor.uncertainty:
        reference = [DepthEstimate(depth) for depth in reference]
    rows, inputs = [], batches(seen, target)
    tolerance = CAMERA_TOLERANCE if setup.camera else FP32_TOLERANCE
    for name in filter(runtimes.installed, runtimes.READS[output.suffix]):
        try:
            network = runtimes.load(output, name, threads=1)
        except ValueError as error:
            log.say(f"not compared under {name}: {error}")
            continue
        estimates = [network.predict(image) for image in inputs]
        for kind in outputs:
            ours = np.stack([getattr(estimate, kind)[0, 0] for estimate in estimates])
            theirs = np.stack([getattr(estimate, kind) for estimate in reference])
            found = map_errors(ours, theirs)
            rows.append([name, kind, *(f"{value:.2g}" for value in found.values())])
            if setup.precision == "fp32" and not found["median_relative"] < tolerance:
                raise ValueError(
                    f"{kind} of {output} under {name} differs from torch: {found}; do not use it"
                )
            if setup.precision == "int8" and found["median_relative"] > INT8_TOLERANCE:
                log.say(
                    f"warning: int8 {kind} under {name} is {found['median_relative']:.1%} off torch in the "
                    f"median pixel and {found['max_relative']:.0%} in the worst; compare its accuracy, give "
                    "pictures of the place where it will run, or keep fp32"
                )
    title = f"{target.name}, {setup.precision}: the file beside torch on {len(seen)} pictures"
    log.table(title, ["runtime", "output", "max [m]", "median [m]", "max, rel.", "median, rel."], rows)


def say_contents(output: Path, log: "RunLog") -> None:
    """Print the file's operations and its size."""
    kinds = count_operations(output)
    norms = sum(number for kind, number in kinds.items() if "BatchNorm" in kind)
    counted = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common(4))
    files = [output, output.with_suffix(".bin")]
    megabytes = sum(path.stat().st_size for path in files if path.exists()) / 1e6
    log.say(f"{kinds.total()} operations ({counted}, ...), {norms} batch normalizations")
    log.say(f"written to {output} ({megabytes:.2f} MB)")


def count_operations(path: str | Path) -> Counter[str]:
    """Number of each operation in an ONNX or OpenVINO file, without constants."""
    if Path(path).suffix == ".onnx":
        kinds = [node.op_type for node in read_graph(path).graph.node]
    else:
        import xml.etree.ElementTree as ElementTree

        kinds = [layer.attrib["type"] for layer in ElementTree.parse(path).getroot().iter("layer")]
    return Counter(kind for kind in kinds if kind not in ("Constant", "Const", "Parameter", "Result"))


def map_errors(depth: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Largest and median difference of two maps, in meters and relative to the reference."""
    meters = np.abs(depth.astype(np.float64) - reference)
    relative = meters / np.abs(reference)
    return {
        "max_m": float(meters.max()),
        "median_m": float(np.median(meters)),
        "max_relative": float(relative.max()),
        "median_relative": float(np.median(relative)),
    }

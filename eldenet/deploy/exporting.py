"""Export a trained network for other runtimes, and check the file against torch."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldenet.deploy import runtimes
from eldenet.deploy.predictor import DepthPredictor, as_image
from eldenet.deploy.quantize import read_pictures
from eldenet.geometry import resize_image

if TYPE_CHECKING:
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog

ENDINGS = {"onnx": ".onnx", "openvino": ".xml"}
PRECISIONS = {"onnx": ("fp32", "int8"), "openvino": ("fp32", "bf16", "int8")}
UNTRAINED_SIZE = (224, 224)
FP32_TOLERANCE = 1e-3  # an fp32 file with a larger median relative difference is wrong, not rounded


@dataclass(frozen=True)
class ExportSetup:
    """What ``eldenet.export`` is asked for, checked.

    Attributes:
        checkpoint: a run or model folder, a Hub id, or a name.
        format: "onnx" or "openvino".
        precision: "fp32", "int8" or "bf16".
        size: ``(height, width)`` that the network sees [px]; None: the model's.
        camera_size: ``(height, width)`` of the frames that the file takes [px]; None: it takes images.
        batch: fixed number of images; None: any number.
        opset: of ONNX.
        output: the file; None: ``exports/<name>-<size>-<precision>``.
        overwrite: replace the file.
        pictures: folder or pattern; None: the built-in rooms.
        calibration: pictures that give int8 its scales.
        checks: pictures that the file is compared on.
        license: of the weights; None: the model's.
        name: of the model; None: its own.
        trusted_modules: packages whose classes a folder's config may name.
    """

    checkpoint: str
    format: str = "onnx"
    precision: str = "fp32"
    size: tuple[int, int] | None = None
    camera_size: tuple[int, int] | None = None
    batch: int | None = None
    opset: int = 18
    output: Path | None = None
    overwrite: bool = False
    pictures: str | None = None
    calibration: int = 128
    checks: int = 8
    license: str | None = None
    name: str | None = None
    trusted_modules: tuple[str, ...] = ()


def export(setup: ExportSetup) -> Path:
    """Write the file, compare it with torch, and say what it holds.

    Raises:
        ValueError: the file exists already, the pictures are missing, or an fp32 file differs from torch.
    """
    from eldenet.deploy.files import describe, write_onnx, write_openvino
    from eldenet.deploy.quantize import quantize_onnx, quantize_openvino
    from eldenet.results.run_log import RunLog
    from eldenet.zoo import load, note_if_untrained

    model = load(setup.checkpoint, trusted_modules=setup.trusted_modules)
    setup, size, output = completed(setup, model)
    log = RunLog(output.parent)
    if note := note_if_untrained(setup.checkpoint):
        log.say(note)
    pictures = read_pictures(setup.pictures, max(setup.checks, 1), "test")
    metadata = describe(model, str(setup.name), size, camera_size=setup.camera_size, license=setup.license)
    metadata["precision"] = setup.precision
    with tempfile.TemporaryDirectory() as temporary:
        is_graph = setup.format == "onnx" and setup.precision == "fp32"  # all other files are made from it
        graph = write_onnx(
            model,
            output if is_graph else Path(temporary) / "fp32.onnx",
            size,
            batch=setup.batch,
            opset=setup.opset,
            camera_size=setup.camera_size,
            metadata=metadata,
        )
        if setup.precision == "int8":
            frames = read_pictures(setup.pictures, setup.calibration, "train")
            inputs = batches(frames, setup)
            log.say(f"int8: scales from {len(frames)} pictures")
            if setup.format == "onnx":
                quantize_onnx(graph, output, inputs)
            else:
                quantize_openvino(graph, output, inputs, metadata)
        elif setup.format == "openvino":
            write_openvino(graph, output, metadata)
    compare_with_torch(setup, model, pictures, log)
    say_contents(output, log)
    return output


def completed(setup: ExportSetup, model: "DepthNet") -> tuple[ExportSetup, tuple[int, int], Path]:
    """Fill in what the model decides: name, size and output file; the latter two are returned too.

    Raises:
        ValueError: the output exists already.
    """
    from eldenet.model import size_of_frames

    height, width = setup.size or size_of_frames(model.info) or UNTRAINED_SIZE
    size = (int(height), int(width))
    name = setup.name or str(model.info.get("model_name", Path(setup.checkpoint).name))
    default = f"exports/{name}-{size[0]}x{size[1]}-{setup.precision}{ENDINGS[setup.format]}"
    output = setup.output or Path(default)
    if output.exists() and not setup.overwrite:
        raise ValueError(f"{output} is there already: give another output=, or overwrite=true")
    return replace(setup, name=name, size=size, output=output), size, output


def batches(frames: Sequence[np.ndarray], setup: ExportSetup) -> list[np.ndarray]:
    """Pictures as the file takes them: one array each, repeated to a fixed batch."""
    size = setup.camera_size or setup.size or UNTRAINED_SIZE
    resized = [resize_image(frame, size) for frame in frames]
    inputs = [frame[None] if setup.camera_size else as_image(frame) for frame in resized]
    return [np.repeat(each, setup.batch or 1, axis=0) for each in inputs]


def compare_with_torch(
    setup: ExportSetup, model: "DepthNet", pictures: Sequence[np.ndarray], log: "RunLog"
) -> None:
    """Print the differences between torch and the file under each installed runtime.

    Raises:
        ValueError: an fp32 file gives another depth than torch.
    """
    from eldenet.deploy.files import differences

    output, size = setup.output or Path(), setup.camera_size or setup.size or UNTRAINED_SIZE
    seen = [resize_image(picture, size) for picture in pictures]
    predictor = DepthPredictor(model, setup.size)
    reference = np.stack([predictor(frame) for frame in seen])
    rows, inputs = [], batches(seen, setup)
    for name in filter(runtimes.installed, runtimes.READS[output.suffix]):
        try:
            network = runtimes.load(output, name, threads=1)
        except ValueError as error:
            log.say(f"not compared under {name}: {error}")
            continue
        found = differences(np.stack([network(image)[0, 0] for image in inputs]), reference)
        rows.append([name, *(f"{value:.2g}" for value in found.values())])
        if setup.precision == "fp32" and not found["median_relative"] < FP32_TOLERANCE:
            raise ValueError(f"{output} under {name} differs from torch: {found}; do not use it")
    title = f"{setup.name}, {setup.precision}: depth beside torch's on {len(seen)} pictures"
    log.table(title, ["runtime", "max [m]", "median [m]", "max, relative", "median, relative"], rows)


def say_contents(output: Path, log: "RunLog") -> None:
    """Print the file's operations and its size."""
    from eldenet.deploy.files import count_operations

    kinds = count_operations(output)
    norms = sum(number for kind, number in kinds.items() if "BatchNorm" in kind)
    counted = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common(4))
    files = [output, output.with_suffix(".bin")]
    megabytes = sum(path.stat().st_size for path in files if path.exists()) / 1e6
    log.say(f"{kinds.total()} operations ({counted}, ...), {norms} batch normalizations")
    log.say(f"written to {output} ({megabytes:.2f} MB)")

"""``python -m eldenet.export``: a trained network as a file for other runtimes, checked against torch.

python -m eldenet.export checkpoint=runs/my-run
python -m eldenet.export checkpoint=runs/my-run format=openvino precision=int8 pictures='photos/*.jpg'
python -m eldenet.export checkpoint=runs/my-run batch=1 opset=13 'camera=[480,640]' fov=69
"""

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import eldenet
from eldenet.cli.entry_point import entry_point
from eldenet.compose import REQUIRED, listed
from eldenet.deploy.metadata import UNTRAINED_SIZE, describe, files_of
from eldenet.geometry import focal_of_fov, resize_image, size_of_aspect
from eldenet.system.checks import at_least, check_size, one_of
from eldenet.system.extras import require
from eldenet.system.files import safe_stem
from eldenet.system.onnx_files import NEWEST_OPSET
from eldenet.weights import find_checkpoint, name_of

if TYPE_CHECKING:
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog

ENDINGS = {"onnx": ".onnx", "openvino": ".xml"}
PRECISIONS = {"onnx": ("fp32", "int8"), "openvino": ("fp32", "bf16", "int8")}
INT8_OPSET = 13  # the oldest with scales per channel
FP32_TOLERANCE = 1e-3  # an fp32 file with a larger median relative difference is wrong, not rounded
INT8_TOLERANCE = 0.02  # an int8 file with a larger median relative difference is worth a warning


@dataclass(frozen=True)
class ExportSettings:
    """What ``python -m eldenet.export`` reads."""

    checkpoint: str = REQUIRED  # a run folder, a model folder, a Hub id, or a network's name (not trained)
    format: str = "onnx"  # onnx, or openvino (.xml + .bin)
    # fp32; int8, with scales from pictures; bf16 (openvino, on processors that have it)
    precision: str = "fp32"
    # (height, width) that the network sees [px]; null: any, and each picture is seen at the scale of the
    # training, as by torch. With camera, fov, batch or an old opset a file has one size: that of the training
    # (after training on crops: of a whole frame at that scale), else 224 x 224; in the aspect of camera
    size: Any = None
    batch: int | None = None  # fixed number of images, of one size; null: any
    opset: int = NEWEST_OPSET  # ONNX opset: 18, or 11 to 17 for old boards
    # (height, width) [px]: the file takes uint8 RGB frames and returns depth of this size, with resizing
    # inside; null: it takes float images of size
    camera: Any = None
    # horizontal field of view [degrees] of the camera: the file knows this lens, takes pictures alone, and
    # answers in meters; null: a network with a canonical camera works for any lens, which each call gives
    fov: float | None = None
    # a folder, or a pattern such as 'photos/*.jpg', for the check and the scales of int8; null: the built-in
    # rendered rooms
    pictures: str | None = None
    calibration: int = 128  # number of pictures for the scales of int8
    checks: int = 8  # number of pictures for the comparison with torch, 1 or more
    # of the weights, written into the file (data sets restricted to research pass the restriction on); null:
    # the model's, else "not stated"
    license: str | None = None
    # null: exports/<model>-<precision>.onnx or .xml; <model>-<height>x<width>-<precision> for one size
    output: str | None = None
    overwrite: bool = False  # true: replace an existing file
    trusted_modules: Any = field(default_factory=list)  # packages whose classes foreign weights may name

    def __post_init__(self) -> None:
        one_of("format", self.format, tuple(ENDINGS))
        if self.precision not in PRECISIONS[self.format]:
            raise ValueError(
                f"precision={self.precision}: for format={self.format} choose from "
                f"{', '.join(PRECISIONS[self.format])}"
                + ("; for bf16 give format=openvino" if self.precision == "bf16" else "")
            )
        if self.precision == "int8" and self.format == "onnx" and self.opset < INT8_OPSET:
            raise ValueError(
                f"opset={self.opset}: int8 in ONNX has a scale per channel: give {INT8_OPSET} or more"
            )
        at_least(1, calibration=self.calibration, checks=self.checks)
        if self.output is not None and Path(self.output).suffix != ENDINGS[self.format]:
            raise ValueError(
                f"output={self.output}: format={self.format} needs a name that ends in {ENDINGS[self.format]}"
            )
        check_size("size", self.size)
        check_size("camera", self.camera)
        if self.fov is not None:
            focal_of_fov(self.fov, 1)


@dataclass(frozen=True)
class Target:
    """What to write: the settings, completed by the model where they leave something open."""

    s: ExportSettings
    name: str
    size: tuple[int, int]
    any_size: bool
    output: Path


def export(s: ExportSettings) -> Path:
    """Write the file, compare it with torch, and print what it contains.

    Raises:
        ValueError: the file already exists, the pictures are missing, no runtime loads the file, or an fp32
            file differs from torch.
    """
    needed = ["onnx", "onnxscript"] + ["openvino"] * (s.format == "openvino")
    if s.precision == "int8":
        needed.append("onnxruntime" if s.format == "onnx" else "nncf")
    require(f"format={s.format}, precision={s.precision}", *needed)
    find_checkpoint(s.checkpoint, "checkpoint")
    from eldenet.deploy.calibration_pictures import read_pictures
    from eldenet.deploy.onnx_export import quantize_onnx, write_onnx
    from eldenet.deploy.openvino_export import quantize_openvino, write_openvino
    from eldenet.results.run_log import RunLog, untrained_note

    model = eldenet.load(s.checkpoint, trusted_modules=listed(s.trusted_modules))
    target = target_of(s, model)
    size, output, log = target.size, target.output, RunLog(target.output.parent)
    if find_checkpoint(s.checkpoint).kind == "network":
        log.say(untrained_note(s.checkpoint))
    if s.pictures is None:
        log.say("pictures for the check: rendered rooms (yours: pictures=folder)")
    pictures = read_pictures(s.pictures, s.checks, "test")
    metadata = describe(model, target.name, size, camera_size=s.camera, fov=s.fov, license=s.license)
    metadata["precision"] = s.precision
    with tempfile.TemporaryDirectory() as temporary:
        is_graph = s.format == "onnx" and s.precision == "fp32"  # all other files are made from it
        graph = write_onnx(
            model,
            output if is_graph else Path(temporary) / "fp32.onnx",
            size,
            any_size=target.any_size,
            batch=s.batch,
            opset=s.opset,
            camera_size=s.camera,
            metadata=metadata,
        )
        if s.precision == "int8":
            frames = read_pictures(s.pictures, s.calibration, "train")
            inputs = [as_input(resize_image(frame, s.camera or size), target) for frame in frames]
            log.say(f"int8: scales from {len(frames)} pictures")
            if s.format == "onnx":
                quantize_onnx(graph, output, inputs)
            else:
                quantize_openvino(graph, output, inputs, metadata)
        elif s.format == "openvino":
            write_openvino(graph, output, metadata)
    try:
        compare_with_torch(target, model, pictures, log)
    except BaseException:  # a file that is there has passed
        for file in files_of(output):
            file.unlink(missing_ok=True)
        raise
    say_contents(output, log)
    return output


def target_of(s: ExportSettings, model: "DepthNet") -> Target:
    """Name, size and output file of an export.

    Raises:
        ValueError: the output already exists.
    """
    from eldenet.model import size_of_frames

    height, width = s.size or size_of_frames(model.info) or UNTRAINED_SIZE
    size = (int(height), int(width))
    if s.camera is not None and s.size is None:
        stretch = model.info.get("stretch") or 1.0
        size = size_of_aspect(size, (s.camera[0], s.camera[1] * stretch))
    name = name_of(s.checkpoint, model.info)
    any_size = (s.size, s.camera, s.fov, s.batch, s.opset) == (None, None, None, None, NEWEST_OPSET)
    at = "" if any_size else f"-{size[0]}x{size[1]}"
    default = f"exports/{safe_stem(name)}{at}-{s.precision}{ENDINGS[s.format]}"
    output = Path(s.output or default).expanduser()
    if output.exists() and not s.overwrite:
        raise ValueError(f"{output} already exists: give another output=, or overwrite=true")
    return Target(s, name, size, any_size, output)


def as_input(picture: np.ndarray, target: Target) -> np.ndarray:
    """A picture as the file takes it, repeated to a fixed batch."""
    from eldenet.deploy.predictor import as_image

    one = picture[None] if target.s.camera else as_image(picture)
    return np.repeat(one, target.s.batch or 1, axis=0)


def compare_with_torch(
    target: Target, model: "DepthNet", pictures: Sequence[np.ndarray], log: "RunLog"
) -> None:
    """Print the differences between torch and the file under each installed runtime, of depth and sigma.

    Raises:
        ValueError: an output of an fp32 file differs from torch's, a runtime cannot run the file, or no
            installed one loads it.
    """
    from eldenet.deploy import runtimes

    s, output = target.s, target.output
    height, width = target.size
    # at any size also upright pictures, and those whose sides, halved and rounded down or up, stay odd
    odd = (height - height % 32 + 31, width - width % 32 + 33)
    each = ([target.size] + [odd, (width, height)] * target.any_size) * len(pictures)
    sizes = [s.camera or size for size in each[: len(pictures)]]
    seen = [resize_image(picture, size) for picture, size in zip(pictures, sizes, strict=True)]
    widths = [picture.shape[1] for picture in seen]
    if s.fov is not None:
        lenses: list[float | None] = [focal_of_fov(s.fov, width) for width in widths]
    else:  # every second picture with a lens, if the network takes one
        takes_lens = model.canonical_px is not None
        lenses = [0.9 * width if takes_lens and number % 2 else None for number, width in enumerate(widths)]
    reference = [torch_maps(target, model, *given) for given in zip(seen, lenses, strict=True)]
    rows, not_loaded, inputs = [], "", [as_input(picture, target) for picture in seen]
    for name in filter(runtimes.installed, runtimes.READS[output.suffix]):
        try:
            network = runtimes.load(output, name, threads=1)
        except ValueError as error:
            not_loaded = str(error)
            log.say(f"not compared under {name}: {not_loaded}")
            continue
        try:
            estimates = [network.predict(*given) for given in zip(inputs, lenses, strict=True)]
        except Exception as error:  # each runtime has a class of its own
            advice = f" at any size: give size={list(target.size)}, or another one" * target.any_size
            raise ValueError(f"{output} was removed, as {name} cannot run it{advice} ({error})") from error
        for kind in reference[0]:
            ours = np.concatenate([getattr(estimate, kind)[0, 0].ravel() for estimate in estimates])
            theirs = np.concatenate([maps[kind].ravel() for maps in reference])
            found = map_errors(ours, theirs)
            rows.append([name, kind, *(f"{value:.2g}" for value in found.values())])
            if s.precision == "fp32" and not found["median_relative"] < FP32_TOLERANCE:
                raise ValueError(
                    f"{kind} of {output} under {name} differs from torch, so it was removed: {found}"
                )
            if s.precision == "int8" and found["median_relative"] > INT8_TOLERANCE:
                log.say(
                    f"warning: int8 {kind} under {name} is {found['median_relative']:.1%} off torch in the "
                    f"median pixel and {found['max_relative']:.0%} in the worst; compare its accuracy, give "
                    "pictures of the place where it will run, or keep fp32"
                )
    if not_loaded and not rows and s.precision != "bf16":  # which another processor may have
        raise ValueError(f"{output} was removed, as no runtime here loads it ({not_loaded})")
    title = (
        f"{target.name}, {s.precision}: the file beside torch on {len(seen)} pictures, seen at "
        f"{target.size[0]} x {target.size[1]}"
    )
    log.table(title, ["runtime", "output", "max [m]", "median [m]", "max, rel.", "median, rel."], rows)


def torch_maps(
    target: Target, model: "DepthNet", picture: np.ndarray, focal: float | None
) -> dict[str, np.ndarray]:
    """What the file should answer: torch's "depth", and "sigma" if there is one, ``(H, W)`` [m] each.

    Args:
        picture: ``(H, W, 3)`` uint8 RGB, of the size that the file takes.
        focal: fx [px of the picture]; None: the canonical camera's.
    """
    import torch

    from eldenet.deploy.predictor import as_image, enlarged

    height, width = picture.shape[:2]
    # float32: resizing must not round to gray levels, as camera files do not
    image = as_image(resize_image(picture.astype(np.float32), target.size) if target.s.camera else picture)
    with torch.inference_mode():
        estimate = model.predict(
            torch.from_numpy(image), None if focal is None else focal * image.shape[3] / width
        )
    maps = {"depth": estimate.depth, "sigma": estimate.sigma}
    return {
        kind: enlarged(each[0, 0].numpy(), (height, width)) for kind, each in maps.items() if each is not None
    }


def say_contents(output: Path, log: "RunLog") -> None:
    """Print the file's operations and its size."""
    kinds = count_operations(output)
    norms = sum(number for kind, number in kinds.items() if "BatchNorm" in kind)
    counted = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common(4))
    megabytes = sum(path.stat().st_size for path in files_of(output)) / 1e6
    log.say(f"{kinds.total()} operations ({counted}, ...), {norms} batch normalizations")
    log.say(f"written to {output} ({megabytes:.2f} MB)")


def count_operations(path: str | Path) -> Counter[str]:
    """Number of each operation in an ONNX or OpenVINO file, without constants."""
    if Path(path).suffix == ".onnx":
        from eldenet.system.onnx_files import read_graph

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


main = entry_point(ExportSettings)(export)

if __name__ == "__main__":
    main()

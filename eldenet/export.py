"""``python -m eldenet.export``: a trained network as a file for other runtimes, checked against torch."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog

ENDINGS = {"onnx": ".onnx", "openvino": ".xml"}
PRECISIONS = {"onnx": ("fp32", "int8"), "openvino": ("fp32", "bf16", "int8")}
UNTRAINED_SIZE = (224, 224)
FP32_TOLERANCE = 1e-3  # median relative difference beyond which an fp32 file is wrong, not rounded


@entry_point("export")
def main(config: "DictConfig", folder: Path) -> None:
    """Export; ``folder`` is not used, the file goes to ``output``."""
    export(config)


@dataclass(frozen=True)
class Job:
    """What is to be written: the config, checked."""

    name: str
    format: str
    precision: str
    size: tuple[int, int]
    camera_size: tuple[int, int] | None
    batch: int | None
    opset: int
    output: Path


def export(config: "DictConfig") -> Path:
    """Load, fold, write, quantize where asked for, compare with torch, say what came out."""
    import eldenet
    from eldenet.deploy.files import describe, write_onnx, write_openvino
    from eldenet.deploy.quantize import quantize_onnx, quantize_openvino
    from eldenet.results.run_log import RunLog
    from eldenet.zoo import note_if_untrained

    model = eldenet.load(config.checkpoint, trusted_modules=cfg.plain(config.trusted_modules))
    job = read_job(config, model)
    log = RunLog(job.output.parent)
    if note := note_if_untrained(config.checkpoint):
        log.say(note)
    pictures = read_pictures(config.pictures, max(config.checks, 1), "test")
    facts = describe(model, job.name, job.size, camera_size=job.camera_size, license=config.license)
    facts["precision"] = job.precision
    with tempfile.TemporaryDirectory() as temporary:
        # the fp32 graph is what everything else is made from
        plain = job.format == "onnx" and job.precision == "fp32"
        graph = write_onnx(
            model,
            job.output if plain else Path(temporary) / "fp32.onnx",
            job.size,
            batch=job.batch,
            opset=job.opset,
            camera_size=job.camera_size,
            metadata=facts,
        )
        if job.precision == "int8":
            frames = read_pictures(config.pictures, config.calibration, "train")
            inputs = batches(frames, job)
            log.say(f"int8: scales from {len(frames)} pictures")
            if job.format == "onnx":
                quantize_onnx(graph, job.output, inputs)
            else:
                quantize_openvino(graph, job.output, inputs, facts)
        elif job.format == "openvino":
            write_openvino(graph, job.output, facts)
    report(job, model, pictures, log)
    return job.output


def read_job(config: "DictConfig", model: "DepthNet") -> Job:
    """Check the settings.

    Raises:
        ValueError: an unknown choice, or a file that is there already.
    """
    from eldenet.model import size_of_frames
    from eldenet.system.checks import one_of

    one_of("format", str(config.format), tuple(ENDINGS))
    kind, precision = str(config.format), str(config.precision)
    if precision not in PRECISIONS[kind]:
        raise ValueError(
            f"precision={precision}: format={kind} has {', '.join(PRECISIONS[kind])}"
            + ("; bf16 is format=openvino's" if precision == "bf16" else "")
        )
    size = _size(config, "size") or size_of_frames(model.info) or UNTRAINED_SIZE
    name = str(model.info.get("model_name", Path(str(config.checkpoint)).name))
    ending = ENDINGS[kind]
    output = Path(config.output or f"exports/{name}-{size[0]}x{size[1]}-{precision}{ending}").expanduser()
    if output.suffix != ending:
        raise ValueError(f"output={output}: format={kind} needs a name that ends in {ending}")
    if output.exists() and not config.overwrite:
        raise ValueError(f"{output} is there already: give another output=, or overwrite=true")
    camera_size = _size(config, "camera")
    size = (int(size[0]), int(size[1]))
    return Job(name, kind, precision, size, camera_size, config.batch, int(config.opset), output)


def _size(config: "DictConfig", name: str) -> tuple[int, int] | None:
    given = cfg.plain(config[name])
    if given is None:
        return None
    if not isinstance(given, list) or len(given) != 2 or min(given) < 1:
        raise ValueError(f"{name}={given}: give [height, width] in pixels, or null")
    return int(given[0]), int(given[1])


def read_pictures(source: str | None, count: int, split: str) -> list[np.ndarray]:
    """``count`` pictures ``(H, W, 3)`` uint8 RGB, evenly spread; from the built-in rooms without a source.

    Raises:
        ValueError: there are none.
    """
    from eldenet.data.io import IMAGE_ENDINGS, read_image
    from eldenet.data.rooms import Rooms

    if source is None:
        rooms = Rooms(split, frames=count)
        return [rooms.load_frame(index).image for index in range(len(rooms))]
    folder = Path(source).expanduser()
    paths = sorted(folder.iterdir() if folder.is_dir() else folder.parent.glob(folder.name))
    paths = [path for path in paths if path.suffix.lower() in IMAGE_ENDINGS]
    if not paths:
        raise ValueError(f"pictures={source} are none: give a folder, or a pattern such as 'photos/*.jpg'")
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(count, len(paths))).round().astype(int))
    return [read_image(paths[index], upright=True) for index in chosen]


def batches(frames: Sequence[np.ndarray], job: Job) -> list[np.ndarray]:
    """Pictures as the file takes them: one array each, a whole batch where that is fixed."""
    from eldenet.deploy.predictor import as_image, resized

    if job.camera_size is not None:
        inputs = [resized(frame, job.camera_size)[None] for frame in frames]
    else:
        inputs = [as_image(resized(frame, job.size)) for frame in frames]
    return [np.repeat(each, job.batch or 1, axis=0) for each in inputs]


def report(job: Job, model: "DepthNet", pictures: list[np.ndarray], log: "RunLog") -> None:
    """Compare the file with torch on pictures, and say what it holds.

    Raises:
        ValueError: an fp32 file gives another depth than torch.
    """
    from eldenet.deploy import runtimes
    from eldenet.deploy.files import count_operations, differences
    from eldenet.deploy.predictor import DepthPredictor, resized

    seen = [resized(frame, job.camera_size or job.size) for frame in pictures]
    predictor = DepthPredictor(model, job.size)
    reference = np.stack([predictor(frame) for frame in seen])
    rows, inputs = [], batches(seen, job)
    for name in runtimes.READS[job.output.suffix]:
        if not runtimes.installed(name):
            continue
        try:
            network = runtimes.load(job.output, name, threads=1)
        except ValueError as error:
            log.say(f"not compared under {name}: {error}")
            continue
        depth = np.stack([network(image)[0, 0] for image in inputs])
        found = differences(depth, reference)
        rows.append([name, *(f"{found[key]:.2g}" for key in found)])
        if job.precision == "fp32" and not found["median_relative"] < FP32_TOLERANCE:
            raise ValueError(f"{job.output} under {name} differs from torch: {found}; do not use it")
    title = f"{job.name}, {job.precision}: depth beside torch's on {len(seen)} pictures"
    log.table(title, ["runtime", "max [m]", "median [m]", "max, relative", "median, relative"], rows)
    kinds = count_operations(job.output)
    norms = sum(number for kind, number in kinds.items() if "BatchNorm" in kind)
    counted = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common(4))
    files = [job.output, job.output.with_suffix(".bin")]
    weight = sum(path.stat().st_size for path in files if path.exists()) / 1e6
    log.say(f"{kinds.total()} operations ({counted}, ...), {norms} batch normalizations")
    log.say(f"written to {job.output} ({weight:.2f} MB)")


if __name__ == "__main__":
    main()

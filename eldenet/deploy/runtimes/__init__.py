"""The same network under every runtime that a user would deploy, behind one call.

``depth = eldenet.deploy.runtimes.load("eldenet.onnx", "openvino", "bf16", threads=2)(images)``
"""

import tempfile
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from eldenet.deploy.files import describe, write_onnx
from eldenet.deploy.runtimes.base import PRECISIONS, Runtime
from eldenet.deploy.stream import DepthStream
from eldenet.evaluation.cost import median_ms, time_interleaved
from eldenet.model import DepthNet, size_of_frames
from eldenet.system.resources import available_cores
from eldenet.zoo import located

__all__ = ["PRECISIONS", "RUNTIMES", "DepthStream", "Runtime", "fastest", "load"]

TORCH = ("torch", "torch_channels_last", "torch_compile")
RUNTIMES = (*TORCH, "onnxruntime", "openvino")
READS = {".onnx": ("onnxruntime", "openvino"), ".xml": ("openvino",)}


def load(
    source: str | Path | DepthNet,
    runtime: str = "auto",
    precision: str | None = None,
    *,
    threads: int | None = None,
    device: str = "cpu",
    size: tuple[int, int] | None = None,
    trusted_modules: Sequence[str] = (),
) -> Runtime:
    """A network ready to run: ``load(...)(images) -> meters``.

    Args:
        source: an ``.onnx`` or ``.xml`` file, a folder that ``save_pretrained`` or a training wrote, the name
            of the package's own weights ("eldenet_rooms"), or a :class:`~eldenet.model.DepthNet`.
        runtime: "torch", "torch_channels_last", "torch_compile", "onnxruntime" or "openvino"; "auto": torch
            for a model, and for a file the fastest that is installed (:func:`fastest`).
        precision: "fp32", "bf16", "fp16" or "int8"; None: the file's own, or fp32.
        threads: on a CPU; None: all cores that this process may use.
        device: "cpu", "cuda", "tensorrt" (ONNX Runtime), "gpu", "npu" (OpenVINO), or an ONNX Runtime
            provider's name.
        size: ``(height, width)`` [px] for a model under ONNX Runtime or OpenVINO, which is exported on the
            way; None: that of whole frames in its training (:func:`eldenet.model.size_of_frames`).
        trusted_modules: packages whose classes a folder's config may name.

    Raises:
        ValueError: what was asked for is not to be had here; says what is.
        FileNotFoundError: no such file or folder.
        ImportError: the runtime is not installed.
    """
    threads = available_cores() if threads is None else threads
    if runtime not in ("auto", *RUNTIMES):
        raise ValueError(f"runtime={runtime!r}: choose auto, {', '.join(RUNTIMES)}")
    if not isinstance(source, DepthNet) and Path(source).suffix in READS:
        path = Path(source).expanduser()
        if not path.is_file():
            raise FileNotFoundError(f"{path} does not exist: python -m eldenet.export writes such files")
        if runtime == "auto":
            return fastest(path, precision, threads=threads, device=device)
        if runtime not in READS[path.suffix]:
            raise ValueError(
                f"{path.name} runs under {' or '.join(READS[path.suffix])}, not under {runtime}: for that, "
                "give the model's folder"
            )
        return _open(path, runtime, precision, threads, device)
    model = (
        source
        if isinstance(source, DepthNet)
        else DepthNet.from_pretrained(located(source), trusted_modules=trusted_modules)
    )
    runtime = "torch" if runtime == "auto" else runtime
    size = size or size_of_frames(model.info)
    if runtime in TORCH:
        from eldenet.deploy.runtimes.pytorch import TorchRuntime

        facts = _facts(model, size)
        return TorchRuntime(
            model, runtime, precision=precision or "fp32", threads=threads, device=device, metadata=facts
        )
    if size is None:
        raise ValueError(
            f"{runtime} needs a size, and the model names none: give size=(height, width), on the command "
            "line input_size=[height,width]"
        )
    if precision == "int8":
        raise ValueError("int8 needs calibration frames: export a file (python -m eldenet.export)")
    with tempfile.TemporaryDirectory() as folder:
        path = write_onnx(
            model, Path(folder) / "model.onnx", (size[0], size[1]), metadata=_facts(model, size)
        )
        return _open(path, runtime, precision, threads, device)


def fastest(
    path: str | Path, precision: str | None = None, *, threads: int | None = None, device: str = "cpu"
) -> Runtime:
    """The runtime that runs this file fastest here, found by running each for a moment.

    Raises:
        ValueError: none can; says why for each.
    """
    threads = available_cores() if threads is None else threads
    able, reasons = {}, {}
    for name in READS[Path(path).suffix]:
        try:
            able[name] = _open(Path(path), name, precision, threads, device)
        except (ValueError, ImportError) as error:
            reasons[name] = str(error)
    if not able:
        raise ValueError("; ".join(f"{name}: {reason}" for name, reason in reasons.items()))
    if len(able) == 1:
        return next(iter(able.values()))
    some = next(iter(able.values()))
    height, width = some.camera_size or some.info.get("input_size", (224, 224))
    batch = some.fixed_batch or 1
    shape = (batch, height, width, 3) if some.takes_frames else (batch, 3, height, width)
    image = np.zeros(shape, np.uint8 if some.takes_frames else np.float32)
    times = time_interleaved(
        {name: lambda network=network: network.run(image) for name, network in able.items()},  # type: ignore[misc]
        rounds=3,
        seconds=0.05,
    )
    return able[min(times, key=lambda name: median_ms(times[name]))]


def installed(runtime: str) -> bool:
    """Whether the library behind ``runtime`` is there."""
    return find_spec("torch" if runtime in TORCH else runtime) is not None


def _open(path: Path, runtime: str, precision: str | None, threads: int, device: str) -> Runtime:
    if not installed(runtime):
        raise ImportError(f"{runtime} is not installed: pip install 'eldenet[deploy]'")
    if runtime == "onnxruntime":
        from eldenet.deploy.runtimes.onnx import OnnxRuntime

        return OnnxRuntime(path, precision=precision, threads=threads, device=device)
    from eldenet.deploy.runtimes.openvino import OpenvinoRuntime

    return OpenvinoRuntime(path, precision=precision, threads=threads, device=device)


def _facts(model: DepthNet, size: tuple[int, int] | None) -> Mapping[str, str]:
    name = str(model.info.get("model_name", "unnamed"))
    return {"model": name} if size is None else describe(model, name, (int(size[0]), int(size[1])))

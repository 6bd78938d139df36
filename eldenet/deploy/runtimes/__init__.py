"""One call to run a network under any of the runtimes used for deployment.

``depth = eldenet.runtimes.load("eldenet.onnx", "openvino", "bf16", threads=2)(images)``
"""

import functools
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import eldenet
from eldenet.deploy.metadata import UNTRAINED_SIZE, canonical_camera, check_seal, describe
from eldenet.deploy.runtimes.base import PRECISIONS, Runtime
from eldenet.deploy.stream import DepthStream
from eldenet.system.checks import one_of
from eldenet.system.extras import installed, require
from eldenet.system.resources import available_cores
from eldenet.system.timing import median_ms, time_interleaved
from eldenet.weights import find_checkpoint

if TYPE_CHECKING:
    from eldenet.model import DepthNet

__all__ = ["PRECISIONS", "RUNTIMES", "DepthStream", "Runtime", "fastest", "load"]

TORCH = ("torch", "torch_channels_last", "torch_compile")
RUNTIMES = (*TORCH, "onnxruntime", "openvino")
READS = {".onnx": ("onnxruntime", "openvino"), ".xml": ("openvino",)}
#: Packages with which a runtime runs a model: it is exported first. An exported file needs the last one.
PACKAGES = {
    **dict.fromkeys(TORCH, ()),
    "onnxruntime": ("onnx", "onnxscript", "onnxruntime"),
    "openvino": ("onnx", "onnxscript", "openvino"),
}


def load(
    source: "str | Path | DepthNet",
    runtime: str = "auto",
    precision: str | None = None,
    *,
    threads: int | None = None,
    device: str = "cpu",
    size: tuple[int, int] | None = None,
    trusted_modules: Sequence[str] = (),
) -> Runtime:
    """Load a network ready to run: ``load(...)(images) -> meters``. A file loads without torch.

    Args:
        source: an ``.onnx`` or ``.xml`` file, a :class:`~eldenet.model.DepthNet`, or anything that
            :func:`eldenet.load` takes.
        runtime: "torch", "torch_channels_last", "torch_compile", "onnxruntime" or "openvino"; "auto": torch
            for a model, the fastest installed one for a file (:func:`fastest`).
        precision: "fp32", "bf16", "fp16" or "int8"; None: the file's own, or fp32.
        threads: on a CPU; None: all cores that this process may use.
        device: "cpu", "cuda", "tensorrt" (ONNX Runtime), "gpu", "npu" (OpenVINO), or an ONNX Runtime
            provider's name.
        size: the only ``(height, width)`` [px] at which a model runs under ONNX Runtime or OpenVINO; None:
            any, as under torch.
        trusted_modules: packages whose classes a folder's config may name.

    Raises:
        ValueError: the runtime, precision or device is not available; the message lists the available ones.
        FileNotFoundError: no such file or folder.
        ImportError: the runtime is not installed.
    """
    threads = available_cores() if threads is None else threads
    one_of("runtime", runtime, ("auto", *RUNTIMES))
    if isinstance(source, str | Path) and (found := find_checkpoint(source)).kind == "exported":
        path = found.path
        if runtime == "auto":
            return fastest(path, precision, threads=threads, device=device)
        if runtime not in READS[path.suffix]:
            raise ValueError(
                f"{path.name} runs under {' or '.join(READS[path.suffix])}, not under {runtime}: for that, "
                "give the model's folder"
            )
        return _open(path, runtime, precision, threads, device)
    from eldenet.deploy.onnx_export import write_onnx
    from eldenet.model import DepthNet, size_of_frames

    model = source if isinstance(source, DepthNet) else eldenet.load(source, trusted_modules=trusted_modules)
    runtime = "torch" if runtime == "auto" else runtime
    any_size = size is None
    size = size or size_of_frames(model.info)  # a graph for any size is made at this one
    name = str(model.info.get("model_name", "unnamed"))
    metadata = (
        {"model": name, "distribution": json.dumps(model.distribution)} | canonical_camera(model)
        if size is None
        else describe(model, name, (int(size[0]), int(size[1])))
    )
    if runtime in TORCH:
        from eldenet.deploy.runtimes.pytorch import TorchRuntime

        return TorchRuntime(
            model, runtime, precision=precision or "fp32", threads=threads, device=device, metadata=metadata
        )
    if size is None:
        raise ValueError(
            f"{runtime} needs a size, but the model states none: give size=(height, width) or, on the "
            "command line, input_size=[height,width]"
        )
    if precision == "int8":
        raise ValueError("int8 needs calibration pictures: export a file (eldenet export)")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        write_onnx(model, path, (size[0], size[1]), any_size=any_size, metadata=metadata)
        network = _open(path, runtime, precision, threads, device)
        network.reopen = None  # the file is gone
        return network


def fastest(
    path: str | Path, precision: str | None = None, *, threads: int | None = None, device: str = "cpu"
) -> Runtime:
    """Run a file briefly under each installed runtime and return the fastest one.

    Raises:
        ValueError: no runtime can run it; the message gives the reason for each.
    """
    threads = available_cores() if threads is None else threads
    able, reasons = {}, []
    for name in READS[Path(path).suffix]:
        try:
            able[name] = _open(Path(path), name, precision, threads, device)
        except (ValueError, ImportError) as error:
            reasons.append(str(error))
    if not able:
        raise ValueError("; ".join(dict.fromkeys(reasons)))
    first = next(iter(able.values()))
    if len(able) == 1:
        return first
    usual = (1, 3, *UNTRAINED_SIZE)  # of a file that takes any number or size
    shape = [side or one for side, one in zip(first.shape, usual, strict=True)]
    image = np.zeros(shape, np.uint8 if first.takes_frames else np.float32)
    times = time_interleaved(
        {name: lambda network=network: network.run(image) for name, network in able.items()},  # type: ignore[misc]
        rounds=3,
        seconds=0.05,
    )
    return able[min(times, key=lambda name: median_ms(times[name]))]


def check_installed(checkpoint: str, runtime: str) -> None:
    """Check that the packages are there with which a runtime runs a file or a model; none is imported.

    Raises:
        ImportError: one is missing.
    """
    found = find_checkpoint(checkpoint)
    if found.kind != "exported":
        require(f"engine={runtime}", *PACKAGES.get(runtime, ()))
        return
    able = READS[found.path.suffix] if runtime == "auto" else (runtime,)
    if not any(map(installed, able)):
        require(checkpoint, able[0])


def _open(path: Path, runtime: str, precision: str | None, threads: int, device: str) -> Runtime:
    require(path.name, runtime)
    check_seal(path)
    network: Runtime
    if runtime == "onnxruntime":
        from eldenet.deploy.runtimes.onnx import OnnxRuntime

        network = OnnxRuntime(path, precision=precision, threads=threads, device=device)
    else:
        from eldenet.deploy.runtimes.openvino import OpenvinoRuntime

        network = OpenvinoRuntime(path, precision=precision, threads=threads, device=device)
    network.reopen = functools.partial(_open, path.absolute(), runtime, precision, threads, device)
    return network

"""ONNX files: the one place that opens them, for every part of eldenet that reads one; and their opsets."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.system.errors import reading
from eldenet.system.extras import require

if TYPE_CHECKING:
    import onnx

CPU, CUDA, TENSORRT = "CPUExecutionProvider", "CUDAExecutionProvider", "TensorrtExecutionProvider"
# by default CUDA rounds the factors of fp32 convolutions and products to the ten bits of TF32
OPTIONS = {CUDA: {"use_tf32": "0"}}
EXPORT_AGAIN = "fetch it or export it again"
NEWEST_OPSET = 18  # that eldenet writes, with torch's newer exporter; the older one writes the others
OLDEST_OPSET = 11  # bilinear resizing by half pixels, as torch does it, begins here


def read_graph(path: str | Path) -> "onnx.ModelProto":
    """Return the content of an ONNX file; weights that it keeps in other files are not read.

    Raises:
        ImportError: the package ``onnx`` is missing.
        ValueError: it is no ONNX file.
    """
    require(f"reading {path}", "onnx")
    import onnx

    with reading(path, "ONNX file", EXPORT_AGAIN):
        return onnx.load(path, load_external_data=False)


def open_session(path: str | Path, providers: Sequence[str] = (CPU,), *, threads: int = 1) -> Any:
    """Open an ONNX file under ONNX Runtime, which executes nothing but its graph.

    Args:
        path: of the file.
        providers: in order of preference; the first one that is installed must run.
        threads: on a CPU; 0: ONNX Runtime's own choice. They do not spin while they wait, so that other work
            can use the core.

    Returns:
        An ``onnxruntime.InferenceSession``.

    Raises:
        ImportError: ONNX Runtime is missing.
        FileNotFoundError: there is no such file.
        ValueError: it is no ONNX file that ONNX Runtime can load, or no provider is installed or starts.

    Warns:
        UserWarning: another provider than the first one runs.
    """
    require(f"running {path}", "onnxruntime")
    import onnxruntime

    if not Path(path).is_file():
        what = "is a folder" if Path(path).is_dir() else "does not exist"
        raise FileNotFoundError(f"{path} {what}: give the path of an .onnx file")
    available = onnxruntime.get_available_providers()
    usable = [name for name in providers if name in available]
    if not usable:
        raise ValueError(
            f"{', '.join(providers)}: this ONNX Runtime has {', '.join(available)} (CUDA and TensorRT need "
            "onnxruntime-gpu)"
        )
    # behind them those that run what they cannot
    cuda = [CUDA] if usable[0] == TENSORRT and CUDA in available else []
    chosen = dict.fromkeys([*usable, *cuda, CPU])
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    with reading(path, "ONNX file", EXPORT_AGAIN):
        session = onnxruntime.InferenceSession(
            str(path), options, providers=[(name, OPTIONS.get(name, {})) for name in chosen]
        )
    if session.get_providers()[0] != usable[0]:  # it falls back silently
        raise ValueError(f"ONNX Runtime has {usable[0]} but cannot start it: is its driver installed?")
    if usable[0] != providers[0]:
        warnings.warn(
            f"{path} runs on {usable[0]}: {providers[0]} is not installed on this machine", stacklevel=3
        )
    return session

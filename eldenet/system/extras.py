"""Packages that only some settings need: the extra that installs each, and the line that names it."""

from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

#: Package, as it is imported -> the extra of ``pyproject.toml`` that installs it.
EXTRAS = {
    "av": "video",
    "matplotlib": "plots",
    "h5py": "nyu",
    "OpenEXR": "exr",
    "pillow_heif": "heic",
    "timm": "timm",
    "onnx": "deploy",
    "onnxscript": "deploy",
    "onnxruntime": "deploy",
    "openvino": "deploy",
    "nncf": "deploy",
    "gymnasium": "nav",
    "rosbags": "ros",
    "rerun": "viewer",
    "supervision": "viz",
    "mlflow": "loggers",
    "wandb": "loggers",
    "trackio": "loggers",
}
#: Module that a part's ``_target_`` names -> what it imports.
_OF_PARTS = {
    "eldenet.backbones.timm": "timm",
    "eldenet.data.nyu_hdf5": "h5py",
    "eldenet.deploy.onnx_teacher": "onnxruntime",
}


def require(purpose: str, *packages: str) -> None:
    """Raise ImportError, with the command that installs them, if ``packages`` are missing.

    ``purpose`` is what needs them.
    """
    missing = [package for package in packages if not installed(package)]
    if missing:
        extras = ",".join(dict.fromkeys(EXTRAS[package] for package in missing))
        raise ImportError(f"{purpose} needs {', '.join(missing)}: pip install -e '.[{extras}]'")


def installed(package: str) -> bool:
    """Return whether a package can be imported, without importing it."""
    return find_spec(package) is not None


def require_for_parts(config: Any) -> None:
    """Require the packages of all parts that composed settings name as ``_target_``; nothing is imported.

    Raises:
        ImportError: one is missing.
    """
    for name, module in _parts(config, ""):
        if module in _OF_PARTS:
            require(name, _OF_PARTS[module])


def _parts(config: Any, name: str) -> Iterator[tuple[str, str]]:
    """Yield the name and module of every part in plain settings, such as ``model.backbone``."""
    if isinstance(config, dict):
        if isinstance(config.get("_target_"), str):
            yield name, config["_target_"].rpartition(".")[0]
        for key, value in config.items():
            yield from _parts(value, f"{name}.{key}" if name else str(key))

"""What ``checkpoint=`` may name, and the trained weights that come with the package.

The ``config.json`` of packaged weights says what they have seen.
"""

import difflib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from eldenet.system.digests import file_digest
from eldenet.system.files import shipped_folder

PACKAGED = Path(__file__).resolve().parent
BEST = "eldenet_l_indoor"  # for pictures of real rooms: what predict takes unless it is given others
#: Where weights lie in the folder of a saved model and of a run.
WEIGHT_FILES = ("model.safetensors", "model/model.safetensors")
EXPORTED = (".onnx", ".xml")  # files for ONNX Runtime and OpenVINO


def check_packaged(path: Path) -> None:
    """Check a single file of this package (policy, range errors) against ``SHA256SUMS``; others pass.

    Raises:
        ValueError: the file is damaged.
    """
    if path.resolve().parent == PACKAGED:
        lines = (PACKAGED / "SHA256SUMS").read_text().splitlines()
        sums = {name: digest for digest, name in (line.split() for line in lines)}
        if sums.get(path.name) not in (None, file_digest(path)):
            raise ValueError(f"{path} is damaged (see SHA256SUMS beside it): install eldenet again")


def list_weights() -> list[str]:
    """Return the names of trained weights in the package, such as ``eldenet_rooms`` (trained on rooms)."""
    return sorted(path.parent.name for path in PACKAGED.glob("*/config.json"))


def list_models() -> list[str]:
    """Return the names of networks that :func:`eldenet.load` builds."""
    return sorted(path.stem for path in (shipped_folder("configs", "train.yaml") / "model").glob("*.yaml"))


class Checkpoint(NamedTuple):
    """What a name stands for.

    Attributes:
        kind: "network" (a name of :func:`list_models`, not trained), "saved" (packaged weights, a saved model
            or a run folder), "exported" (an ONNX or OpenVINO file) or "hub" (an id).
        path: of the folder or file; of the other kinds the name itself.
    """

    kind: Literal["network", "saved", "exported", "hub"]
    path: Path


def find_checkpoint(name: str | Path, setting: str = "source", *, trained: bool = False) -> Checkpoint:
    """Return what ``checkpoint=`` and similar settings name; nothing is loaded.

    Args:
        name: of a network or of packaged weights; a saved model, run folder or exported file; or a Hub id.
        setting: for messages.
        trained: refuse names of networks, which have random weights.

    Raises:
        FileNotFoundError: there is no such file or folder.
        ValueError: there is no network of that name, it is not ``trained``, or a file holds tensors alone.
    """
    source, path = str(name), located(name)
    if source in list_models():
        if trained:
            raise ValueError(
                f"{setting}={source} is a network without trained weights: give one of "
                f"{', '.join(list_weights())}, a run folder (./{source}), a saved model or a Hub id"
            )
        return Checkpoint("network", Path(source))
    if path.suffix in (".pt", ".pth"):
        raise ValueError(
            f"{setting}={source} holds tensors and not their network: give the run folder, which stands for "
            "the best epoch, or a folder that model.save_pretrained wrote"
        )
    if path.suffix in EXPORTED:
        if not path.is_file():
            raise FileNotFoundError(f"{setting}={source} does not exist: eldenet export writes such files")
        return Checkpoint("exported", path)
    if path.exists():
        return Checkpoint("saved", path)
    if "/" not in source:
        near = difflib.get_close_matches(source, [*list_weights(), *list_models()], 1, 0.85)
        raise ValueError(
            f"unknown model {source!r}: "
            + (
                f"did you mean {near[0]}? docs/weights.md and docs/networks.md list all names"
                if near
                else f"choose trained weights ({', '.join(list_weights())}: indoors; there are none for "
                "streets), a network to train (docs/networks.md), a folder or a Hub id 'owner/name'"
            )
        )
    if source.startswith(("/", "./", "../", "~")) or source.count("/") != 1 or path.parent.is_dir():
        raise FileNotFoundError(
            f"{setting}={source} is neither a local folder nor a Hub id 'owner/name': give a run folder or a "
            "saved model"
        )
    return Checkpoint("hub", Path(source))


def located(source: str | Path) -> Path:
    """Return the folder of packaged weights of that name, or else the path itself.

    ``~`` is the home folder. ``./name`` is always a path, never packaged weights.

    Warns:
        UserWarning: a saved model here has the same name as packaged weights and is not used.
    """
    packaged, path = PACKAGED / source, Path(source).expanduser()
    if "/" in str(source) or not (packaged / WEIGHT_FILES[0]).is_file():
        return path
    if any((path / name).is_file() for name in WEIGHT_FILES) and path.resolve() != packaged:
        warnings.warn(
            f"{source} is taken from the package, not from the local folder of that name: to use the folder, "
            f"give ./{source}",
            stacklevel=2,
        )
    return packaged


def name_of(source: str, info: Mapping[str, Any]) -> str:
    """Name of a network for files and tables: that of packaged weights, else the one of its training."""
    return source if source in list_weights() else str(info.get("model_name", Path(source).name))

"""Trained weights that come with the package; each ``config.json`` says what they have seen."""

import hashlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PACKAGED = Path(__file__).resolve().parent
BEST = "eldenet_l_indoor"  # for pictures of real rooms: what predict takes unless it is given others
#: Where weights lie in the folder of a saved model and of a run.
WEIGHT_FILES = ("model.safetensors", "model/model.safetensors")


def check_packaged(path: Path) -> None:
    """Check a single file of this package (policy, range errors) against ``SHA256SUMS``; others pass.

    Raises:
        ValueError: the file is damaged.
    """
    if path.resolve().parent == PACKAGED:
        lines = (PACKAGED / "SHA256SUMS").read_text().splitlines()
        sums = {name: digest for digest, name in (line.split() for line in lines)}
        if sums.get(path.name) not in (None, hashlib.sha256(path.read_bytes()).hexdigest()):
            raise ValueError(f"{path} is damaged (see SHA256SUMS beside it): install eldenet again")


def list_weights() -> list[str]:
    """Return the names of trained weights in the package, such as ``eldenet_rooms`` (trained on rooms)."""
    return sorted(path.parent.name for path in PACKAGED.glob("*/config.json"))


def located(source: str | Path) -> Path:
    """Return the folder or file of a source: the package's weights of that name, or else the path itself.

    ``~`` is the home folder. ``./name`` is always a path, never the package's weights.

    Warns:
        UserWarning: a saved model here has the same name as the package's weights and is not used.
    """
    own, here = PACKAGED / source, Path(source).expanduser()
    if "/" in str(source) or not (own / WEIGHT_FILES[0]).is_file():
        return here
    if any((here / name).is_file() for name in WEIGHT_FILES) and here.resolve() != own:
        warnings.warn(
            f"{source} is taken from the package, not from the local folder of that name: to use the folder, "
            f"give ./{source}",
            stacklevel=2,
        )
    return own


def name_of(source: str, info: Mapping[str, Any]) -> str:
    """Name of a network for files and tables: that of packaged weights, else the one of its training."""
    return source if source in list_weights() else str(info.get("model_name", Path(source).name))

"""Mean and standard deviation that normalize the images: ``normalization`` in ``train.yaml``."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.system.errors import reading
from eldenet.system.files import read_json, write_json

if TYPE_CHECKING:
    from eldenet.data.base import DepthDataset
    from eldenet.model import DepthNet

FILE = "normalization.json"
FRAMES = 512


def normalization(
    choice: str | Mapping[str, Any], train_set: "DepthDataset", *, resumed: Path | None = None
) -> dict[str, list[float]]:
    """Arguments ``mean`` and ``std`` of a :class:`~eldenet.model.DepthNet`; none for ImageNet's.

    Args:
        choice: "imagenet"; "dataset": measured on ``FRAMES`` seeded frames of ``train_set``; or
            ``{mean, std}`` per channel, RGB in [0, 1].
        train_set: read only for "dataset".
        resumed: folder of a run that is resumed: its numbers are used again.

    Raises:
        ValueError: an unknown choice, or impossible numbers.
    """
    if isinstance(choice, Mapping):
        if set(choice) != {"mean", "std"}:
            raise ValueError(f"normalization={dict(choice)}: give mean and std, three numbers each")
        return {name: _three(name, choice[name]) for name in ("mean", "std")}
    if choice not in ("imagenet", "dataset"):
        raise ValueError(f"normalization={choice!r}: give imagenet, dataset or {{mean: [...], std: [...]}}")
    if choice == "imagenet":
        return {}
    if resumed is not None and (resumed / FILE).is_file():
        known = read_json(resumed / FILE)
        with reading(resumed / FILE, "normalization", "train again in another folder"):
            return {name: _three(name, known[name]) for name in ("mean", "std")}
    from eldenet.data.inspection import channel_statistics

    found = channel_statistics(train_set, frames=FRAMES)
    # five digits: no machine's last bit makes another network of it
    return {
        name: [round(v, 5) for v in values] for name, values in (("mean", found.mean), ("std", found.std))
    }


def keep_normalization(model: "DepthNet", start: "DepthNet", *, chosen: bool) -> str:
    """Give ``model`` the normalization that its start weights were trained with.

    Args:
        model: changed in place, its ``config`` too.
        start: where the weights come from.
        chosen: the user chose the normalization of ``model``, so it stays.

    Returns:
        A line for the user; empty where the two are equal.
    """
    if all(getattr(model, name).equal(getattr(start, name)) for name in ("mean", "std")):
        return ""
    theirs, ours = (
        f"mean {network.config['mean']}, std {network.config['std']}" for network in (start, model)
    )
    if chosen:
        return f"weights: trained with images normalized by {theirs}; you chose {ours}"
    for name in ("mean", "std"):
        getattr(model, name).copy_(getattr(start, name))
        model.config[name] = list(start.config[name])
    return (
        f"weights: images are normalized as in their training, {theirs}; normalization={{mean, std}} "
        "overrides it"
    )


def write_normalization(folder: Path, choice: str | Mapping[str, Any], chosen: Mapping[str, Any]) -> None:
    """Store what "dataset" measured in the run folder."""
    if choice == "dataset":
        write_json(folder / FILE, {**chosen, "frames": f"at most {FRAMES} of the training split"})


def _three(name: str, values: Sequence[float]) -> list[float]:
    numbers = [float(v) for v in values] if isinstance(values, Sequence) and None not in values else []
    low = 0.0 if name == "mean" else 1e-6
    if len(numbers) != 3 or not all(math.isfinite(v) and low <= v <= 1 for v in numbers):
        raise ValueError(f"normalization {name}={values}: give three numbers, RGB in [0, 1], std above 0")
    return numbers

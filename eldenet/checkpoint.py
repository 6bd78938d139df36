"""Checkpoints: all state of a training as tensors and plain values, written so that a kill can't spoil one."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

LAST, BEST = "last.pt", "best.pt"


def save_checkpoint(path: Path, state: Mapping[str, Any]) -> None:
    """Write ``state`` to ``path`` at once: a reader finds the old file or the new one, never half of one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    with unfinished.open("wb") as file:
        torch.save(dict(state), file)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def load_checkpoint(path: str | Path) -> dict[str, Any]:
    """Read a checkpoint that :func:`save_checkpoint` wrote; nothing in it is executed.

    Args:
        path: the file, or a run folder, whose ``checkpoints/last.pt`` is taken.

    Raises:
        FileNotFoundError: no such file.
        ValueError: the file is no checkpoint of ours, or is damaged.
    """
    path = Path(path)
    path = path / "checkpoints" / LAST if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint at {path}: give checkpoints/last.pt of a run, or its run folder")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for a damaged or foreign file
        raise ValueError(f"{path} can't be read as a checkpoint ({type(error).__name__}: {error})") from error
    if not isinstance(state, dict) or "progress" not in state:
        raise ValueError(f"{path} is no training checkpoint of eldenet: it has no entry 'progress'")
    return state


def is_finite(tensors: Mapping[str, Tensor]) -> bool:
    """Whether every floating tensor is free of NaN and infinity."""
    floats = [tensor for tensor in tensors.values() if tensor.is_floating_point()]
    return all(bool(torch.isfinite(tensor).all()) for tensor in floats)

"""Checkpoints: all state of a training as tensors and plain values, safe against a kill while writing."""

import functools
import io
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from eldenet.backbones.weights import read_torch
from eldenet.results.fingerprints import differences
from eldenet.system.errors import reading
from eldenet.system.files import copy_file, parse_json, part_file
from eldenet.training.resume import OWN_CHECKPOINT, checkpoint_file, run_folder

LAST, BEST = OWN_CHECKPOINT.name, "best.pt"
RESUME_ADVICE = "resume from another checkpoint, such as best.pt beside it, or train again"


@dataclass
class Progress:
    """How far a training has come; part of every checkpoint, plain values only."""

    epoch: int = 0  # epochs that are done
    batch: int = 0  # batches of the running epoch that are done
    step: int = 0  # optimizer updates so far
    best_epoch: int = -1
    best_value: float = math.nan
    sums: dict[str, float] = field(default_factory=dict)  # of the losses of this epoch's batches
    history: list[dict[str, float]] = field(default_factory=list)
    seconds: float = 0.0  # spent in training steps, resumed runs included
    waited: float = 0.0  # [s] for batches, start of the workers included


@dataclass
class TrainingState:
    """Everything that a training needs to resume as if it had never stopped.

    Attributes:
        model: the network, not wrapped.
        ema: its averaged copy, or None.
        optimizer: as prepared for the device.
        scheduler: of the learning rate.
        loss: its own parameters, if any (projections of a distillation; never a teacher).
        scaler: of fp16 gradients, or None.
        progress: how far it has come.
        identity: what must agree for a checkpoint to fit (model config, data, seed, optimizer, monitor ...).
    """

    model: nn.Module
    ema: nn.Module | None
    optimizer: Any
    scheduler: Any
    loss: nn.Module
    scaler: Any
    progress: Progress
    identity: Mapping[str, Any]

    def save(self, path: Path) -> None:
        """Write all of it.

        Raises:
            FloatingPointError: a weight is NaN or infinite; the file that stood there stays.
        """
        self.refuse_broken()
        state = {
            "model": self.model.state_dict(),
            "ema": None if self.ema is None else self.ema.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "scheduler": self.scheduler.state_dict(),
            "loss": self.loss.state_dict(),
            "scaler": None if self.scaler is None else self.scaler.state_dict(),
            "progress": asdict(self.progress),
            "identity": json.dumps(self.identity, sort_keys=True, default=str),
            "torch_rng": torch.get_rng_state(),
            # of this process's device: as on the CPU, all processes go on with the first one's
            "cuda_rng": torch.cuda.get_rng_state() if torch.cuda.is_initialized() else None,
        }
        save_checkpoint(path, state)

    def refuse_broken(self) -> None:
        """Raise FloatingPointError where a weight is NaN or infinite."""
        if not all(torch.isfinite(tensor).all() for tensor in self.model.state_dict().values()):
            raise FloatingPointError(
                f"the weights are not finite at step {self.progress.step}; the last good "
                "checkpoint was kept. Try a lower optimizer.lr or trainer.max_grad_norm=1"
            )

    def restore(self, path: Path, *, epochs: int, batches: int) -> str:
        """Load everything from a checkpoint file or run folder.

        Returns:
            A note for the user where the result may differ in the last digits; else "".

        Raises:
            FileNotFoundError: there is none.
            ValueError: it is damaged, or belongs to another training.
        """
        state = load_checkpoint(path)
        with reading(path, "training checkpoint of eldenet", RESUME_ADVICE):
            theirs = parse_json(state["identity"], "its identity")
        ours = json.loads(json.dumps(self.identity, sort_keys=True, default=str))
        different = differences(ours, theirs)
        if different:
            raise ValueError(
                f"{path} belongs to another training: {'; '.join(different)}. Resume with the settings of "
                "its run: config.yaml in its run folder"
            )
        with reading(path, "training checkpoint of eldenet", RESUME_ADVICE):
            progress = _checked_progress(state["progress"], epochs, batches)
            self._load(state)
        for name, value in progress.items():
            setattr(self.progress, name, value)
        threads = [identity["threads"] for identity in (theirs, ours)]
        if threads[0] == threads[1]:
            return ""
        return (
            f"note: this run used {threads[0]} threads so far and now uses {threads[1]}: sums are rounded in "
            f"another order, so the last digits change (runtime.threads={threads[0]} keeps them)"
        )

    def _load(self, state: Mapping[str, Any]) -> None:
        self.model.load_state_dict(state["model"])
        if self.ema is not None:
            self.ema.load_state_dict(state["ema"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.scheduler.load_state_dict(state["scheduler"])
        self.loss.load_state_dict(state["loss"])
        if self.scaler is not None and state["scaler"] is not None:
            self.scaler.load_state_dict(state["scaler"])
        torch.set_rng_state(state["torch_rng"])
        if state["cuda_rng"] is not None and torch.cuda.is_initialized():
            torch.cuda.set_rng_state(state["cuda_rng"])


def _checked_progress(stored: Mapping[str, Any], epochs: int, batches: int) -> dict[str, Any]:
    """Return the values of a stored :class:`Progress` whose types are right and which lie in the training."""
    fresh = asdict(Progress())
    found = {name: stored[name] for name in fresh}
    for name, value in found.items():
        wanted = (int, float) if isinstance(fresh[name], float) else type(fresh[name])
        if isinstance(value, bool) or not isinstance(value, wanted):
            raise ValueError(f"progress.{name} is {value!r}")
    limits = {"epoch": epochs, "batch": batches, "step": epochs * batches, "best_epoch": epochs}
    for name, most in limits.items():
        if not -1 <= found[name] <= most:
            raise ValueError(f"progress.{name} is {found[name]}, but this training has {most}")
    return found


def described(factory: Callable[..., Any]) -> dict[str, Any]:
    """Name and options of what a factory makes, in plain values, so that checkpoints can be compared."""
    function = factory.func if isinstance(factory, functools.partial) else factory
    options = factory.keywords if isinstance(factory, functools.partial) else {}
    return {"name": getattr(function, "__name__", type(function).__name__)} | options


def bring_best(source: Path, folder: Path, progress: Progress) -> None:
    """Copy the best epoch of the run that ``source`` belongs to into the run folder ``folder``.

    The best epoch may lie before the checkpoint; the new run folder needs it too.

    Raises:
        FileNotFoundError: ``progress`` has a best epoch, but its weights are not beside ``source``.
    """
    old = run_folder(source).resolve()
    if progress.best_epoch > 0 and not (old / "model").is_dir():
        raise FileNotFoundError(
            f"the best epoch so far is {progress.best_epoch}, but its weights are not in {old / 'model'}: "
            "keep the checkpoint in its run folder and give that folder"
        )
    if old == folder.resolve():
        return
    brought = [old / OWN_CHECKPOINT.with_name(BEST), *sorted((old / "model").glob("[!.]*"))]
    for file in filter(Path.is_file, brought):
        copy_file(file, folder / file.relative_to(old))


def save_checkpoint(path: Path, state: Mapping[str, Any]) -> None:
    """Write ``state`` to ``path`` atomically: a reader finds the old file or the new one."""
    content = io.BytesIO()  # torch itself would not say that the disk is full
    torch.save(dict(state), content)
    with part_file(path) as unfinished, unfinished.open("wb") as file:
        file.write(content.getbuffer())
        file.flush()
        os.fsync(file.fileno())


def load_checkpoint(path: str | Path) -> dict[str, Any]:
    """Read a checkpoint that :func:`save_checkpoint` wrote; nothing in it is executed.

    A run folder stands for its ``checkpoints/last.pt``.

    Raises:
        FileNotFoundError: no such file.
        ValueError: the file is damaged or no checkpoint of eldenet.
    """
    path = checkpoint_file(path)
    state = read_torch(path)
    for entry in ("progress", "identity"):
        if not isinstance(state, dict) or entry not in state:
            raise ValueError(f"{path} is not a training checkpoint of eldenet: it has no entry {entry!r}")
    return state

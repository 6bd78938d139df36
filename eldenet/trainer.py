"""One visible training loop. To change a step, subclass :class:`Trainer` and write ``train_step``."""

import json
import math
import random
import shutil
import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eldenet.checkpoint import BEST, LAST, is_finite, load_checkpoint, save_checkpoint
from eldenet.data.base import DepthDataset
from eldenet.data.loading import collate, training_loader
from eldenet.evaluation import evaluate, predict_depth
from eldenet.losses.base import WeightedSum
from eldenet.metrics import LOWER_IS_BETTER, METRICS, EvalProtocol
from eldenet.model import DepthNet
from eldenet.resources import Resources
from eldenet.runlog import RunLog

CHECK_EVERY = 10  # steps between looks at the loss: each look makes the host wait for an accelerator


@dataclass
class Progress:
    """How far a training is; part of every checkpoint, plain values only."""

    epoch: int = 0  # the epoch that is running, or comes next
    batch: int = 0  # batches of that epoch that are done
    step: int = 0  # optimiser updates so far
    best_epoch: int = -1
    best_value: float = math.nan
    sums: dict[str, float] = field(default_factory=dict)  # of the losses of this epoch's batches
    history: list[dict[str, float]] = field(default_factory=list)
    seconds: float = 0.0  # spent training, over all sittings


class Trainer:
    """Trains a :class:`DepthNet`; on one device or several (``accelerate launch``, ``torchrun``).

    Args:
        optimizer: parameters -> optimiser.
        scheduler: (optimiser, total_steps, steps_per_epoch) -> schedule, stepped once per update.
        epochs: passes over the training set.
        batch_size: images per process and batch.
        accumulate: batches per update.
        gradient_clip: largest norm of the gradient; None: not clipped.
        ema_decay: decay per update of an exponential moving average of the weights, which is then what is
            evaluated and saved; None: none.
        channels_last: memory layout of images and weights.
        monitor: metric that chooses the best epoch.
        checkpoint_every: updates between step checkpoints (an epoch's end always writes one).
        evaluate_every: epochs between validations; the last epoch always has one.
        seed: of order, augmentation and anything random in the network.
    """

    def __init__(
        self,
        *,
        optimizer: Callable[..., torch.optim.Optimizer],
        scheduler: Callable[..., torch.optim.lr_scheduler.LRScheduler],
        epochs: int,
        batch_size: int = 32,
        accumulate: int = 1,
        gradient_clip: float | None = None,
        ema_decay: float | None = None,
        channels_last: bool = True,
        monitor: str = "delta1",
        checkpoint_every: int = 200,
        evaluate_every: int = 1,
        seed: int = 0,
    ) -> None:
        if monitor not in METRICS:
            raise ValueError(f"monitor={monitor!r}: choose one of {METRICS}")
        for name, value in {"epochs": epochs, "batch_size": batch_size, "accumulate": accumulate}.items():
            if value < 1:
                raise ValueError(f"{name}={value}: 1 or more is needed")
        self.make_optimizer, self.make_scheduler = optimizer, scheduler
        self.epochs, self.batch_size, self.accumulate = epochs, batch_size, accumulate
        self.gradient_clip, self.ema_decay, self.channels_last = gradient_clip, ema_decay, channels_last
        self.monitor, self.checkpoint_every, self.evaluate_every = monitor, checkpoint_every, evaluate_every
        self.seed = seed

    # ------------------------------------------------------------------ the loop

    def fit(
        self,
        model: DepthNet,
        train_set: DepthDataset,
        val_set: DepthDataset,
        loss: WeightedSum,
        protocol: EvalProtocol,
        folder: Path,
        resources: Resources,
        *,
        ckpt_path: str | Path | None = None,
    ) -> Progress:
        """Train; the best epoch's weights end in ``folder/model``, all state in ``folder/checkpoints``.

        Args:
            model: trained in place.
            train_set: augmented.
            val_set: scored after every epoch.
            loss: what is minimised.
            protocol: of the validation.
            folder: of the run.
            resources: device, precision, threads and workers.
            ckpt_path: checkpoint to go on from; the result is that of an uninterrupted run.

        Raises:
            FloatingPointError: the loss became NaN or infinite; the last good checkpoint stays.
        """
        self._set_up(model, train_set, val_set, loss, protocol, folder, resources, ckpt_path)
        progress, loader = self.progress, self.loader
        for epoch in range(progress.epoch, self.epochs):
            loader.batch_sampler.epoch, loader.batch_sampler.start = epoch, progress.batch
            self.model.train()
            batches = loader.batch_sampler.batches
            with self.log.bar(
                f"epoch {epoch + 1}/{self.epochs}", batches * self.batch_size, progress.batch * self.batch_size
            ) as bar:
                for batch in loader:
                    started = time.monotonic()
                    progress.batch += 1
                    update = progress.batch % self.accumulate == 0 or progress.batch == batches
                    terms = self.train_step(self._to_device(batch), update=update)
                    self._collect(terms)
                    progress.step += update
                    progress.seconds += time.monotonic() - started
                    if update and progress.step % self.checkpoint_every == 0 and progress.batch < batches:
                        self._save(LAST)
                    bar.advance(len(batch["name"]), f"loss {self._mean_loss():.4f}")
            self._end_epoch(epoch)
        self.log.close()
        return progress

    def train_step(self, batch: dict[str, Any], *, update: bool) -> dict[str, Tensor]:
        """Forward, loss, backward and, if ``update``, one step of the optimiser.

        Returns:
            The detached loss terms by name, ``total`` first.
        """
        prediction = self.model(batch["image"])
        total, terms = self.loss(prediction, batch["depth"], batch["mask"])
        self.accelerator.backward(total / self.accumulate)
        if update:
            if self.gradient_clip is not None:
                self.accelerator.clip_grad_norm_(self.model.parameters(), self.gradient_clip)
            self.optimizer.step()
            self.optimizer.zero_grad(set_to_none=True)
            self.scheduler.step()
            self._average_weights()
        return {"total": total.detach()} | {name: value.detach() for name, value in terms.items()}

    # ------------------------------------------------------------------ before

    def _set_up(
        self,
        model: DepthNet,
        train_set: DepthDataset,
        val_set: DepthDataset,
        loss: WeightedSum,
        protocol: EvalProtocol,
        folder: Path,
        resources: Resources,
        ckpt_path: str | Path | None,
    ) -> None:
        seed_everything(self.seed)
        self.accelerator = make_accelerator(resources)
        self.rank, self.processes = self.accelerator.process_index, self.accelerator.num_processes
        self.folder, self.protocol, self.val_set = folder, protocol, val_set
        self.loss = loss.to(self.accelerator.device)
        if self.channels_last:
            model.to(memory_format=torch.channels_last)
        self.bare_model = model
        self.loader = training_loader(
            train_set,
            self.batch_size,
            seed=self.seed,
            workers=resources.workers,
            rank=self.rank,
            processes=self.processes,
            pin_memory=resources.device == "cuda",
        )
        steps_per_epoch = math.ceil(self.loader.batch_sampler.batches / self.accumulate)
        optimizer = self.make_optimizer(model.parameters())
        self.model, self.optimizer = self.accelerator.prepare(model, optimizer)
        self.scheduler = self.make_scheduler(optimizer, self.epochs * steps_per_epoch, steps_per_epoch)
        self.ema = deepcopy(model).eval().requires_grad_(False) if self.ema_decay else None
        self.progress = Progress()
        self.unchecked: list[tuple[int, dict[str, Tensor]]] = []
        self.fingerprint = json.dumps(
            {
                "model": model.config,
                "train": train_set.split_hash,
                "seed": self.seed,
                "batch_size": self.batch_size * self.processes,
                "accumulate": self.accumulate,
                "epochs": self.epochs,
            },
            sort_keys=True,
        )
        if ckpt_path is not None:
            self._resume(Path(ckpt_path))
        self.log = RunLog(
            folder, quiet=not self.accelerator.is_main_process, first_step=self.progress.step
        )

    def _to_device(self, batch: dict[str, Any]) -> dict[str, Any]:
        device = self.accelerator.device
        layout = torch.channels_last if self.channels_last else torch.contiguous_format
        moved = {
            name: value.to(device, non_blocking=True) if isinstance(value, Tensor) else value
            for name, value in batch.items()
        }
        moved["image"] = moved["image"].contiguous(memory_format=layout)
        return moved

    # ------------------------------------------------------------------ during

    def _average_weights(self) -> None:
        if self.ema is None or self.ema_decay is None:
            return
        # young averages follow faster, or the random start would be remembered for 1 / (1 - decay) steps
        decay = min(self.ema_decay, (1 + self.progress.step) / (10 + self.progress.step))
        with torch.no_grad():
            for mean, value in zip(self.ema.parameters(), self.bare_model.parameters(), strict=True):
                mean.lerp_(value, 1 - decay)
            for mean, value in zip(self.ema.buffers(), self.bare_model.buffers(), strict=True):
                mean.copy_(value)

    def _collect(self, terms: dict[str, Tensor]) -> None:
        self.unchecked.append((self.progress.step, terms))
        if len(self.unchecked) >= CHECK_EVERY or self.accelerator.device.type == "cpu":
            self._check_losses()

    def _check_losses(self) -> None:
        """Add the waiting losses up; stop if one of them is not finite."""
        for step, terms in self.unchecked:
            for name, value in terms.items():
                number = float(value)
                if not math.isfinite(number):
                    kept = self.folder / "checkpoints" / LAST
                    raise FloatingPointError(
                        f"loss term '{name}' is {number} at step {step}. "
                        + (f"The last good checkpoint is {kept}. " if kept.is_file() else "")
                        + "Try a lower optimizer.lr, trainer.gradient_clip=1, or runtime.precision=fp32"
                    )
                self.progress.sums[name] = self.progress.sums.get(name, 0.0) + number
        self.unchecked.clear()

    def _mean_loss(self) -> float:
        checked = max(1, self.progress.batch - len(self.unchecked))
        return self.progress.sums.get("total", 0.0) / checked

    # ------------------------------------------------------------------ after an epoch

    def _end_epoch(self, epoch: int) -> None:
        self._check_losses()
        progress = self.progress
        losses = {f"train_{name}": value / progress.batch for name, value in progress.sums.items()}
        row: dict[str, float] = {"epoch": epoch + 1, "step": progress.step, "lr": self.scheduler.get_last_lr()[0]}
        row |= losses
        progress.epoch, progress.batch, progress.sums = epoch + 1, 0, {}
        better = False
        if (epoch + 1) % self.evaluate_every == 0 or epoch + 1 == self.epochs:
            metrics = self._validate()
            row |= {f"val_{name}": metrics[name] for name in METRICS}
            better = self._is_better(metrics[self.monitor])
            if better:
                progress.best_epoch, progress.best_value = epoch + 1, metrics[self.monitor]
        progress.history.append(row)
        self.log.scalars(progress.step, {name.replace("_", "/", 1): value for name, value in row.items()})
        self.log.history(progress.history)
        shown = "  ".join(
            f"{name} {row[name]:.4f}"
            for name in ("train_total", "val_delta1", "val_abs_rel", "val_rmse")
            if name in row
        )
        self.log.say(f"epoch {epoch + 1:3d}/{self.epochs}  {shown}{'  *' if better else ''}")
        if better:
            self._save(BEST)
            if self.accelerator.is_main_process:
                self._best_candidate().save_pretrained(self.folder / "model", info=self._info())
        self._save(LAST)

    def _best_candidate(self) -> DepthNet:
        return self.bare_model if self.ema is None else self.ema

    def _info(self) -> dict[str, Any]:
        return {
            "protocol": self.protocol.name,
            "epoch": self.progress.best_epoch,
            self.monitor: self.progress.best_value,
            "trained_on": type(self.loader.dataset).__name__,
            "train_split_hash": self.loader.dataset.split_hash,
        }

    def _validate(self) -> dict[str, float]:
        model = self._best_candidate()
        with self.log.bar("validation", len(self.val_set)) as bar:
            result = evaluate(
                model,
                self.val_set,
                self.protocol,
                device=self.accelerator.device,
                batch_size=self.batch_size,
                rank=self.rank,
                processes=self.processes,
                advance=bar.advance,
            )
        if self.accelerator.is_main_process:
            self.log.picture("validation", self.progress.step, sample_rows(model, self.val_set, self.protocol))
        return result.metrics

    def _is_better(self, value: float) -> bool:
        best = self.progress.best_value
        if math.isnan(best):
            return True
        return value < best if self.monitor in LOWER_IS_BETTER else value > best

    # ------------------------------------------------------------------ checkpoints

    def _save(self, name: str) -> None:
        self._check_losses()
        if not self.accelerator.is_main_process:
            return
        weights = self.bare_model.state_dict()
        if not is_finite(weights):
            raise FloatingPointError(
                f"the weights are not finite at step {self.progress.step}; no checkpoint was written over the "
                "last good one. Try a lower optimizer.lr or trainer.gradient_clip=1"
            )
        scaler = self.accelerator.scaler
        state = {
            "model": weights,
            "ema": None if self.ema is None else self.ema.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "scheduler": {"last_epoch": self.scheduler.last_epoch},
            "scaler": None if scaler is None else scaler.state_dict(),
            "progress": asdict(self.progress),
            "fingerprint": self.fingerprint,
            "torch_rng": torch.get_rng_state(),
        }
        save_checkpoint(self.folder / "checkpoints" / name, state)

    def _resume(self, path: Path) -> None:
        state = load_checkpoint(path)
        if state["fingerprint"] != self.fingerprint:
            raise ValueError(
                f"{path} belongs to another training. It was\n  {state['fingerprint']}\nand this one is\n  "
                f"{self.fingerprint}\nResume with the settings of its run (config.yaml in the run folder)"
            )
        self.bare_model.load_state_dict(state["model"])
        if self.ema is not None:
            self.ema.load_state_dict(state["ema"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.scheduler.last_epoch = state["scheduler"]["last_epoch"]
        self.scheduler.step(self.scheduler.last_epoch)
        if self.accelerator.scaler is not None and state["scaler"] is not None:
            self.accelerator.scaler.load_state_dict(state["scaler"])
        torch.set_rng_state(state["torch_rng"])
        self.progress = Progress(**state["progress"])
        old = (path if path.is_dir() else path.parent.parent).resolve()
        if old != self.folder.resolve() and self.accelerator.is_main_process:
            self._bring_best(old)

    def _bring_best(self, old: Path) -> None:
        """A best epoch that lies before the resumed one must be found in the new run folder too."""
        if (old / "checkpoints" / BEST).is_file():
            (self.folder / "checkpoints").mkdir(parents=True, exist_ok=True)
            shutil.copy2(old / "checkpoints" / BEST, self.folder / "checkpoints" / BEST)
        if (old / "model").is_dir():
            shutil.copytree(old / "model", self.folder / "model", dirs_exist_ok=True)


def make_accelerator(resources: Resources) -> Any:
    """Accelerate's device, autocast and DDP for these resources."""
    from accelerate import Accelerator
    from accelerate.state import AcceleratorState

    AcceleratorState._reset_state(reset_partial_state=True)  # an earlier run of this process chose its own
    precision = {"fp32": "no"}.get(resources.precision, resources.precision)
    return Accelerator(mixed_precision=precision, cpu=resources.device == "cpu")


def seed_everything(seed: int) -> None:
    """Seed Python, numpy and torch; ask for repeatable algorithms."""
    random.seed(seed)
    np.random.seed(seed % 2**32)
    torch.manual_seed(seed)
    torch.backends.cudnn.benchmark = False
    torch.use_deterministic_algorithms(True, warn_only=True)


def sample_rows(model: nn.Module, dataset: DepthDataset, protocol: EvalProtocol, rows: int = 4) -> np.ndarray:
    """Image / ground truth / prediction / error of ``rows`` fixed frames spread over ``dataset``: ``(H, W, 3)``."""
    from eldenet.pictures import depth_row, stack_rows

    device = next(model.parameters()).device
    was_training = model.training
    model.eval()
    pictures = []
    for index in range(0, len(dataset), max(1, len(dataset) // rows))[:rows]:
        batch: dict[str, Any] = collate([dataset[index]])
        prediction = predict_depth(model, batch["image"].to(device)).cpu()
        counts = protocol.scored(batch["depth"], batch["mask"])
        prediction = protocol.prepare(prediction, batch["depth"], counts)
        pictures.append(depth_row(batch["image"][0], batch["depth"][0], batch["mask"][0], prediction[0]))
    model.train(was_training)
    return stack_rows(pictures)

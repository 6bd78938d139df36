"""One visible training loop. To change a step, subclass :class:`Trainer` and override ``train_step``."""

import copy
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.optim.lr_scheduler import ReduceLROnPlateau

from eldenet.data.base import DepthDataset
from eldenet.data.loaders import EpochSampler, batches_on, evaluation_loader, training_loader
from eldenet.evaluation.cost import device_of
from eldenet.evaluation.evaluator import evaluate_batches, picture_of_samples
from eldenet.evaluation.metric_names import LOWER_IS_BETTER, METRICS
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.geometry import focal_ratio
from eldenet.losses.base import LossInputs, WeightedSum, masked_mean
from eldenet.model import DepthNet
from eldenet.results.loggers import LOGGERS
from eldenet.results.run_log import RunLog
from eldenet.system.checks import at_least, one_of
from eldenet.system.files import displayed
from eldenet.system.resources import Resources, make_accelerator, repeatable, seed_everything
from eldenet.system.signals import GracefulStop
from eldenet.training.checkpoint import BEST, LAST, Progress, TrainingState, bring_best, described
from eldenet.training.cuda_graph import GraphedStep
from eldenet.training.ema import WeightAverage, average_gradients
from eldenet.training.loss_meter import BLANK, LossMeter, timed
from eldenet.training.optim import build_optimizer, frozen_parts, fused
from eldenet.training.profile import TRACE, Profile

# settings of a trainer that must agree when a training resumes
SIGNATURE = (
    "monitor",
    "seed",
    "accumulate_grad_batches",
    "epochs",
    "backbone_lr_factor",
    "ema_decay",
    "freeze",
    "sync_batchnorm",
    "aspect_ratios",
)
IMPLEMENTATION = ("foreach", "fused", "capturable")  # of an optimizer: how it computes, not what
#: Column of history.csv -> its name in the line of an epoch; all but the loss are of the validation frames.
SHOWN = {"train_total": "loss", "val_delta1": "delta1", "val_abs_rel": "abs_rel", "val_rmse": "rmse"}


class TrainingData(NamedTuple):
    """The frames of a training and the rules of its validation.

    Attributes:
        train: augmented.
        val: scored after every epoch.
        protocol: by which ``val`` is scored.
    """

    train: DepthDataset
    val: DepthDataset
    protocol: EvalProtocol


@dataclass(kw_only=True, eq=False, repr=False)
class Trainer:
    """Train a :class:`DepthNet` on one device or several (``accelerate launch``, ``torchrun``).

    Args:
        optimizer: parameters -> optimizer.
        scheduler: (optimizer, total_steps, steps_per_epoch) -> schedule, stepped once per update; a
            ``ReduceLROnPlateau`` follows ``monitor``, once per validation.
        epochs: passes over the training set.
        patience: validations without a better ``monitor`` after which the training ends; None: it has all
            epochs.
        batch_size: images per process and batch.
        aspect_ratios: width / height of batches: each draws one and shows such parts of its frames; empty:
            whole frames at the data's ``input_size``.
        accumulate_grad_batches: batches per update.
        max_grad_norm: gradients are clipped to this norm; None: not clipped.
        backbone_lr_factor: learning rate of the backbone, relative to the optimizer's.
        freeze: parts of the network, such as ``["backbone"]``, that do not learn: their weights and BatchNorm
            statistics stay. "batchnorm": every BatchNorm.
        ema_decay: decay of an exponential moving average of the weights, which is then evaluated and saved;
            None: no average.
        sync_batchnorm: BatchNorm takes its statistics from the batches of all processes, which must be on
            GPUs; otherwise each process has its own.
        monitor: metric that decides which epoch is the best.
        loss_camera: for a network with ``canonical_px``: the loss compares depth in meters of the
            "canonical" camera, or of each frame's "own" camera.
        checkpoint_every: updates between step checkpoints (an epoch's end always writes one).
        evaluate_every: epochs between validations; the last epoch always has one.
        seed: of frame order, augmentation and anything random in the network.
        deterministic: the same result each time, at the cost of speed on a GPU; None: on a CPU, where it is
            free. Without it, cuDNN tries which kernels are fastest.
        compile: ``torch.compile`` network and loss: a slow start, then faster steps.
        cuda_graph: replay a step of one GPU as a CUDA graph of its shape, for small networks and batches.
        profile: write a trace of a few steps, and print where the time went.
        loggers: names of :data:`~eldenet.results.loggers.LOGGERS`, which get the curves and pictures.
    """

    optimizer: Any  # from fit on, as the scheduler, what was made: train_step uses it
    scheduler: Any
    epochs: int
    patience: int | None = None
    batch_size: int = 32
    aspect_ratios: Sequence[float] = ()
    accumulate_grad_batches: int = 1
    max_grad_norm: float | None = None
    backbone_lr_factor: float = 1.0
    freeze: Sequence[str] = ()
    ema_decay: float | None = None
    channels_last: bool = True
    sync_batchnorm: bool = False
    monitor: str = "delta1"
    checkpoint_every: int = 200
    evaluate_every: int = 1
    seed: int = 0
    loss_camera: str = "canonical"
    deterministic: bool | None = None
    compile: bool = False
    cuda_graph: bool = False
    profile: bool = False
    loggers: Sequence[str] = ("tensorboard",)

    def __post_init__(self) -> None:
        for logger in self.loggers:
            one_of("logger", logger, tuple(LOGGERS))
        one_of("loss_camera", self.loss_camera, ("canonical", "own"))
        one_of("monitor", self.monitor, METRICS)
        at_least(1, epochs=self.epochs, patience=self.patience, evaluate_every=self.evaluate_every)
        at_least(1, batch_size=self.batch_size, accumulate_grad_batches=self.accumulate_grad_batches)
        at_least(1, checkpoint_every=self.checkpoint_every)
        if self.max_grad_norm is not None and not self.max_grad_norm > 0:
            raise ValueError(
                f"max_grad_norm={self.max_grad_norm}: give a number above 0, or null for no clipping"
            )
        if self.cuda_graph and (self.profile or self.accumulate_grad_batches > 1):
            raise ValueError(
                "trainer.cuda_graph=true replays an update as one piece: it needs accumulate_grad_batches=1 "
                "and profile=false"
            )
        if not all(0.2 <= ratio <= 5 for ratio in self.aspect_ratios):
            raise ValueError(f"aspect_ratios={list(self.aspect_ratios)}: give width / height, 0.2 to 5")
        self.make_optimizer, self.make_scheduler = self.optimizer, self.scheduler
        self._criterion: Callable[..., Any]  # the loss, compiled or not

    def fit(
        self,
        model: DepthNet,
        loss: WeightedSum,
        data: TrainingData,
        folder: Path,
        resources: Resources,
        *,
        ckpt_path: str | Path | None = None,
        info: dict[str, Any] | None = None,
        sources: Mapping[str, str | None] | None = None,
    ) -> Progress:
        """Train; write the best epoch's weights to ``folder/model`` and all state to ``folder/checkpoints``.

        Args:
            model: trained in place.
            ckpt_path: checkpoint to resume; the result is that of an uninterrupted run.
            info: facts to store beside the weights, in ``config.json``.
            sources: fingerprints of the weights and teachers in use; a resumed training must have the same.

        Raises:
            FloatingPointError: the loss became NaN or infinite; the last good checkpoint stays.
            ValueError: no pixel of an epoch or of the validation is known, or no epoch is the best one.
        """
        self.info, self.sources = info or {}, dict(sources or {})
        self._set_up(model, loss, data, folder, resources, ckpt_path)
        progress = self.progress
        self.log.say(self._plan())
        with GracefulStop() as stop:
            for epoch in range(progress.epoch, self.epochs):
                if self._waited_enough():
                    self.log.say(f"ends here: no better {self.monitor} in {self.patience} validations")
                    break
                self._train_epoch(epoch, stop)
                if stop and progress.batch < self.sampler.batches:
                    self._stop(stop)
                self._end_epoch(epoch)
                if stop:
                    self._stop(stop)
        self._say_times()
        self.log.close()
        repeatable(True)
        del self.loader, self.val_loader  # their workers end with them
        if progress.best_epoch < 1:
            raise ValueError(
                f"trainer.monitor={self.monitor} was NaN in every validation, so no epoch is the best one: "
                "choose another metric, such as delta1"
            )
        return progress

    def _train_epoch(self, epoch: int, stop: GracefulStop) -> None:
        """Show the network the rest of an epoch; end early, after an update, if a signal arrived."""
        progress, batches = self.progress, self.sampler.batches
        self.sampler.epoch, self.sampler.start = epoch, progress.batch
        self.model.train()
        for part in self.frozen:
            part.eval()
        with self.log.bar(
            f"epoch {epoch + 1}/{self.epochs}",
            batches * self.batch_size,
            progress.batch * self.batch_size,
        ) as bar:
            device = self.accelerator.device
            batches_here = batches_on(device, self.loader, channels_last=self.channels_last)
            for batch in timed(batches_here, progress):
                started = time.monotonic()
                progress.batch += 1
                update = progress.batch % self.accumulate_grad_batches == 0 or progress.batch == batches
                terms = self.train_step(batch, update=update) if self.graph is None else self.graph(batch)
                self.meter.add(progress.step, terms | {BLANK: ~batch["mask"].any()})
                if update:
                    self._after_update()
                    if self.times is not None:
                        self.times.step()
                progress.step += update
                progress.seconds += time.monotonic() - started
                if update and progress.step % self.checkpoint_every == 0 and progress.batch < batches:
                    self._save(LAST)
                mean = progress.sums.get("total", 0.0) / max(1, progress.batch - self.meter.unread)
                bar.advance(len(batch["name"]), f"loss {mean:.4f}")
                if stop and update:
                    return

    def _stop(self, stop: GracefulStop) -> None:
        """End as the signal asks; within an epoch save before, unless there are other processes."""
        if self.processes == 1 and self.progress.batch:  # 0 where the end of the epoch has just saved
            self._save(LAST)
        self.log.close()
        stop.obey()

    def _plan(self) -> str:
        """One line: updates of an epoch, and the frames that it does not show."""
        frames, batches = len(self.train_set), self.sampler.batches
        together = self.batch_size * self.processes
        updates = math.ceil(batches / self.accumulate_grad_batches)
        plural = "s" if updates > 1 else ""
        plan = f"{frames} frames, batch {self.effective_batch}: {updates} update{plural} an epoch"
        if left_out := self.sampler.left_out:
            plan += f", which leaves out {left_out} frames, others each time"
        elif frames < batches * together:
            plan += f", the last batch with {frames - (batches - 1) * together} frames"
        return plan

    @property
    def effective_batch(self) -> int:
        """Images per update, of all processes."""
        return self.batch_size * self.processes * self.accumulate_grad_batches

    def train_step(self, batch: dict[str, Any], *, update: bool) -> dict[str, Tensor]:
        """Forward, loss, backward and, if ``update``, one step of the optimizer.

        Nothing in it waits for a GPU. The schedule and the average of the weights follow after it.

        Returns:
            The detached loss terms by name, ``total`` first, ``mse`` [m²], which is only watched, and
            ``grad_norm`` of an update, times its batches.
        """
        batches = self._batches_of_this_update()
        # DDP adds up the gradients of all processes once per update
        with nullcontext() if update else self.accelerator.no_sync(self.model):
            with self.part("forward"), self.accelerator.autocast():
                given = batch["image"], batch["intrinsics"][:, 0, 0]
                if self.loss.needs_spread:
                    prediction, spread = self._network(*given, with_spread=True)
                else:
                    prediction, spread = self._network(*given), None
            with self.part("loss"):
                total, terms = self._losses(batch, prediction, spread)
            with self.part("backward"):
                self.accelerator.backward(total / batches)
        if update:
            with self.part("optimizer"):
                average_gradients(self.loss, self.accelerator)  # DDP averages the model's
                terms["grad_norm"] = self._clip_gradients() * batches
                self.optimizer.step()
                self.optimizer.zero_grad(set_to_none=True)
        return {name: value.detach() for name, value in ({"total": total} | terms).items()}

    def _losses(
        self, batch: dict[str, Any], prediction: Tensor, spread: Tensor | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss, a scalar, and ``mse`` [m²] and the loss's terms by name."""
        depth, focal = batch["depth"], batch["intrinsics"][:, 0, 0]
        canonical_px, ratio = self.bare_model.canonical_px, None
        mse = squared_error(prediction.detach(), batch)
        if canonical_px is not None and self.loss_camera == "canonical":
            ratio = focal_ratio(focal, canonical_px)
            depth, prediction = depth / ratio, prediction / ratio
            focal = ratio.flatten() * canonical_px  # the canonical one where it is unknown
        relative = batch.get("relative")
        total, terms = self._criterion(
            LossInputs(prediction, depth, batch["mask"], batch["image"], focal, relative, spread, ratio)
        )
        return total, {"mse": mse} | terms

    def _clip_gradients(self) -> Tensor:
        """Clip to ``max_grad_norm``; return the norm before, 0 where fp16's scaler skips the update."""
        self.accelerator.unscale_gradients()
        parameters = [p for p in self.model.parameters() if p.grad is not None]
        norm = torch.nn.utils.get_total_norm([p.grad for p in parameters if p.grad is not None])
        if self.max_grad_norm is not None:
            torch.nn.utils.clip_grads_with_norm_(parameters, self.max_grad_norm, norm)
        return norm if self.accelerator.scaler is None else norm.nan_to_num(0.0, 0.0, 0.0)

    def _after_update(self) -> None:
        if self.compile and self._criterion is self.loss:  # it has its buffers now
            self._criterion = torch.compile(self.loss)
        if not isinstance(self.scheduler, ReduceLROnPlateau):
            self.scheduler.step()
        if self.average is not None:
            self.average.update(self.bare_model, self.progress.step)

    def part(self, name: str) -> AbstractContextManager[None]:
        """Time a block for ``profile``."""
        return nullcontext() if self.times is None else self.times.part(name)

    def _batches_of_this_update(self) -> int:
        """``accumulate_grad_batches``; fewer in the epoch's last update, which takes what is left."""
        earlier = (self.progress.batch - 1) // self.accumulate_grad_batches * self.accumulate_grad_batches
        return min(self.accumulate_grad_batches, self.sampler.batches - earlier)

    # ------------------------------------------------------------------ before

    def _set_up(
        self,
        model: DepthNet,
        loss: WeightedSum,
        data: TrainingData,
        folder: Path,
        resources: Resources,
        ckpt_path: str | Path | None,
    ) -> None:
        seed_everything(self.seed)
        self.accelerator = make_accelerator(resources)
        device = self.accelerator.device
        repeatable(device.type == "cpu" if self.deterministic is None else self.deterministic)
        self.rank, self.processes = self.accelerator.process_index, self.accelerator.num_processes
        self.train_set, self.val_set, self.protocol = data
        self.folder = folder
        if self.aspect_ratios and (self.protocol.changes_frames or self.train_set.input_size is None):
            raise ValueError(
                "trainer.aspect_ratios cuts parts out of whole frames: give data.input_size, and a protocol "
                f"that neither resizes nor crops frames, not {self.protocol.name}"
            )
        loss.setup(model, self.accelerator.autocast)
        self.loss = loss.to(device)
        if self.sync_batchnorm and self.processes > 1:
            synchronize_batchnorm(model, device)
        self.sampler = EpochSampler(
            len(self.train_set),
            self.batch_size,
            seed=self.seed,
            rank=self.rank,
            processes=self.processes,
            aspect_ratios=self.aspect_ratios,
        )
        if self.sampler.smallest_batch == 1 and not (self.sync_batchnorm and self.processes > 1):
            self._refuse_batch_of_one(model)
        model.to(device)
        if self.channels_last:
            model.to(memory_format=torch.channels_last)
        self.frozen = frozen_parts(model, self.freeze)
        self.loader = training_loader(
            self.train_set, self.sampler, workers=resources.workers, device=resources.device
        )
        self.val_loader = evaluation_loader(
            self.val_set,
            self.batch_size,
            workers=resources.workers,
            rank=self.rank,
            processes=self.processes,
        )
        steps_per_epoch = math.ceil(self.sampler.batches / self.accumulate_grad_batches)
        optimizer = build_optimizer(
            fused(self.make_optimizer) if device.type == "cuda" else self.make_optimizer,
            model,
            self.loss,
            backbone_lr_factor=self.backbone_lr_factor,
        )
        self.model, self.optimizer = self.accelerator.prepare(model, optimizer)
        if self.compile:  # anew for every shape; beyond its limit torch would go on without
            torch._dynamo.config.recompile_limit = 8 * max(1, len(self.aspect_ratios))
        self._network = torch.compile(self.model) if self.compile else self.model
        self._criterion = self.loss
        # without accelerate's autocast, which would stay on in validation; train_step has its own
        self.bare_model: DepthNet = self.accelerator.unwrap_model(self.model, keep_fp32_wrapper=False)
        self.scheduler = self.make_scheduler(optimizer, self.epochs * steps_per_epoch, steps_per_epoch)
        self.average: WeightAverage | None = (
            None if self.ema_decay is None else WeightAverage(model, self.ema_decay)
        )
        self.progress: Progress = Progress()
        self.state = TrainingState(
            model=model,
            ema=None if self.average is None else self.average.model,
            optimizer=self.optimizer,
            scheduler=self.scheduler,
            loss=self.loss,
            scaler=self.accelerator.scaler,
            progress=self.progress,
            identity={
                **{name: getattr(self, name) for name in SIGNATURE},
                "model": model.config,
                "training split": self.train_set.split_hash,
                "validation split": self.val_set.split_hash,
                "protocol": self.protocol.as_dict(),
                "batch_size": self.batch_size * self.processes,
                "processes": self.processes,
                "threads": resources.threads,
                "optimizer": {"class": type(optimizer).__name__}
                | {name: value for name, value in optimizer.defaults.items() if name not in IMPLEMENTATION},
                "scheduler": described(self.make_scheduler),
                "teacher": loss.signature,
                "precision": resources.precision,
                "sources": self.sources,
            },
        )
        note = ""
        if ckpt_path is not None:
            note = self.state.restore(Path(ckpt_path), epochs=self.epochs, batches=self.sampler.batches)
            if self.accelerator.is_main_process:
                bring_best(Path(ckpt_path), folder, self.progress)
        self.graph = self._graphed_step() if self.cuda_graph else None
        self.times = Profile(folder, device) if self.profile and self.accelerator.is_main_process else None
        self.meter = LossMeter(self.progress.sums, eager=device.type == "cpu")
        # an epoch's points lie at its last step: a resumed run keeps them
        self.log: RunLog = RunLog(
            folder,
            quiet=not self.accelerator.is_main_process,
            first_step=self.progress.step + 1,
            loggers=self.loggers,
        )
        if note:
            self.log.say(note)

    def _graphed_step(self) -> GraphedStep:
        """A :meth:`train_step` that is replayed; raises ValueError where it cannot be."""
        fits = (
            self.accelerator.device.type == "cuda" and self.processes == 1 and self.accelerator.scaler is None
        )
        if not fits:
            raise ValueError(
                "trainer.cuda_graph=true is for one GPU in bf16 or fp32: set it to false, or runtime.device="
                "cuda and runtime.precision=bf16"
            )
        return GraphedStep(lambda batch: self.train_step(batch, update=True), self.optimizer.optimizer)

    def _refuse_batch_of_one(self, model: DepthNet) -> None:
        """Raise ValueError if the network cannot train on one frame: BatchNorm of a map of 1 x 1 pixels."""
        with torch.random.fork_rng(devices=()):
            try:
                image = self.train_set[0, 0]["image"][None].to(device_of(model))
                copy.deepcopy(model).train()(image)
            except ValueError as error:
                if "more than 1 value per channel" not in str(error):
                    raise
                raise ValueError(
                    f"trainer.batch_size={self.batch_size} leaves a batch of one frame of "
                    f"{len(self.train_set)}, where this network's BatchNorm sees one value per channel: "
                    "give another trainer.batch_size, more frames, or larger ones"
                ) from error

    # ------------------------------------------------------------------ after an epoch

    def _end_epoch(self, epoch: int) -> None:
        self._average_sums()
        progress = self.progress
        self._say_blank(progress.sums.pop(BLANK, 0.0))
        losses = {f"train_{name}": value / progress.batch for name, value in progress.sums.items()}
        row: dict[str, float] = {
            "epoch": epoch + 1,
            "step": progress.step,
            "lr": float(self.scheduler.get_last_lr()[0]),
        }
        row |= losses
        progress.epoch, progress.batch = epoch + 1, 0
        progress.sums.clear()
        better = False
        if (epoch + 1) % self.evaluate_every == 0 or epoch + 1 == self.epochs:
            self.state.refuse_broken()
            with self.part("validation"):
                metrics = self._validate()
            if isinstance(self.scheduler, ReduceLROnPlateau):  # to it, smaller is better
                sign = 1 if self.monitor in LOWER_IS_BETTER else -1
                self.scheduler.step(sign * metrics[self.monitor])
            row |= {f"val_{name}": metrics[name] for name in METRICS}
            better = self._is_better(metrics[self.monitor])
            if better:
                progress.best_epoch, progress.best_value = epoch + 1, metrics[self.monitor]
        progress.history.append(row)
        self.log.scalars(progress.step, {name.replace("_", "/", 1): value for name, value in row.items()})
        self.log.history(progress.history)
        shown = "  ".join(
            f"{name} {row[key]:.4f}"  # a line of 80 columns
            for key, name in SHOWN.items()
            if key in row
        )
        self.log.say(f"epoch {epoch + 1:3d}/{self.epochs}  {shown}{'  best' if better else ''}")
        if better:
            self._save(BEST)
            if self.accelerator.is_main_process:
                self._best_candidate().save_pretrained(self.folder / "model", info=self._info())
        self._save(LAST)

    def _average_sums(self) -> None:
        """Read the losses; all processes go on with the mean of their sums."""
        self.meter.read()
        sums = self.progress.sums
        if sums and self.processes > 1:
            own = torch.tensor(list(sums.values()), dtype=torch.float64, device=self.accelerator.device)
            sums.update(zip(sums, self.accelerator.reduce(own, "mean").tolist(), strict=True))

    def _say_blank(self, blank: float) -> None:
        """Say how many batches of the epoch had no known pixel; raise ValueError if it was all of them."""
        if not blank or not self.loss.needs_depth:
            return
        batches = self.progress.batch
        if blank == batches:
            raise ValueError(
                "no pixel of the epoch's training frames has a known depth: check data.min_depth, "
                "data.max_depth and the unit of the depth files with eldenet check-data"
            )
        count = f"{blank * self.processes:.0f} of {batches * self.processes}"
        self.log.say(f"note: {count} batches of this epoch have no known pixel, so they teach nothing")

    def _best_candidate(self) -> DepthNet:
        return self.bare_model if self.average is None else self.average.model

    def _info(self) -> dict[str, Any]:
        return self.info | {
            "protocol": self.protocol.name,
            "epoch": self.progress.best_epoch,
            self.monitor: self.progress.best_value,
            "train_split_hash": self.train_set.split_hash,
        }

    def _validate(self) -> dict[str, float]:
        model = self._best_candidate()
        if self.processes > 1:
            # each process has its own BatchNorm statistics: score what is saved
            for buffer in model.buffers():
                torch.distributed.broadcast(buffer, 0)
        with self.log.bar("validation", len(self.val_set)) as bar:
            result = evaluate_batches(
                model,
                self.val_loader,
                self.protocol,
                device=self.accelerator.device,
                processes=self.processes,
                advance=bar.advance,
            )
        if self.accelerator.is_main_process:
            self.log.picture(
                "validation", self.progress.step, picture_of_samples(model, self.val_set, self.protocol)
            )
        return result.metrics

    def _waited_enough(self) -> bool:
        """Whether the last ``patience`` validations were no better than the best epoch."""
        validated = [row["epoch"] for row in self.progress.history if f"val_{self.monitor}" in row]
        later = sum(epoch > self.progress.best_epoch for epoch in validated)
        return self.patience is not None and later >= self.patience

    def _say_times(self) -> None:
        """Print the table of ``profile``."""
        if self.times is not None:
            self.times.seconds["data"] = self.progress.waited
            title = f"where the time went; a trace of some steps: {displayed(self.folder / TRACE)}"
            self.log.table(title, ("part", "seconds", "share", "ms a step"), self.times.close())

    def _is_better(self, value: float) -> bool:
        best = self.progress.best_value
        if math.isnan(value) or math.isnan(best):
            return not math.isnan(value)
        return value < best if self.monitor in LOWER_IS_BETTER else value > best

    def _save(self, name: str) -> None:
        self._average_sums()
        if self.accelerator.is_main_process:
            self.state.save(self.folder / "checkpoints" / name)


def squared_error(prediction: Tensor, batch: Mapping[str, Any]) -> Tensor:
    """Return the mean squared error [m²] over the pixels with metric depth; 0 if there are none."""
    known = batch["mask"]
    if "relative" in batch:
        known = known & ~batch["relative"].view(-1, 1, 1, 1)
    return masked_mean((prediction.float() - batch["depth"]) ** 2, known)


def synchronize_batchnorm(model: torch.nn.Module, device: torch.device) -> None:
    """Turn every BatchNorm of ``model`` into a SyncBatchNorm with the same weights, under the same names.

    Raises:
        ValueError: ``device`` is no GPU; torch has it for these alone.
    """
    if device.type != "cuda":
        raise ValueError("trainer.sync_batchnorm=true needs GPUs: on CPUs set it to false")
    torch.nn.SyncBatchNorm.convert_sync_batchnorm(model)

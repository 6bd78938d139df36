"""What the tests of training share."""

import hashlib
from functools import partial
from pathlib import Path

import torch

import eldenet
from eldenet.data.base import DepthDataset
from eldenet.data.transforms import Augmentation
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.system.resources import Resources, seed_everything
from eldenet.training.optim import cosine
from eldenet.training.trainer import Trainer, TrainingData
from support.synthetic import SyntheticDepth

PROTOCOL = EvalProtocol("synthetic", min_depth=0.1, ground_truth="dense")
ONE_THREAD = Resources(device="cpu", precision="fp32", threads=1, workers=0, cores=2)
TWO_WORKERS = Resources(device="cpu", precision="fp32", threads=1, workers=2, cores=3)


class Stopped(Exception):
    """Ends a training as a kill does."""


def stopping_at(call: int) -> type[Trainer]:
    """Return a class of trainers that stop instead of their ``call``-th step."""

    class StoppingTrainer(Trainer):
        calls = 0

        def train_step(self, batch, *, update):
            StoppingTrainer.calls += 1
            if StoppingTrainer.calls == call:
                raise Stopped
            return super().train_step(batch, update=update)

    return StoppingTrainer


def make_trainer(kind: type[Trainer] = Trainer, **options) -> Trainer:
    defaults = {
        "optimizer": partial(torch.optim.Adam, lr=3e-3),
        "scheduler": partial(cosine),
        "epochs": 2,
        "batch_size": 4,
    }
    return kind(**(defaults | options))


def fit(
    folder: Path,
    *,
    trainer: Trainer | None = None,
    data: DepthDataset | None = None,
    frames: int = 16,
    val_frames: int = 6,
    protocol: EvalProtocol = PROTOCOL,
    ckpt_path=None,
    resources: Resources = ONE_THREAD,
    sources: dict[str, str] | None = None,
    **options,
):
    """Train a tiny network; returns (trainer, model, progress)."""
    seed_everything(0)
    model = eldenet.load("eldenet_s").train()
    loss = WeightedSum({"l1": WeightedTerm(options.pop("loss", L1Loss())), **options.pop("terms", {})})
    transform = options.pop("transform", Augmentation(affine=0.0))
    train = SyntheticDepth(frames, transform=transform) if data is None else data
    trainer = trainer or make_trainer(**options)
    val = SyntheticDepth(val_frames)
    progress = trainer.fit(
        model,
        loss,
        TrainingData(train, val, protocol),
        folder,
        resources,
        ckpt_path=ckpt_path,
        sources=sources,
    )
    return trainer, model, progress


def digest(folder: Path) -> str:
    return hashlib.sha256((folder / "model" / "model.safetensors").read_bytes()).hexdigest()

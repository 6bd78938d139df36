"""Measure how fast frames load, cold and cached, beside torchvision, and how long training waits for them.

ELDENET_DATA=... python experiments/data_throughput/run.py

1. images/s of the training loader: the 665 labeled NYU training frames (480 x 640 JPEG and PNG) at 228 x 304
   with full augmentation, in batches of 32, with and without workers. Rows take turns, so that a drift of the
   machine affects all alike; figures are medians over rounds.
2. The trainer's own record of its wait for data and its time in steps, for ELDE-Net, by epoch.
"""

import itertools
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402
from torch.utils.data import DataLoader, Dataset  # noqa: E402

from eldenet.data.loaders import EpochSampler, training_loader  # noqa: E402
from eldenet.data.nyu import NYULabelled  # noqa: E402
from eldenet.data.transforms import Augmentation  # noqa: E402
from eldenet.data.workers import prepare_worker  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.system.resources import choose_resources  # noqa: E402

HERE = Path(__file__).parent
SIZE, BATCH, ROUNDS = (228, 304), 32, 12
FRAMES = 192  # of an epoch of the trainer
ROWS = ("torchvision v2", "cold", "disk")
FIELDS = ("loader", "workers", "images_per_s", "ratio_to_cold", "low", "high")


class TorchvisionNYU(Dataset):
    """The same files, sizes and kinds of augmentation in plain torchvision.transforms.v2."""

    def __init__(self, frames: NYULabelled) -> None:
        from torchvision.transforms import v2

        self.files = [frames.frame_files(index) for index in range(len(frames))]
        self.resize = v2.Resize(SIZE, antialias=True)
        smooth = v2.InterpolationMode.BILINEAR  # for the image; masks always use nearest
        move = v2.RandomAffine(5.0, translate=(0.05, 0.05), scale=(1.0, 1.3), interpolation=smooth)
        self.geometry = v2.Compose([v2.RandomHorizontalFlip(0.5), v2.RandomApply([move], 0.5)])
        jitter = v2.ColorJitter(brightness=0.2, contrast=0.2)
        whole = v2.ColorJitter(brightness=0.2, contrast=0.2, saturation=0.2)
        hue = v2.ColorJitter(brightness=0.04, saturation=0.08, hue=0.055)
        self.color = v2.Compose([v2.RandomApply([step], 0.3) for step in (jitter, whole, hue)])

    def __getitem__(self, key: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
        from torchvision import tv_tensors
        from torchvision.io import ImageReadMode, decode_image

        image, depth = (Path(file) for file in self.files[key[1]])
        picture = tv_tensors.Image(decode_image(str(image), ImageReadMode.RGB))
        mask = tv_tensors.Mask(decode_image(str(depth), ImageReadMode.GRAY))
        picture, mask = self.geometry(*self.resize(picture, mask))
        meters = (mask.float() + 0.5) * (9.99547 / 255) * (mask > 0)
        return self.color(picture).float() / 255, meters


def loader_of(row: str, workers: int) -> DataLoader:
    options: dict[str, Any] = {"input_size": SIZE, "resize_on_load": SIZE, "transform": Augmentation()}
    kind = "disk" if row == "disk" else "none"
    frames = NYULabelled(split="train", min_depth=0.1, cache=kind, **options)
    sampler = EpochSampler(len(frames), BATCH, seed=0)
    if row == "disk":
        for index in range(len(frames)):  # fill the cache; this is as slow as "cold"
            _ = frames[index]
    if row != "torchvision v2":
        return training_loader(frames, sampler, workers=workers)
    return DataLoader(
        TorchvisionNYU(frames),
        batch_sampler=sampler,
        num_workers=workers,
        persistent_workers=workers > 0,
        worker_init_fn=prepare_worker if workers else None,
        multiprocessing_context="forkserver" if workers else None,
    )


def endless(loader: DataLoader) -> Iterator[Any]:
    for epoch in itertools.count():
        loader.batch_sampler.epoch = epoch  # type: ignore[union-attr]
        yield from loader


def measure(workers: int) -> list[dict[str, object]]:
    """Measure the rows in turns: of a batch without workers, of an epoch with workers, which load ahead."""
    loaders = {row: loader_of(row, workers) for row in ROWS}
    seconds: dict[str, list[float]] = {row: [] for row in ROWS}
    if workers == 0:
        streams = {row: endless(loader) for row, loader in loaders.items()}
        for turn in range(ROUNDS + 1):
            for row, stream in streams.items():
                started = time.perf_counter()
                next(stream)
                if turn:  # the first one warms up
                    seconds[row].append(time.perf_counter() - started)
    else:
        for turn in range(ROUNDS // 3):
            for row, loader in loaders.items():
                loader.batch_sampler.epoch = turn  # type: ignore[union-attr]
                batches = iter(loader)
                next(batches)  # from here on, batches are taken as fast as the workers make them
                started = time.perf_counter()
                count = sum(1 for _ in batches)
                seconds[row].append((time.perf_counter() - started) / count)
    rows: list[dict[str, object]] = []
    for row in ROWS:
        ratios = [cold / own for cold, own in zip(seconds["cold"], seconds[row], strict=True)]
        middle = statistics.median(seconds[row])
        low, half, high = np.percentile(ratios, (25, 50, 75)).round(2).tolist()
        values = (row, workers, round(BATCH / middle), half, low, high)
        rows.append(dict(zip(FIELDS, values, strict=True)))
    return rows


def waits(cache: str, epochs: int = 3) -> list[tuple[float, float]]:
    """Return the seconds of waiting for data and of steps in each epoch, for the default network."""
    import eldenet
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.losses.base import WeightedSum, WeightedTerm
    from eldenet.losses.pointwise import L1Loss
    from eldenet.losses.ssim import SSIMLoss
    from eldenet.training.optim import constant
    from eldenet.training.trainer import Trainer, TrainingData

    marks = [(0.0, 0.0)]

    class Noting(Trainer):
        def _end_epoch(self, epoch: int) -> None:
            marks.append((self.progress.waited, self.progress.seconds))
            super()._end_epoch(epoch)

    options: dict[str, Any] = {"min_depth": 0.1, "input_size": SIZE, "resize_on_load": SIZE}
    train = NYULabelled(split="train", cache=cache, transform=Augmentation(), **options)
    train.draw_subset(FRAMES, seed=0)
    val = NYULabelled(split="val", min_depth=0.1, input_size=SIZE, resize_depth=False)
    val.draw_subset(BATCH, seed=0)
    trainer = Noting(
        optimizer=partial(torch.optim.Adam, lr=1e-3),
        scheduler=constant,
        epochs=epochs,
        batch_size=BATCH,
        evaluate_every=epochs,
    )
    loss = WeightedSum({"ssim": WeightedTerm(SSIMLoss()), "l1": WeightedTerm(L1Loss())})
    protocol = EvalProtocol("throughput", ground_truth="inpainted")
    model = eldenet.load("eldenet").train()
    resources = choose_resources(device="cpu")
    with tempfile.TemporaryDirectory() as folder:
        trainer.fit(model, loss, TrainingData(train, val, protocol), Path(folder), resources)
    return [(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(marks)]


def main() -> None:
    resources = choose_resources(device="cpu")
    where = environment()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ELDENET_CACHE"] = folder
        rows = measure(0) + measure(max(1, resources.workers))
        waited = {cache: waits(cache) for cache in ("none", "disk")}
    lines = [
        f"{where['hardware']['processor']}, {resources.cores} hardware threads, {resources.threads} of them "
        f"torch's, {where['date']}; versions {json.dumps(where['versions'])}.",
        "",
        f"NYU labeled, 665 frames, {SIZE[0]} x {SIZE[1]}, batch {BATCH}, full augmentation. The source "
        "files are in the operating system's memory, so cold means decoding, not a slow disk. Medians and "
        "quartiles of interleaved rounds.",
        "",
        "| loader | workers | images/s | over cold | quartiles |",
        "|---|---:|---:|---:|---|",
    ]
    lines += [f"| {' | '.join(map(str, list(r.values())[:4]))} | {r['low']} to {r['high']} |" for r in rows]
    lines += [
        "",
        f"The trainer's wait for data, ELDE-Net at {SIZE[0]} x {SIZE[1]}, batch {BATCH}, {FRAMES} frames an "
        f"epoch, {resources.precision}, {resources.threads} thread + {resources.workers} workers (`waited` "
        "and `seconds` in `run.json`). The first epoch fills the cache and starts the workers.",
        "",
        "| cache | epoch | waited [s] | in steps [s] | wait over step |",
        "|---|---:|---:|---:|---:|",
    ]
    for cache, epochs in waited.items():
        for number, (wait, step) in enumerate(epochs, 1):
            lines.append(f"| {cache} | {number} | {wait:.2f} | {step:.1f} | {wait / step:.1%} |")
    lines += ["", "Made by `python experiments/data_throughput/run.py`."]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    sys.exit(main())

"""Measure the speed of training: precision and memory layout, and whether loading keeps up.

python experiments/training_speed/run.py

Two tables of medians over interleaved rounds, so that a drift of the machine affects all rows alike:
1. images/s of a bare training step on tensors in memory, for precision x layout, at 224 x 320 and 120 x 160;
2. the training loop with rooms at 120 x 160, full augmentation and loading, over the bare step on one batch.
"""

import statistics
import time
from collections.abc import Callable
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.data.loaders import EpochSampler, training_loader  # noqa: E402
from eldenet.data.rooms import Rooms  # noqa: E402
from eldenet.data.transforms import Augmentation  # noqa: E402
from eldenet.losses.base import LossInputs, WeightedSum, WeightedTerm  # noqa: E402
from eldenet.losses.pointwise import L1Loss  # noqa: E402
from eldenet.losses.ssim import SSIMLoss  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.system.resources import choose_resources  # noqa: E402

HERE = Path(__file__).parent
BATCH = 32
STEPS = 20


def make_step(precision: str, channels_last: bool, size: tuple[int, int]) -> Callable[..., None]:
    """Return a training step of the default network on a batch in memory: forward, loss, backward, Adam."""
    model = eldenet.load("eldenet").train()
    layout = torch.channels_last if channels_last else torch.contiguous_format
    model.to(memory_format=layout)
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    loss = WeightedSum({"ssim": WeightedTerm(SSIMLoss()), "l1": WeightedTerm(L1Loss())})
    image = torch.rand(BATCH, 3, *size)
    depth = torch.rand(BATCH, 1, *size) * 9 + 0.5

    def step(image: torch.Tensor = image, depth: torch.Tensor = depth) -> None:
        image = image.contiguous(memory_format=layout)
        with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16"):
            prediction = model(image)
        loss(LossInputs(prediction.float(), depth, depth > 0))[0].backward()
        optimizer.step()
        optimizer.zero_grad()

    step()
    return step


def rate_of_steps(rows: dict[str, Callable[..., None]], rounds: int = 7) -> dict[str, float]:
    """Return the median images/s of each row over interleaved rounds."""
    seconds: dict[str, list[float]] = {name: [] for name in rows}
    for _ in range(rounds):
        for name, step in rows.items():
            started = time.perf_counter()
            step()
            seconds[name].append(time.perf_counter() - started)
    return {name: BATCH / statistics.median(values) for name, values in seconds.items()}


def loop_against_step(
    size: tuple[int, int], threads: int | str, workers: int | str
) -> tuple[float, float, str]:
    """Return images/s of the loop with data and of the bare step, in turns of one batch, and a label."""
    resources = choose_resources(device="cpu", threads=threads, workers=workers)
    rooms = Rooms("train", 2048, size=size, transform=Augmentation(), input_size=size)
    sampler = EpochSampler(len(rooms), BATCH, seed=0)
    loader = training_loader(rooms, sampler, workers=resources.workers)
    step = make_step(resources.precision, True, size)
    memory = next(iter(loader))
    bare, loop = [], []
    batches = iter(loader)
    next(batches)
    for _ in range(STEPS):
        started = time.perf_counter()
        step(memory["image"], memory["depth"])
        bare.append(time.perf_counter() - started)
        started = time.perf_counter()
        batch = next(batches)
        step(batch["image"], batch["depth"])
        loop.append(time.perf_counter() - started)
    shown = f"{resources.threads} threads + {resources.workers} workers, {resources.precision}"
    return BATCH / statistics.median(loop), BATCH / statistics.median(bare), shown


def main() -> None:
    resources = choose_resources(device="cpu")
    where = environment()
    lines = [
        f"{where['hardware']['processor']}, {resources.cores} cores, torch {where['versions']['torch']}, "
        f"{where['date']}; eldenet, batch {BATCH}; medians of interleaved rounds.",
        "",
        "| input | precision, layout | threads | images/s | ratio |",
        "|---|---|---:|---:|---:|",
    ]
    for size in ((224, 320), (120, 160)):
        rows = {
            f"{precision}, {'channels_last' if last else 'contiguous'}": make_step(precision, last, size)
            for precision, last in (("fp32", False), ("fp32", True), ("bf16", False), ("bf16", True))
        }
        rates = rate_of_steps(rows)
        for name, rate in rates.items():
            ratio = rate / rates["fp32, contiguous"]
            lines.append(
                f"| {size[0]} x {size[1]} | {name} | {resources.threads} | {rate:.0f} | {ratio:.2f} |"
            )
    lines += ["", "| input | loop with data | images/s | bare step | share |", "|---|---|---:|---:|---:|"]
    size = (120, 160)
    for threads, workers in ((1, 1), (1, 0), (2, 0)):
        loop, bare, shown = loop_against_step(size, threads, workers)
        lines.append(f"| {size[0]} x {size[1]} | {shown} | {loop:.0f} | {bare:.0f} | {loop / bare:.2f} |")
    lines += ["", "Made by `python experiments/training_speed/run.py`."]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()

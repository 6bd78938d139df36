"""Measure the speed of training: precision and memory layout, and whether loading keeps up.

python experiments/training_speed/run.py [cpu|cuda]

Two tables of medians over interleaved rounds, so that a drift of the machine affects all rows alike:
1. images/s of a bare training step on tensors in memory, for precision x layout, at 224 x 320 and 120 x 160;
2. the training loop with rooms at 120 x 160, full augmentation and loading, over the lower of the bare step
   on one batch and of loading alone.
"""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.data.loaders import EpochSampler, batches_on, training_loader  # noqa: E402
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
DEVICE = torch.device(sys.argv[1] if len(sys.argv) > 1 else "cpu")


def now() -> float:
    """Return the time [s] once the device has done its work."""
    if DEVICE.type == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


def make_step(precision: str, channels_last: bool, size: tuple[int, int]) -> Callable[..., None]:
    """Return a training step of the default network on a batch in memory: forward, loss, backward, Adam."""
    model = eldenet.load("eldenet").train()
    layout = torch.channels_last if channels_last else torch.contiguous_format
    model.to(DEVICE)
    model.to(memory_format=layout)
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    loss = WeightedSum({"ssim": WeightedTerm(SSIMLoss()), "l1": WeightedTerm(L1Loss())}).to(DEVICE)
    image = torch.rand(BATCH, 3, *size, device=DEVICE)
    depth = torch.rand(BATCH, 1, *size, device=DEVICE) * 9 + 0.5

    def step(image: torch.Tensor = image, depth: torch.Tensor = depth) -> None:
        image = image.contiguous(memory_format=layout)
        with torch.autocast(DEVICE.type, torch.bfloat16, enabled=precision == "bf16"):
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
            started = now()
            step()
            seconds[name].append(now() - started)
    return {name: BATCH / statistics.median(values) for name, values in seconds.items()}


def loop_against_step(
    size: tuple[int, int], threads: int | str, workers: int | str
) -> tuple[float, float, float, str]:
    """Return images/s of the loop with data, of the bare step and of loading alone, in turns, and a label."""
    resources = choose_resources(device=DEVICE.type, threads=threads, workers=workers)
    rooms = Rooms("train", 2048, size=size, transform=Augmentation(), input_size=size)
    sampler = EpochSampler(len(rooms), BATCH, seed=0)
    loader = training_loader(rooms, sampler, workers=resources.workers, device=DEVICE.type)
    step = make_step(resources.precision, True, size)
    memory = next(batches_on(DEVICE, loader, channels_last=True))
    bare, loop, alone = [], [], []
    batches = batches_on(DEVICE, loader, channels_last=True)
    next(batches)
    for _ in range(STEPS):
        started = now()
        step(memory["image"], memory["depth"])
        bare.append(now() - started)
        started = now()
        batch = next(batches)
        step(batch["image"], batch["depth"])
        loop.append(now() - started)
    for _ in range(STEPS):  # after those that were loaded ahead
        started = now()
        next(batches)
        alone.append(now() - started)
    shown = f"{resources.threads} threads + {resources.workers} workers, {resources.precision}"
    rates = [BATCH / statistics.median(each) for each in (loop, bare)]
    return rates[0], rates[1], BATCH / statistics.mean(alone), shown


def main() -> None:
    resources = choose_resources(device=DEVICE.type)
    where = environment()
    lines = [
        f"{where['hardware']['processor']}, {resources.cores} cores, torch {where['versions']['torch']}, "
        f"{where['date']}; eldenet, batch {BATCH}; medians of interleaved rounds.",
        "",
        "| device | input | precision, layout | threads | images/s | ratio |",
        "|---|---|---|---:|---:|---:|",
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
                f"| {DEVICE.type} | {size[0]} x {size[1]} | {name} | {resources.threads} | {rate:.0f} | "
                f"{ratio:.2f} |"
            )
    lines += ["", "| device | input | loop with data | images/s | bare step | loading alone | share |"]
    lines += ["|---|---|---|---:|---:|---:|---:|"]
    size = (120, 160)
    on_gpu = DEVICE.type == "cuda"
    on_cpu: list[tuple[int | str, int | str]] = [(1, 1), (1, 0), (2, 0)]
    for threads, workers in [("auto", "auto")] if on_gpu else on_cpu:
        loop, bare, alone, shown = loop_against_step(size, threads, workers)
        lines.append(
            f"| {DEVICE.type} | {size[0]} x {size[1]} | {shown} | {loop:.0f} | {bare:.0f} | {alone:.0f} | "
            f"{loop / min(bare, alone):.2f} |"
        )
    lines += ["", f"Made by `python experiments/training_speed/run.py {DEVICE.type}`."]
    (HERE / ("results_cuda.md" if on_gpu else "results.md")).write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()

"""Measure trainings and predictions on a GPU: every row that docs/gpu.md speaks of, in one run.

python experiments/gpu/run.py                      on the GPU, under 200 s
python experiments/gpu/run.py --tiny --seconds 60  anywhere, with tiny sizes: does it run?

Rows go to results.jsonl as they are measured and, at the end, to results.md. What the time did not allow is
listed there.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from eldenet.system.resources import prepare_environment

prepare_environment()

import cv2  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402
from torch.utils.flop_counter import FlopCounterMode  # noqa: E402

import eldenet  # noqa: E402
from eldenet.compose import compose  # noqa: E402
from eldenet.data.base import DepthDataset  # noqa: E402
from eldenet.data.loaders import EpochSampler, training_loader  # noqa: E402
from eldenet.evaluation.protocol import EvalProtocol  # noqa: E402
from eldenet.evaluation.splits import chosen_protocol, open_split  # noqa: E402
from eldenet.heads import LinearHead  # noqa: E402
from eldenet.losses.base import WeightedSum, WeightedTerm  # noqa: E402
from eldenet.losses.pointwise import L1Loss  # noqa: E402
from eldenet.losses.ssim import SSIMLoss, eroded, ssim_map  # noqa: E402
from eldenet.model import DepthNet  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.system.resources import choose_resources, seed_everything  # noqa: E402
from eldenet.train import TrainSettings  # noqa: E402
from eldenet.training.optim import constant  # noqa: E402
from eldenet.training.trainer import Trainer, TrainingData  # noqa: E402
from eldenet.types import Frame  # noqa: E402

HERE = Path(__file__).parent
ON_GPU = torch.cuda.is_available()
DEVICE = torch.device("cuda" if ON_GPU else "cpu")
PROTOCOL = EvalProtocol("noise", min_depth=0.1, ground_truth="dense")
RENDER = """
import os, sys, time
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(sys.argv[1])])
from eldenet.data.rooms import Rooms
started = time.perf_counter()
Rooms("train", int(sys.argv[2]), size=(96, 128))
print(int(sys.argv[2]) / (time.perf_counter() - started))
"""


class Noise(DepthDataset):
    """Frames that are never looked at: the batches of these rows lie on the device."""

    ground_truth = "dense"

    def __init__(self, frames: int = 4) -> None:
        super().__init__([str(index) for index in range(frames)], min_depth=0.1, max_depth=10.0)

    def load_frame(self, index: int) -> Frame:
        """A frame of 32 x 32."""
        return Frame(np.zeros((32, 32, 3), np.uint8), np.ones((32, 32), np.float32), None, self.names[index])


class Timed(Trainer):
    """Times its epochs; without validations and checkpoints.

    Attributes:
        repeated: batches of an epoch that lie on the device; None: those of its frames.
        rates: images/s of each epoch.
    """

    repeated: list[dict[str, Any]] | None = None

    def _train_epoch(self, epoch: int, stop: Any) -> None:
        if self.repeated is not None:
            self.loader, self.sampler.batches = self.repeated, len(self.repeated)
        synchronize()
        started = time.perf_counter()
        super()._train_epoch(epoch, stop)
        synchronize()
        rate = self.progress.batch * self.batch_size / (time.perf_counter() - started)
        self.rates = [*getattr(self, "rates", []), rate]

    def _end_epoch(self, epoch: int) -> None:
        self.meter.read()
        self.progress.sums.clear()
        self.progress.epoch, self.progress.batch, self.progress.best_epoch = epoch + 1, 0, 1


class AsBefore(SSIMLoss):
    """SSIM that brings its matrices along and asks whether the mask is full, as it was once."""

    def forward(self, prediction: torch.Tensor, target: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """As :class:`SSIMLoss`."""
        similarity = ssim_map(prediction, target, window=11, value_range=10.0)
        kept = mask if bool(mask.all()) else eroded(mask, 11)
        return ((1 - similarity) / 2).masked_fill(~kept, 0.0).sum() / kept.sum()


def synchronize() -> None:
    """Wait for the GPU."""
    if ON_GPU:
        torch.cuda.synchronize()


def make_batch(size: int, shape: tuple[int, int]) -> dict[str, Any]:
    """Random images, depth and cameras on the device."""
    image = torch.rand(size, 3, *shape, device=DEVICE).contiguous(memory_format=torch.channels_last)
    depth = 0.5 + 9 * torch.rand(size, 1, *shape, device=DEVICE)
    camera = torch.eye(3, device=DEVICE).repeat(size, 1, 1)
    return {"image": image, "depth": depth, "mask": depth > 0, "intrinsics": camera, "name": [""] * size}


def network(name: str) -> DepthNet:
    """A network by its name; one of segmentation_models.pytorch by ``smp.``."""
    seed_everything(0)
    if not name.startswith("smp."):
        return eldenet.load(name).train()
    import segmentation_models_pytorch as smp

    return DepthNet(
        smp.Unet(name.removeprefix("smp."), encoder_weights=None, classes=1), LinearHead()
    ).train()


def step_rate(
    name: str, batch: int, shape: tuple[int, int], steps: int, ssim: SSIMLoss | None = None, **options: Any
) -> float:
    """Return images/s of the trainer's own step: forward, SSIM + L1, backward, Adam."""
    trainer = Timed(
        optimizer=partial(torch.optim.Adam, lr=1e-4, **options.pop("adam", {})),
        scheduler=constant,
        epochs=4,
        batch_size=batch,
        loggers=(),
        checkpoint_every=10**6,
        **options,
    )
    trainer.repeated = [make_batch(batch, shape)] * steps
    loss = WeightedSum({"ssim": WeightedTerm(ssim or SSIMLoss()), "l1": WeightedTerm(L1Loss())})
    resources = choose_resources(device=DEVICE.type, precision="bf16", threads=1, workers=0)
    with tempfile.TemporaryDirectory() as folder:
        trainer.fit(network(name), loss, TrainingData(Noise(), Noise(), PROTOCOL), Path(folder), resources)
    return statistics.median(trainer.rates[1:])  # the first epoch warms up


def plain_rate(name: str, batch: int, shape: tuple[int, int], steps: int) -> float:
    """Return images/s of the loop that one would write: autocast, L1 and kornia's SSIM, Adam."""
    from kornia.losses import ssim_loss

    model = network(name).to(DEVICE)
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-4)
    given = make_batch(batch, shape)
    torch.use_deterministic_algorithms(False)
    torch.backends.cudnn.benchmark = True
    rates = []
    for _ in range(4):
        synchronize()
        started = time.perf_counter()
        for _ in range(steps):
            with torch.autocast(DEVICE.type, torch.bfloat16):
                depth = model.network(given["image"])
            depth = torch.nn.functional.interpolate(depth.float(), shape, mode="bilinear")
            l1 = (depth - given["depth"]).abs().mean()
            loss = l1 + ssim_loss(depth, given["depth"], 11, max_val=10.0)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        synchronize()
        rates.append(steps * batch / (time.perf_counter() - started))
    return statistics.median(rates[1:])


def seconds_of(call: Callable[[], Any], repeats: int) -> float:
    """Return the median seconds of a call, the GPU's work included."""
    times = []
    for _ in range(repeats + 3):
        synchronize()
        started = time.perf_counter()
        call()
        synchronize()
        times.append(time.perf_counter() - started)
    return statistics.median(times[3:])


def roofline(name: str, batch: int, shape: tuple[int, int], tiny: bool) -> dict[str, float]:
    """Return the least seconds of a training step by this device's measured copy and matrix rates.

    A step counts as three forward passes. Of each layer, input and output cross the memory once, in bf16.
    """
    side = 512 if tiny else 8192
    a = torch.rand(side, side, device=DEVICE, dtype=torch.bfloat16)
    flops_rate = 2 * side**3 / seconds_of(lambda: a @ a, 5)
    block = torch.empty((1 if tiny else 256) * 2**20, device=DEVICE)
    copy_rate = 2 * 4 * block.numel() / seconds_of(lambda: block.clone(), 5)
    model, moved = network(name).to(DEVICE), [0]

    def count(_part: Any, inputs: Any, output: Any) -> None:
        tensors = [value for value in (*inputs, output) if isinstance(value, torch.Tensor)]
        moved[0] += sum(2 * value.numel() for value in tensors)

    for part in model.modules():
        if not list(part.children()):
            part.register_forward_hook(count)
    image = make_batch(batch, shape)["image"]
    with FlopCounterMode(display=False) as flops, torch.no_grad():
        model(image)
    return {
        "matrix_tflops": flops_rate / 1e12,
        "copy_gb_s": copy_rate / 1e9,
        "least_ms_by_flops": 3e3 * flops.get_total_flops() / flops_rate,
        "least_ms_by_bytes": 3e3 * moved[0] / copy_rate,
    }


@torch.inference_mode()
def prediction_ms(name: str, batch: int, graph: bool) -> float:
    """Return milliseconds of one prediction at 224 x 224 in fp32, as it is or as a CUDA graph."""
    model = eldenet.load(name).eval().to(DEVICE, memory_format=torch.channels_last)
    image = torch.rand(batch, 3, 224, 224, device=DEVICE).contiguous(memory_format=torch.channels_last)
    call: Callable[[], Any] = partial(model, image)
    if graph:
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(3):
                call()
        torch.cuda.current_stream().wait_stream(stream)
        captured = torch.cuda.CUDAGraph()
        with torch.cuda.graph(captured):
            call()
        call = captured.replay
    return 1000 * seconds_of(call, 20)


def write_frames(root: Path, frames: int) -> None:
    """Write one picture of 480 x 640 as JPEG and its depth as 16-bit PNG, under many names."""
    rng = np.random.default_rng(0)
    picture = cv2.resize(rng.integers(0, 255, (12, 16, 3), dtype=np.uint8), (640, 480))
    depth = np.linspace(500, 9000, 480 * 640).reshape(480, 640).astype(np.uint16)
    for name, content in (("images/0.jpg", picture), ("depths/0.png", depth)):
        first = root / name
        first.parent.mkdir(parents=True)
        cv2.imwrite(str(first), content)
        for index in range(1, frames):
            os.link(first, first.with_name(f"{index}{first.suffix}"))


def data_rates(root: Path, cache: str, batch: int, shape: tuple[int, int]) -> dict[str, float]:
    """Return images/s of the loader alone and of a whole training on those frames; seconds to the first."""
    settings = compose(
        TrainSettings,
        [
            "data=folder",
            f"data.root={root}",
            f"data.cache={cache}",
            f"data.input_size=[{shape[0]},{shape[1]}]",
        ],
    )
    protocol = chosen_protocol(settings.data, None)
    split = partial(open_split, settings.data, protocol=protocol)
    resources = choose_resources(device=DEVICE.type)
    train = split("train", augmentation=settings.augmentation)
    sampler = EpochSampler(len(train), batch, seed=0)
    loader = training_loader(train, sampler, workers=resources.workers, device=DEVICE.type)
    started = time.perf_counter()
    first, counted = 0.0, 0
    for epoch in range(2):  # the second one finds running workers and a full cache
        sampler.epoch = epoch
        begun, counted = time.perf_counter(), 0
        for given in loader:
            first = first or time.perf_counter() - started
            counted += len(given["name"])
    alone = counted / (time.perf_counter() - begun)
    del loader
    trainer = Timed(
        optimizer=partial(torch.optim.Adam, lr=1e-4),
        scheduler=constant,
        epochs=2,
        batch_size=batch,
        loggers=(),
        checkpoint_every=10**6,
        cuda_graph=ON_GPU,
    )
    loss = WeightedSum({"ssim": WeightedTerm(SSIMLoss()), "l1": WeightedTerm(L1Loss())})
    with tempfile.TemporaryDirectory() as folder:
        data = TrainingData(train, split("val"), protocol)
        trainer.fit(network("eldenet"), loss, data, Path(folder), resources)
    return {"loader_img_s": alone, "training_img_s": trainer.rates[-1], "first_batch_s": first}


def rendering_rate(cores: int, frames: int) -> float:
    """Return frames/s of rendered rooms with so many cores, into an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        words = [sys.executable, "-c", RENDER, str(cores), str(frames)]
        done = subprocess.run(
            words, env=os.environ | {"ELDENET_CACHE": cache}, capture_output=True, text=True, check=True
        )
    return float(done.stdout.split()[-1])


def main_job(tiny: bool, seconds: float) -> dict[str, float]:
    """Return the seconds of the default training from a cold cache, and its scores."""
    few = ["trainer.epochs=1", "data.frames={train: 64, val: 16, test: 16}"] if tiny else []
    with tempfile.TemporaryDirectory() as place:
        words = [sys.executable, "-m", "eldenet.train", f"output={place}/run", *few]
        started = time.perf_counter()
        subprocess.run(
            words,
            env=os.environ | {"ELDENET_CACHE": f"{place}/cache"},
            check=True,
            timeout=seconds,
            capture_output=True,
            text=True,
        )
        took = time.perf_counter() - started
        record = json.loads(Path(place, "run", "run.json").read_text())
    return {"seconds": took, **{name: record["metrics"][name] for name in ("delta1", "abs_rel", "rmse")}}


def rows(tiny: bool, left: Callable[[], float]) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield name and measurement of each row, the most important ones first."""
    shape, steps = ((48, 64), 2) if tiny else ((192, 256), 20)
    batches = (2, 4) if tiny else (16, 128)
    small, large = batches
    before = {"adam": {"foreach": True}, "ssim": AsBefore(), "deterministic": False}
    kinds: dict[str, dict[str, Any]] = {
        "as before": before,
        "as it is": {},
        "deterministic": {"deterministic": True},
    }
    if ON_GPU:
        kinds |= {"CUDA graph": {"cuda_graph": True}}
    for batch in batches:
        for kind, options in kinds.items():
            yield (
                f"step, eldenet, batch {batch}, {kind}",
                partial(step_rate, "eldenet", batch, shape, steps, **options),
            )
    yield f"roofline, eldenet, batch {large}", partial(roofline, "eldenet", large, shape, tiny)
    for batch in (1, 2 if tiny else 64):
        for graph in (False, True) if ON_GPU else (False,):
            yield (
                f"prediction, eldenet, 224 x 224, batch {batch}{', CUDA graph' * graph} [ms]",
                partial(prediction_ms, "eldenet", batch, graph),
            )
    yield "main job, cold cache", lambda: main_job(tiny, max(1.0, left()))
    for cores in sorted({1, 2, len(os.sched_getaffinity(0))}):
        yield (
            f"rendering with {cores} cores [frames/s]",
            partial(rendering_rate, cores, 16 if tiny else 100 * cores),
        )
    graph = {"cuda_graph": True} if ON_GPU else {}
    for name in ("resnet18_upconv", "meter_xs", "smp.resnet18"):
        yield f"step, {name}, batch {small}", partial(step_rate, name, small, shape, steps, **graph)
        yield (
            f"step, {name}, batch {small}, plain loop with kornia's SSIM",
            partial(plain_rate, name, small, shape, steps),
        )
    root = Path(tempfile.mkdtemp())
    frames = 64 if tiny else 4096
    write_frames(root, frames)
    for cache in ("none", "disk"):
        yield (
            f"data, 480 x 640 JPEG + PNG, cache={cache}",
            partial(data_rates, root, cache, small if tiny else 64, shape),
        )
    if ON_GPU:
        both = {"compile": True, "cuda_graph": True}
        for batch in batches:
            yield (
                f"step, eldenet, batch {batch}, compiled, CUDA graph",
                partial(step_rate, "eldenet", batch, shape, steps, **both),
            )


def main() -> None:
    """Measure, and write each row when it is there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tiny", action="store_true")
    parser.add_argument("--seconds", type=float, default=190.0)
    parser.add_argument("--only", nargs="+", default=[""], help="parts of the names of the rows to measure")
    parser.add_argument("--output", type=Path, default=HERE)
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()

    def left() -> float:
        return asked.seconds - (time.perf_counter() - started)

    where, device = environment(), torch.cuda.get_device_name() if ON_GPU else "CPU"
    lines = [
        f"{device}, {len(os.sched_getaffinity(0))} cores, torch {where['versions']['torch']}, "
        f"{where['date']}, bf16 trainings, fp32 predictions; images/s unless the row says otherwise.",
        "",
        "| row | value |",
        "|---|---|",
    ]
    with (asked.output / "results.jsonl").open("w") as file:
        wanted = (row for row in rows(asked.tiny, left) if any(part in row[0] for part in asked.only))
        for name, measure in wanted:
            try:
                found = measure() if left() > 0 else "no time left"
            except Exception as error:  # a row that fails leaves the others
                said = str(getattr(error, "stderr", None) or error)  # what a command printed at its end
                found = f"{type(error).__name__}: {' '.join(said[-200:].split())}"
            if isinstance(found, dict):
                shown = ", ".join(f"{key} {value:.4g}" for key, value in found.items())
            else:
                shown = found if isinstance(found, str) else f"{found:.4g}"
            print(f"{time.perf_counter() - started:6.1f} s  {name}: {shown}", flush=True)
            file.write(json.dumps({"row": name, "value": found, "device": device}) + "\n")
            file.flush()
            lines.append(f"| {name} | {shown} |")
    lines += ["", f"Made by `python {' '.join(sys.argv)}`."]
    (asked.output / "results.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

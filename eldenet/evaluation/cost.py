"""Cost of a model: parameters, multiply-adds, latency and throughput, and what they were measured on."""

import itertools
import sys
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from eldenet.model import eval_mode
from eldenet.system.timing import Waiting, median_ms, percentile_ms, time_interleaved


@dataclass(frozen=True)
class CostReport:
    """Cost of one forward pass. A latency means nothing without the attributes from ``height`` on."""

    params: int  # number of parameters
    gmacs: float  # multiply-adds of one image [1e9]; convolutions and matrix products, as torch counts them
    gflops: float  # floating-point operations of one image [1e9]: 2 x gmacs
    latency_ms_p50: float  # median time of one image, batch 1 [ms]
    latency_ms_p95: float  # 95th percentile [ms]
    throughput_img_s: float  # images per second at batch
    peak_memory_mb: float  # of the process (CPU) or the device (CUDA) [MB]
    height: int  # of the input [px]
    width: int  # of the input [px]
    batch: int  # images at a time, for the throughput
    runtime: str  # what executed the model
    precision: str  # fp32, bf16, ...
    threads: int  # torch's threads
    device: str  # "cpu" or the accelerator's name
    # time on the clock over that of the processors while it was timed; about 1 or less where no other job ran
    waiting: float = 1.0


def count_params(model: nn.Module) -> int:
    """Number of parameters."""
    return sum(parameter.numel() for parameter in model.parameters())


def count_macs(model: nn.Module, size: tuple[int, int]) -> int:
    """Multiply-adds of one image of ``size`` (height, width): convolutions and matrix products.

    Convention: one MAC is two FLOPs; biases, normalization and activations are not counted.
    """
    from torch.utils.flop_counter import FlopCounterMode

    image = _images(model, 1, size)
    with eval_mode(model), FlopCounterMode(display=False) as counter, torch.inference_mode():
        model(image, *_focal_for_rays(model))
    return counter.get_total_flops() // 2


def _focal_for_rays(model: nn.Module) -> tuple[float, ...]:
    """What a model is given after the image: fx [px] if it sees rays, so that they are counted."""
    return (float(model.canonical_px),) if getattr(model, "sees_rays", False) else ()  # type: ignore[arg-type]


def _images(model: nn.Module, batch: int, size: tuple[int, int]) -> Tensor:
    """Random images ``(batch, 3, *size)`` on the model's device."""
    return torch.rand(batch, 3, *size, generator=torch.Generator().manual_seed(0)).to(device_of(model))


def device_of(model: nn.Module) -> torch.device:
    """Device of a model; the CPU if it has neither parameters nor buffers."""
    tensors = itertools.chain(model.parameters(), model.buffers())
    return next((tensor.device for tensor in tensors), torch.device("cpu"))


def peak_memory_mb(device: torch.device) -> float:
    """Peak memory so far [MB]: of the device on CUDA, else of this process."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device) / 1e6
    if sys.platform == "win32":
        import psutil

        return psutil.Process().memory_info().peak_wset / 1e6
    import resource

    unit = 1 if sys.platform == "darwin" else 1024  # Linux counts in KiB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def measure_cost(
    model: nn.Module, size: tuple[int, int], *, batch: int = 8, seconds: float = 1.0
) -> CostReport:
    """Measure a model as it is (torch eager, fp32, channels_last, eval) on its own device.

    Args:
        model: image ``(B, 3, H, W)`` -> depth.
        size: ``(height, width)`` of the input [px].
        batch: images at a time, for the throughput.
        seconds: to spend on each of the two timings; the device is synchronized and warmed up.
    """
    device = device_of(model)
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)  # the model's, not the training's before it
    model.to(memory_format=torch.channels_last)
    one, many = (
        _images(model, number, size).contiguous(memory_format=torch.channels_last) for number in (1, batch)
    )
    focal = _focal_for_rays(model)
    with eval_mode(model), torch.inference_mode(), Waiting() as waiting:
        times = time_interleaved(
            {"one": lambda: model(one, *focal), "many": lambda: model(many, *focal)},
            seconds=seconds / 5,  # five rounds
            synchronize=torch.cuda.synchronize if device.type == "cuda" else None,
        )
    macs = count_macs(model, size)
    return CostReport(
        params=count_params(model),
        gmacs=macs / 1e9,
        gflops=2 * macs / 1e9,
        latency_ms_p50=median_ms(times["one"]),
        latency_ms_p95=percentile_ms(times["one"], 95),
        throughput_img_s=1e3 * batch / median_ms(times["many"]),
        peak_memory_mb=peak_memory_mb(device),
        height=size[0],
        width=size[1],
        batch=batch,
        runtime="torch",
        precision="fp32",
        threads=torch.get_num_threads(),
        device=torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
        waiting=waiting.ratio,
    )

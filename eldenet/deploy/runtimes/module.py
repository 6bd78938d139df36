"""An exported file as a torch module, to score it and to measure its cost."""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eldenet.deploy.runtimes.base import Runtime
from eldenet.evaluation.cost import CostReport, peak_memory_mb
from eldenet.system.timing import Waiting, median_ms, percentile_ms, time_interleaved


class RuntimeNetwork(nn.Module):
    """Image ``(B, 3, H, W)`` -> depth ``(B, 1, H, W)`` [m] by a runtime, without parameters and gradient.

    Raises:
        ValueError: the file takes camera frames; in a call, images of another size, or fewer at once.
    """

    def __init__(self, network: Runtime) -> None:
        super().__init__()
        if network.takes_frames:
            raise ValueError("this file takes camera frames: to score the network, export it without camera=")
        self.network = network
        self.info, self.canonical_px, self.fov = network.info, network.canonical_px, network.fov
        self.distribution = network.distribution

    def forward(self, image: Tensor, focal: Tensor | None = None, *, with_spread: bool = False) -> Any:
        """Depth [m] on the image's device; ``with_spread``: and the standard deviation of ln depth.

        ``focal (B,)`` is fx [px of ``image``], for files with ``canonical_px``, and for those of one lens,
        which refuse another.
        """
        if self.network.fixed_size not in (None, tuple(image.shape[-2:])):
            raise ValueError(
                f"this file takes {self.network.fixed_size} pixels (height, width), but the images have "
                f"{tuple(image.shape[-2:])}: leave input_size=model, or export it at their size"
            )
        batch = self.network.fixed_batch
        if batch is None:
            return self._run(image.float(), focal, with_spread)
        if len(image) > batch:
            raise ValueError(f"this file takes {batch} images at once: give batch_size={batch}")
        missing = batch - len(image)  # in the last batch of a set
        filled = torch.cat([image, image[-1:].expand(missing, -1, -1, -1)])
        lens = None if focal is None else torch.cat([focal, focal[-1:].expand(missing)])
        found = self._run(filled.float(), lens, with_spread)
        return tuple(each[: len(image)] for each in found) if with_spread else found[: len(image)]

    def _run(self, image: Tensor, focal: Tensor | None, with_spread: bool) -> Any:
        lens = None if focal is None else focal.cpu().numpy()
        if not with_spread:
            return self.network(image, lens)
        estimate = self.network.predict(image.cpu().numpy(), lens)  # asked only of files with sigma
        return tuple(torch.from_numpy(each).to(image.device) for each in (estimate.depth, estimate.spread))


def measure_runtime_cost(network: Runtime, size: tuple[int, int]) -> CostReport:
    """Cost as by :func:`eldenet.evaluation.cost.measure_cost`, with the counts that the file states.

    A file of a fixed batch is timed at that batch; unless it is 1, the latency of one image is NaN. The file
    states its multiply-adds at one size; at another they are NaN.
    """
    one, batch = network.fixed_batch or 1, network.fixed_batch or 8
    calls = {}
    for name, number in (("one", one), ("many", batch)):
        images = network.prepared(np.random.default_rng(0).random((number, 3, *size), np.float32))
        calls[name] = lambda images=images: network.run_prepared(images)
    with torch.inference_mode(), Waiting() as waiting:
        times = time_interleaved(calls, synchronize=network.synchronize)
    gmacs = math.nan
    if network.gmacs is not None and network.info.get("input_size") == tuple(size):
        gmacs = network.gmacs
    of_one = times["one"] if one == 1 else [math.nan]
    return CostReport(
        params=int(network.params or 0),
        gmacs=gmacs,
        gflops=2 * gmacs,
        latency_ms_p50=median_ms(of_one),
        latency_ms_p95=percentile_ms(of_one, 95),
        throughput_img_s=1e3 * batch / median_ms(times["many"]),
        peak_memory_mb=peak_memory_mb(torch.device("cpu")),
        height=size[0],
        width=size[1],
        batch=batch,
        runtime=network.runtime,
        precision=network.precision,
        threads=network.threads,
        device=network.device,
        waiting=waiting.ratio,
    )

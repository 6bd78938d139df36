"""torch itself: eager, channels_last, or compiled."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eldenet.deploy.fold import fold
from eldenet.deploy.runtimes.base import Runtime, check_precision
from eldenet.model import DepthNet
from eldenet.system.resources import check_torch_device, full_fp32

DTYPES = {"bf16": torch.bfloat16, "fp16": torch.float16}


class TorchRuntime(Runtime):
    """A folded copy of a :class:`~eldenet.model.DepthNet`.

    A lower precision applies to the network; normalization and head stay in fp32 (never TF32).

    Args:
        model: stays unchanged.
        layout: "torch" (contiguous), "torch_channels_last" or "torch_compile" (channels_last, compiled).
        precision: "fp32", "bf16", or on CUDA "fp16".
        threads: of torch, process-wide, on a CPU.
        device: "cpu" or "cuda".
        metadata: of the model (:func:`eldenet.deploy.metadata.describe`).

    Raises:
        ValueError: torch does not offer this precision or device here.
    """

    def __init__(
        self,
        model: DepthNet,
        layout: str = "torch",
        *,
        precision: str = "fp32",
        threads: int = 1,
        device: str = "cpu",
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        check_torch_device(device)
        allowed = ("fp32", "bf16", "fp16") if device == "cuda" else ("fp32", "bf16")
        advice = "for fp16 give device=cuda, for int8 export a file (eldenet export precision=int8)"
        check_precision(precision, allowed, layout, advice)
        if device == "cuda":
            full_fp32()
        name = torch.cuda.get_device_name() if device == "cuda" else "cpu"
        super().__init__(precision, threads, name, metadata or {}, sees_rays=model.sees_rays)
        self.runtime = layout
        self.target = torch.device(device)
        self.layout = torch.contiguous_format if layout == "torch" else torch.channels_last
        network = fold(model)
        if precision in DTYPES:
            network.network = _Cast(network.network, DTYPES[precision])
        self.network: Any = network.to(self.target).to(memory_format=self.layout)
        if layout == "torch_compile":
            # frozen weights: the compiler lays them out once, for the fastest kernels
            self.network = torch.compile(self.network, dynamic=False, options={"freezing": device == "cpu"})

    def prepared(self, images: np.ndarray) -> Tensor:
        """Tensor on the device, in the layout."""
        return torch.from_numpy(images).to(self.target).contiguous(memory_format=self.layout)

    @torch.no_grad()
    def run_prepared(self, images: Tensor, focal: np.ndarray | None = None, **options: bool) -> Any:
        """Run a tensor; ``options`` are those of the network."""
        if self.target.type == "cpu" and torch.get_num_threads() != self.threads:
            torch.set_num_threads(self.threads)
        if not self.sees_rays:
            return self.network(images, **options)
        lens = torch.zeros(len(images)) if focal is None else torch.from_numpy(focal)
        return self.network(images, lens.to(self.target), **options)

    def run(self, images: np.ndarray, focal: np.ndarray | None = None) -> np.ndarray:
        """Run arrays."""
        return self.run_prepared(self.prepared(images), focal).cpu().numpy()

    def run_maps(self, images: np.ndarray, focal: np.ndarray | None = None) -> list[np.ndarray]:
        """Run arrays."""
        if self.distribution is None:
            return [self.run(images, focal)]
        depth, spread = self.run_prepared(self.prepared(images), focal, with_spread=True)
        return [depth.cpu().numpy(), (depth * spread).cpu().numpy()]

    def synchronize(self) -> None:
        """Wait for the GPU."""
        if self.target.type == "cuda":
            torch.cuda.synchronize(self.target)


class _Cast(nn.Module):
    """A network of lower precision that casts its input; the head casts the raw map back."""

    def __init__(self, network: nn.Module, dtype: torch.dtype) -> None:
        super().__init__()
        self.network, self.dtype = network.to(dtype), dtype

    def forward(self, image: Tensor, *focal: Tensor) -> Tensor:
        return self.network(image.to(self.dtype), *focal)

"""A training step as a CUDA graph for each shape: the host launches it once, not kernel by kernel."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

WARM_UP = 3  # steps of a shape before its capture, in which kernels are chosen and lasting tensors are made

Step = Callable[[dict[str, Any]], dict[str, Tensor]]
Shapes = frozenset[tuple[str, torch.Size]]  # of a batch's tensors, by their names


class Captured(NamedTuple):
    """The step of one shape."""

    graph: torch.cuda.CUDAGraph
    batch: dict[str, Tensor]  # that it reads
    terms: dict[str, Tensor]  # that it writes


class GraphedStep:
    """Captures ``step`` at each shape that came a few times, and from then on replays it there.

    Nothing in the step may wait for the GPU, and its result is only valid until the next call. So all graphs
    may work in the same memory.

    Args:
        step: forward to optimizer, of one batch; returns its detached loss terms.
        optimizer: its learning rates become tensors, which schedules write to.

    Raises:
        ValueError: the optimizer is not fused.
    """

    def __init__(self, step: Step, optimizer: torch.optim.Optimizer) -> None:
        self.step, self.groups = step, optimizer.param_groups
        for group in self.groups:
            if not group.get("fused"):
                raise ValueError(
                    "trainer.cuda_graph=true needs a fused optimizer: torch's Adam, AdamW or SGD"
                )
            group["lr"] = torch.as_tensor(group["lr"], dtype=torch.float32, device=group["params"][0].device)
        self.stream, self.calls = torch.cuda.Stream(), Counter[Shapes]()
        self.pool = torch.cuda.graph_pool_handle()
        self.captured: dict[Shapes, Captured] = {}

    def __call__(self, batch: dict[str, Any]) -> dict[str, Tensor]:
        """Train on a batch; return its loss terms."""
        tensors = {name: value for name, value in batch.items() if isinstance(value, Tensor)}
        shapes: Shapes = frozenset((name, value.shape) for name, value in tensors.items())
        if shapes not in self.captured:
            self.calls[shapes] += 1
            if self.calls[shapes] <= WARM_UP:
                return self._uncaptured(batch)
            self.captured[shapes] = self._capture(batch, tensors)
        graph, own, terms = self.captured[shapes]
        for name, value in tensors.items():
            own[name].copy_(value, non_blocking=True)
        graph.replay()
        return terms

    def _capture(self, batch: dict[str, Any], tensors: Mapping[str, Tensor]) -> Captured:
        own = {name: value.clone() for name, value in tensors.items()}
        self._set_capturable(True)
        graph = torch.cuda.CUDAGraph()
        # the loader's thread may pin memory meanwhile
        with torch.cuda.graph(graph, pool=self.pool, stream=self.stream, capture_error_mode="thread_local"):
            terms = self.step(batch | own)
        self._set_capturable(False)
        return Captured(graph, own, terms)

    def _set_capturable(self, on: bool) -> None:
        """Tell the optimizer that it is captured; torch warns of it in steps that are not."""
        for group in self.groups:
            group["capturable"] = on

    def _uncaptured(self, batch: dict[str, Any]) -> dict[str, Tensor]:
        """Run the step once, on the stream of the captures."""
        current = torch.cuda.current_stream()
        self.stream.wait_stream(current)
        with torch.cuda.stream(self.stream):
            terms = self.step(batch)
        current.wait_stream(self.stream)
        return terms

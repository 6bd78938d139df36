"""A training step as one CUDA graph: the host launches it once, not kernel by kernel."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

WARM_UP = 3  # steps of a shape before its capture, in which kernels are chosen and lasting tensors are made

Step = Callable[[dict[str, Any]], dict[str, Tensor]]
Shapes = frozenset[tuple[str, torch.Size]]  # of a batch's tensors, by their names


class GraphedStep:
    """Captures ``step`` at the shapes that first came a few times, and from then on replays it.

    Nothing in the step may wait for the GPU, and its result is only valid until the next call. A batch of
    other shapes runs without the graph.

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
        self.graph: torch.cuda.CUDAGraph | None = None
        self.batch: dict[str, Tensor] = {}
        self.terms: dict[str, Tensor] = {}

    def __call__(self, batch: dict[str, Any]) -> dict[str, Tensor]:
        """Train on a batch; return its loss terms."""
        tensors = {name: value for name, value in batch.items() if isinstance(value, Tensor)}
        if self.graph is None:
            self.calls[_shapes(tensors)] += 1
            if self.calls[_shapes(tensors)] <= WARM_UP:
                return self._beside(batch)
            self.batch = {name: value.clone() for name, value in tensors.items()}
            self._set_capturable(True)
            self.graph = torch.cuda.CUDAGraph()
            # the loader's thread may pin memory meanwhile
            with torch.cuda.graph(self.graph, stream=self.stream, capture_error_mode="thread_local"):
                self.terms = self.step(batch | self.batch)
            self._set_capturable(False)
        elif _shapes(tensors) != _shapes(self.batch):
            return self._beside(batch)
        for name, value in tensors.items():
            self.batch[name].copy_(value, non_blocking=True)
        self.graph.replay()
        return self.terms

    def _set_capturable(self, on: bool) -> None:
        """Tell the optimizer that it is captured; torch warns of it in steps that are not."""
        for group in self.groups:
            group["capturable"] = on

    def _beside(self, batch: dict[str, Any]) -> dict[str, Tensor]:
        """Run the step on the stream of the capture."""
        current = torch.cuda.current_stream()
        self.stream.wait_stream(current)
        with torch.cuda.stream(self.stream):
            terms = self.step(batch)
        current.wait_stream(self.stream)
        return terms


def _shapes(tensors: Mapping[str, Tensor]) -> Shapes:
    return frozenset((name, value.shape) for name, value in tensors.items())

"""Averages: of a network's weights over updates, of gradients over processes."""

from copy import deepcopy
from typing import Any

import torch
from torch import nn


class WeightAverage:
    """Exponential moving average of a model's weights; often better than those of the last update.

    Args:
        decay: weight of the average at each update. It is at most (1 + n) / (10 + n) after n updates, so
            that the random start is soon forgotten.
    """

    def __init__(self, model: nn.Module, decay: float) -> None:
        if not 0 < decay < 1:
            raise ValueError(f"ema_decay={decay}: give a number between 0 and 1, such as 0.999")
        self.decay = decay
        self.model: Any = deepcopy(model).eval().requires_grad_(False)

    @torch.no_grad()
    def update(self, model: nn.Module, updates: int) -> None:
        """Average in ``model`` after its update number ``updates``; copy buffers (BatchNorm's)."""
        decay = min(self.decay, (1 + updates) / (10 + updates))
        torch._foreach_lerp_(list(self.model.parameters()), list(model.parameters()), 1 - decay)
        for is_float in (True, False):  # one kernel takes tensors of one kind
            kept, current = (
                [buffer for buffer in net.buffers() if buffer.is_floating_point() == is_float]
                for net in (self.model, model)
            )
            if kept:
                torch._foreach_copy_(kept, current)


def average_gradients(module: nn.Module, accelerator: Any) -> None:
    """Average gradients over all processes, for a module that DDP does not wrap."""
    if accelerator.num_processes > 1:
        for parameter in module.parameters():
            parameter.grad = accelerator.reduce(parameter.grad, "mean")

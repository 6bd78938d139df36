"""Means: of a network's weights over the steps, of gradients over the processes."""

from copy import deepcopy
from typing import Any

import torch
from torch import nn


class WeightAverage:
    """A copy of ``model`` whose weights follow it slowly; often better than the last step's own.

    Args:
        model: that is trained.
        decay: share that stays per update. Young averages follow faster, by (1 + n) / (10 + n) after n
            updates: else the random start would be remembered for 1 / (1 - decay) of them.
    """

    def __init__(self, model: nn.Module, decay: float) -> None:
        if not 0 < decay < 1:
            raise ValueError(f"ema_decay={decay}: a number between 0 and 1 is needed, such as 0.999")
        self.decay = decay
        self.model: Any = deepcopy(model).eval().requires_grad_(False)

    @torch.no_grad()
    def update(self, model: nn.Module, updates: int) -> None:
        """Follow ``model`` after its update number ``updates``; buffers (BatchNorm's) are copied."""
        decay = min(self.decay, (1 + updates) / (10 + updates))
        for mean, value in zip(self.model.parameters(), model.parameters(), strict=True):
            mean.lerp_(value, 1 - decay)
        for kept, current in zip(self.model.buffers(), model.buffers(), strict=True):
            kept.copy_(current)


def average_gradients(module: nn.Module, accelerator: Any) -> None:
    """Give every process the mean of their gradients, for a module that DDP does not wrap."""
    if accelerator.num_processes > 1:
        for parameter in module.parameters():
            parameter.grad = accelerator.reduce(parameter.grad, "mean")

"""Optimizers with a separate learning rate for the backbone, and learning rate schedules."""

import functools
import inspect
import math
from collections.abc import Callable, Sequence

from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR, ReduceLROnPlateau


def _warmup_steps(fraction: float, total_steps: int) -> int:
    if not 0 <= fraction <= 1:
        raise ValueError(f"scheduler.warmup_fraction={fraction:g}: give a share of the training, 0 to 1")
    return round(fraction * total_steps)


def _warm(step: int, warmup_steps: int) -> float:
    return min(1.0, (step + 1) / (warmup_steps + 1))


def constant(
    optimizer: Optimizer, total_steps: int, steps_per_epoch: int, *, warmup_fraction: float = 0.0
) -> LambdaLR:
    """Constant rate after a linear warm-up over ``warmup_fraction`` of the training."""
    warmup_steps = _warmup_steps(warmup_fraction, total_steps)
    return LambdaLR(optimizer, lambda step: _warm(step, warmup_steps))


def cosine(
    optimizer: Optimizer,
    total_steps: int,
    steps_per_epoch: int,
    *,
    warmup_fraction: float = 0.05,
    final: float = 0.0,
) -> LambdaLR:
    """Linear warm-up over ``warmup_fraction`` of the training, then a cosine down to ``final`` x the rate."""
    warmup_steps = _warmup_steps(warmup_fraction, total_steps)

    def factor(step: int) -> float:
        if step < warmup_steps:
            return _warm(step, warmup_steps)
        progress = min(1.0, (step - warmup_steps) / max(1, total_steps - warmup_steps))
        return final + (1 - final) * 0.5 * (1 + math.cos(math.pi * progress))

    return LambdaLR(optimizer, factor)


def one_cycle(
    optimizer: Optimizer,
    total_steps: int,
    steps_per_epoch: int,
    *,
    max_lr_factor: float = 10.0,
    warmup_fraction: float = 0.1,
) -> LambdaLR:
    """Rise from the optimizer's rate to ``max_lr_factor`` x that rate, then fall to zero along a cosine.

    The rise takes ``warmup_fraction`` of the training. Smith & Topin 2018 ("super-convergence"): small
    networks with batch normalization tolerate large rates and learn faster with them.
    """
    warmup_steps = max(1, _warmup_steps(warmup_fraction, total_steps))

    def factor(step: int) -> float:
        if step < warmup_steps:
            return 1 + (max_lr_factor - 1) * step / warmup_steps
        progress = min(1.0, (step - warmup_steps) / max(1, total_steps - warmup_steps))
        return max_lr_factor * 0.5 * (1 + math.cos(math.pi * progress))

    return LambdaLR(optimizer, factor)


def epoch_decay(
    optimizer: Optimizer, total_steps: int, steps_per_epoch: int, *, decay: float = 0.9
) -> LambdaLR:
    """Multiply the rate by ``decay`` after every epoch: our reading of the paper's "weight decay 0.9"."""
    return LambdaLR(optimizer, lambda step: decay ** (step // steps_per_epoch))


def plateau(
    optimizer: Optimizer, total_steps: int, steps_per_epoch: int, *, factor: float = 0.5, patience: int = 3
) -> ReduceLROnPlateau:
    """Multiply the rate by ``factor`` after more than ``patience`` validations without a better one."""
    return ReduceLROnPlateau(optimizer, factor=factor, patience=patience, threshold=0.0, threshold_mode="abs")


def fused(make: Callable[..., Optimizer]) -> Callable[..., Optimizer]:
    """Let an optimizer update all weights in one kernel, if it can and its settings do not choose how."""
    given = make.keywords if isinstance(make, functools.partial) else {}
    known = "fused" in inspect.signature(make).parameters
    return functools.partial(make, fused=True) if known and not {"fused", "foreach"} & given.keys() else make


def frozen_parts(model: nn.Module, names: Sequence[str]) -> list[nn.Module]:
    """Return the parts of a model's network with these names, whose weights no longer learn.

    "batchnorm" names every BatchNorm.

    Raises:
        ValueError: there is no such part, or nothing is left to learn.
    """
    network = getattr(model, "network", model)
    parts = dict(network.named_modules())
    choices = [name for name, _ in network.named_children()]
    if norms := [part for part in parts.values() if isinstance(part, _BatchNorm)]:
        parts["batchnorm"] = nn.ModuleList(norms)
        choices.append("batchnorm")
    for name in names:
        if name not in parts or not name:
            raise ValueError(f"freeze={name}: this network has no such part; it has {', '.join(choices)}")
        parts[name].requires_grad_(False)
    if not any(parameter.requires_grad for parameter in model.parameters()):
        raise ValueError(f"freeze={list(names)} leaves nothing to learn: leave a part out")
    return [parts[name] for name in names]


def build_optimizer(
    make: Callable[..., Optimizer], model: nn.Module, loss: nn.Module, *, backbone_lr_factor: float = 1.0
) -> Optimizer:
    """Make an optimizer of all parameters; the backbone's learn at ``backbone_lr_factor`` x its rate.

    A trained backbone forgets what it knows at the rate that a new decoder needs (Howard & Ruder 2018,
    "discriminative fine-tuning").

    Raises:
        ValueError: the network has no backbone to slow down, or the factor is negative.
    """
    if not backbone_lr_factor >= 0:
        raise ValueError(
            f"backbone_lr_factor={backbone_lr_factor}: give 0 (frozen except for its statistics) or more"
        )
    every = [p for p in (*model.parameters(), *loss.parameters()) if p.requires_grad]
    if backbone_lr_factor == 1:
        return make(every)
    backbone = getattr(getattr(model, "network", None), "backbone", None)
    if backbone is None:
        raise ValueError(
            f"backbone_lr_factor={backbone_lr_factor}: this network has no separate backbone, give 1"
        )
    slow = [parameter for parameter in backbone.parameters() if parameter.requires_grad]
    known = {id(parameter) for parameter in slow}
    optimizer = make([{"params": [p for p in every if id(p) not in known]}, {"params": slow}])
    optimizer.param_groups[1]["lr"] *= backbone_lr_factor
    return optimizer

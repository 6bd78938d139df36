"""Learning rates: of the backbone beside the rest, and schedules, as factors of the optimizer's own rate."""

import math
from collections.abc import Callable

from torch import nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR


def _warm(step: int, warmup_steps: int) -> float:
    return min(1.0, (step + 1) / (warmup_steps + 1))


def constant(
    optimizer: Optimizer, total_steps: int, steps_per_epoch: int, *, warmup: float = 0.0
) -> LambdaLR:
    """Constant rate after a linear warm-up over the share ``warmup`` of the training."""
    warmup_steps = round(warmup * total_steps)
    return LambdaLR(optimizer, lambda step: _warm(step, warmup_steps))


def cosine(
    optimizer: Optimizer, total_steps: int, steps_per_epoch: int, *, warmup: float = 0.05, final: float = 0.0
) -> LambdaLR:
    """Linear warm-up over the share ``warmup``, then half a cosine down to the share ``final``."""
    warmup_steps = round(warmup * total_steps)

    def factor(step: int) -> float:
        if step < warmup_steps:
            return _warm(step, warmup_steps)
        progress = min(1.0, (step - warmup_steps) / max(1, total_steps - warmup_steps))
        return final + (1 - final) * 0.5 * (1 + math.cos(math.pi * progress))

    return LambdaLR(optimizer, factor)


def one_cycle(
    optimizer: Optimizer, total_steps: int, steps_per_epoch: int, *, peak: float = 10.0, warmup: float = 0.1
) -> LambdaLR:
    """Up from the optimizer's rate to ``peak`` times it over the share ``warmup``, then a cosine to zero.

    Smith & Topin 2018 ("super-convergence"): small networks with batch normalization bear large rates, and
    learn the faster for it.
    """
    warmup_steps = max(1, round(warmup * total_steps))

    def factor(step: int) -> float:
        if step < warmup_steps:
            return 1 + (peak - 1) * step / warmup_steps
        progress = min(1.0, (step - warmup_steps) / max(1, total_steps - warmup_steps))
        return peak * 0.5 * (1 + math.cos(math.pi * progress))

    return LambdaLR(optimizer, factor)


def epoch_decay(
    optimizer: Optimizer, total_steps: int, steps_per_epoch: int, *, decay: float = 0.9
) -> LambdaLR:
    """The rate is multiplied by ``decay`` after every epoch: the paper's "weight decay 0.9", read so."""
    return LambdaLR(optimizer, lambda step: decay ** (step // steps_per_epoch))


def build_optimizer(
    make: Callable[..., Optimizer], model: nn.Module, loss: nn.Module, *, backbone_lr: float = 1.0
) -> Optimizer:
    """An optimizer of all parameters; the backbone's learn at ``backbone_lr`` times its rate.

    A trained backbone forgets at the rate that a new decoder needs (Howard & Ruder 2018, "discriminative
    fine-tuning").

    Raises:
        ValueError: the network has no backbone to slow down, or the factor is negative.
    """
    if not backbone_lr >= 0:
        raise ValueError(f"backbone_lr={backbone_lr}: 0 (frozen but for its statistics) or more is needed")
    every = [*model.parameters(), *loss.parameters()]
    if backbone_lr == 1:
        return make(every)
    backbone = getattr(getattr(model, "network", None), "backbone", None)
    if backbone is None:
        raise ValueError(
            f"backbone_lr={backbone_lr}: this network has no backbone apart from the rest, give 1"
        )
    slow = list(backbone.parameters())
    known = {id(parameter) for parameter in slow}
    optimizer = make([{"params": [p for p in every if id(p) not in known]}, {"params": slow}])
    optimizer.param_groups[1]["lr"] *= backbone_lr
    return optimizer

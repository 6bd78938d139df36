"""Maps, masks and gradients that the tests of losses share."""

from collections.abc import Callable

import torch
from torch import Tensor


def maps(
    seed: int, *, size: tuple[int, int] = (16, 20), batch: int = 2, dtype=torch.float32
) -> tuple[Tensor, Tensor]:
    """Prediction and target ``(B, 1, H, W)``, 0.5 to 8.5 m."""
    generator = torch.Generator().manual_seed(seed)
    shape = (batch, 1, *size)
    return tuple(0.5 + 8 * torch.rand(shape, generator=generator, dtype=dtype) for _ in range(2))


def patchy(seed: int, shape: tuple[int, ...], share: float) -> Tensor:
    """A mask of which about this share is False."""
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed)) >= share


def value_and_gradient(loss: Callable[..., Tensor], prediction: Tensor, target: Tensor, mask: Tensor):
    prediction = prediction.clone().requires_grad_()
    value = loss(prediction, target, mask)
    (gradient,) = torch.autograd.grad(value, prediction)
    return value.detach(), gradient

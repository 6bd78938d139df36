"""What a loss is, and the weighted sum that training minimises."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn


class Loss(nn.Module):
    """Scalar loss over the pixels that ``mask`` allows.

    A masked pixel has no influence: not on the value, not on any gradient, whatever it holds.
    """

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``prediction`` and ``target (B, 1, H, W)`` [m], ``mask (B, 1, H, W)`` bool -> scalar."""
        raise NotImplementedError


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean of ``values`` where ``mask``; 0 where nothing is known, so that an empty batch does no harm.

    Values outside the mask are replaced, not multiplied by zero: 0 x NaN would be NaN.
    """
    return values.masked_fill(~mask, 0.0).sum() / mask.sum().clamp(min=1)


def neutralise(prediction: Tensor, target: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Set masked pixels of both maps to 1 m, so that logarithms, ratios and windows stay finite there."""
    return prediction.masked_fill(~mask, 1.0), target.masked_fill(~mask, 1.0)


class WeightedTerm(nn.Module):
    """One named term of the sum: ``weight * loss``."""

    def __init__(self, loss: Loss, weight: float = 1.0) -> None:
        super().__init__()
        if weight < 0:
            raise ValueError(f"weight={weight}: a loss weight is 0 or more")
        self.loss, self.weight = loss, weight


class WeightedSum(nn.Module):
    """``total = sum of weight * term``; every term is reported by its name.

    Args:
        terms: name -> :class:`WeightedTerm`.
    """

    def __init__(self, terms: Mapping[str, WeightedTerm]) -> None:
        super().__init__()
        if not terms:
            raise ValueError("a loss needs at least one term")
        self.terms = nn.ModuleDict(dict(terms))

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """``(B, 1, H, W)`` [m] each, mask bool -> total and the unweighted terms by name."""
        if prediction.shape != target.shape or target.shape != mask.shape:
            raise ValueError(
                f"prediction {tuple(prediction.shape)}, target {tuple(target.shape)} and mask "
                f"{tuple(mask.shape)} must have one shape"
            )
        if mask.dtype != torch.bool:
            raise ValueError(f"mask is {mask.dtype}: a bool tensor is needed, True where depth is known")
        values = {name: term.loss(prediction, target, mask) for name, term in self.terms.items()}
        total = sum(self.terms[name].weight * value for name, value in values.items())
        return total, values  # type: ignore[return-value]

"""What a loss is, and the weighted sum that training minimizes."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import torch
from torch import Tensor, nn

Autocast = Callable[[], AbstractContextManager[Any]]
"""Makes the context of a precision, as ``Accelerator.autocast`` does."""


class Loss(nn.Module):
    """Scalar loss over the pixels that ``mask`` allows.

    A masked pixel has no influence: not on the value, not on any gradient, whatever it holds.

    Attributes:
        spaces: in which the loss makes sense, see :class:`WeightedTerm`.
    """

    spaces: tuple[str, ...] = ("meters", "log", "inverse")

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


SPACES: dict[str, Callable[[Tensor], Tensor]] = {
    "meters": lambda depth: depth,
    "log": torch.log,
    "inverse": torch.reciprocal,
}


class WeightedTerm(nn.Module):
    """One named term of the sum: ``weight * loss``.

    Args:
        loss: of the two maps.
        weight: 0 or more.
        space: in which the two maps are compared: "meters"; "log" (errors count by their ratio, as AbsRel and
            delta count it); "inverse" (1 / m: near counts most; DenseDepth's).
    """

    def __init__(self, loss: Loss, weight: float = 1.0, space: str = "meters") -> None:
        super().__init__()
        if weight < 0:
            raise ValueError(f"weight={weight}: a loss weight is 0 or more")
        if space not in SPACES:
            raise ValueError(f"space={space!r}: choose one of {tuple(SPACES)}")
        if space not in loss.spaces:
            raise ValueError(f"{type(loss).__name__} compares in {loss.spaces} only, not in space={space!r}")
        self.loss, self.weight, self.space = loss, weight, space

    @property
    def identity(self) -> Mapping[str, Any]:
        """What must be the same for a training to go on, beside the settings; nothing as a rule."""
        return {}

    def attach(self, student: nn.Module, autocast: Autocast = nullcontext) -> None:
        """Called once, before the first step: what is trained, and the precision that it runs in."""

    def forward(
        self, prediction: Tensor, target: Tensor, mask: Tensor, image: Tensor | None = None
    ) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool -> scalar, not weighted; few terms look at ``image``."""
        if self.space != "meters":
            prediction, target = (SPACES[self.space](m) for m in neutralise(prediction, target, mask))
        return self.loss(prediction, target, mask)


class WeightedSum(nn.Module):
    """``total = sum of weight * term``; every term is reported by its name.

    Args:
        terms: name -> :class:`WeightedTerm`.
    """

    def __init__(self, terms: Mapping[str, WeightedTerm]) -> None:
        super().__init__()
        if not terms:
            raise ValueError("a loss needs at least one term")
        self.terms: Mapping[str, WeightedTerm] = nn.ModuleDict(dict(terms))  # type: ignore[assignment]

    @property
    def identity(self) -> dict[str, Mapping[str, Any]]:
        """Of the terms that have one, by their names (a teacher's)."""
        found = {name: term.identity for name, term in self.terms.items()}
        return {name: identity for name, identity in found.items() if identity}

    def attach(self, student: nn.Module, autocast: Autocast = nullcontext) -> None:
        """Show every term the network that is trained, and the context that it runs in."""
        for term in self.terms.values():
            term.attach(student, autocast)

    def forward(
        self, prediction: Tensor, target: Tensor, mask: Tensor, image: Tensor | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """``(B, 1, H, W)`` [m] each, mask bool, image ``(B, 3, H, W)`` -> total, unweighted terms by name."""
        if prediction.shape != target.shape or target.shape != mask.shape:
            raise ValueError(
                f"prediction {tuple(prediction.shape)}, target {tuple(target.shape)} and mask "
                f"{tuple(mask.shape)} must have one shape"
            )
        if mask.dtype != torch.bool:
            raise ValueError(f"mask is {mask.dtype}: a bool tensor is needed, True where depth is known")
        values = {name: term(prediction, target, mask, image) for name, term in self.terms.items()}
        total = torch.stack([self.terms[name].weight * value for name, value in values.items()]).sum()
        return total, values

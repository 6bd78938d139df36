"""The base class of losses, and the weighted sum that training minimizes."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from eldenet.system.checks import one_of
from eldenet.uncertainty import NO_SIGMA

Autocast = Callable[[], AbstractContextManager[Any]]
"""Returns a mixed-precision context, as ``Accelerator.autocast`` does."""


class LossInputs(NamedTuple):
    """What a step of training knows about its batch.

    Attributes:
        prediction: depth ``(B, 1, H, W)`` [m].
        target: true depth ``(B, 1, H, W)`` [m].
        mask: ``(B, 1, H, W)`` bool, True where the true depth is known.
        image: ``(B, 3, H, W)`` RGB in [0, 1], for terms with a teacher.
        focal: ``(B,)`` fx [px of ``image``] of the camera that took it; None: unknown.
        relative: ``(B,)`` bool, True where a sample's depth is known up to a factor only; None: nowhere.
        spread: ``(B, 1, H, W)`` the network's standard deviation of ln depth, if it predicts one.
        ratio: ``(B, 1, 1, 1)`` meters of that camera per meter of both maps; None: 1.
    """

    prediction: Tensor
    target: Tensor
    mask: Tensor
    image: Tensor | None = None
    focal: Tensor | None = None
    relative: Tensor | None = None
    spread: Tensor | None = None
    ratio: Tensor | None = None


class Loss(nn.Module):
    """Base of losses: a scalar over the pixels where ``mask`` is True.

    A masked pixel affects neither the value nor any gradient, whatever it holds (NaN and infinity too).

    Attributes:
        spaces: spaces in which the loss can compare two maps, see :class:`WeightedTerm`.
    """

    spaces: tuple[str, ...] = ("meters", "log", "inverse")

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``prediction`` and ``target (B, 1, H, W)`` [m], ``mask (B, 1, H, W)`` bool -> scalar."""
        raise NotImplementedError


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Return the mean, a scalar, of ``values`` where ``mask`` is True; 0 where it is False everywhere.

    Values outside the mask are replaced, not multiplied by zero: 0 x NaN would be NaN.
    """
    return values.masked_fill(~mask, 0.0).sum() / mask.sum().clamp(min=1)


def check_maps(prediction: Tensor, target: Tensor, mask: Tensor) -> None:
    """Raise ValueError unless all are ``(B, 1, H, W)``: others would broadcast, image against image."""
    if prediction.ndim != 4 or not prediction.shape == target.shape == mask.shape:
        maps = {"prediction": prediction, "target": target, "mask": mask}
        found = ", ".join(f"{name} {tuple(each.shape)}" for name, each in maps.items())
        raise ValueError(f"{found}: give maps of the same shape (B, 1, H, W)")


def fill_masked(prediction: Tensor, target: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Set masked pixels of maps ``(B, 1, H, W)`` to 1 m: logarithms, ratios and windows stay finite there.

    Raises:
        ValueError: the maps differ in shape.
    """
    check_maps(prediction, target, mask)
    return prediction.masked_fill(~mask, 1.0), target.masked_fill(~mask, 1.0)


SPACES: dict[str, Callable[[Tensor], Tensor]] = {
    "meters": lambda depth: depth,
    "log": torch.log,
    "inverse": torch.reciprocal,
}


class WeightedTerm(nn.Module):
    """One term of the sum: ``weight * loss``.

    Args:
        weight: 0 or more.
        space: space in which the maps are compared: "meters"; "log" (errors count by their ratio, as in
            AbsRel and delta); "inverse" (1 / m, where near pixels count most, as in DenseDepth).
        applies_to: which samples count: those whose depth is known in meters ("metric"), or up to a factor
            only ("relative").

    Raises:
        ValueError: an unknown space or kind of samples, a space that the loss does not support, or something
            else than a Loss.

    Attributes:
        needs_depth: whether it counts only pixels whose depth is known.
        needs_spread: whether it learns from the network's own uncertainty.
    """

    needs_depth = True
    needs_spread = False

    def __init__(
        self, loss: Loss, weight: float = 1.0, space: str = "meters", applies_to: str = "metric"
    ) -> None:
        super().__init__()
        one_of("applies_to", applies_to, ("metric", "relative"))
        one_of("space", space, SPACES)
        if not isinstance(loss, Loss):
            raise ValueError(
                f"loss={type(loss).__name__}: derive it from eldenet.losses.base.Loss, with "
                "forward(prediction, target, mask)"
            )
        if space not in loss.spaces:
            raise ValueError(
                f"space={space!r} does not fit {type(loss).__name__}: choose one of {', '.join(loss.spaces)}"
            )
        self.loss, self.weight, self.space, self.applies_to = loss, weight, space, applies_to

    @property
    def signature(self) -> Mapping[str, Any]:
        """Facts beside the config that must stay the same when a training resumes; none by default."""
        return {}

    def setup(self, student: nn.Module, autocast: Autocast = nullcontext) -> None:
        """Prepare the term before the first step."""

    def forward(self, inputs: LossInputs) -> Tensor:
        """Return the term without its weight, a scalar."""
        prediction, target, mask = inputs[:3]
        if self.space != "meters":
            prediction, target = (SPACES[self.space](m) for m in fill_masked(prediction, target, mask))
        return self.loss(prediction, target, mask)


class WeightedSum(nn.Module):
    """``total = sum of weight * term``; also returns each term by its name, for the log.

    Raises:
        ValueError: no terms, or all weights are 0.
    """

    def __init__(self, terms: Mapping[str, WeightedTerm]) -> None:
        super().__init__()
        if not any(term.weight for term in terms.values()):
            raise ValueError(
                f"all weights of the loss are 0 ({', '.join(terms)}), so it would teach nothing: give one of "
                "them a weight above 0"
            )
        self.terms: Mapping[str, WeightedTerm] = nn.ModuleDict(dict(terms))  # type: ignore[assignment]

    @property
    def signature(self) -> dict[str, Mapping[str, Any]]:
        """Signatures of the terms that have one, by name."""
        signatures = {name: term.signature for name, term in self.terms.items()}
        return {name: signature for name, signature in signatures.items() if signature}

    @property
    def needs_depth(self) -> bool:
        """Whether it teaches nothing where no depth is known."""
        return all(term.needs_depth for term in self.terms.values() if term.weight)

    @property
    def needs_spread(self) -> bool:
        """Whether a term learns from the network's own uncertainty."""
        return any(term.needs_spread for term in self.terms.values())

    def setup(self, student: nn.Module, autocast: Autocast = nullcontext) -> None:
        """Prepare every term before the first step, see :meth:`WeightedTerm.setup`."""
        for term in self.terms.values():
            term.setup(student, autocast)

    def forward(self, inputs: LossInputs) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the total, a scalar, and the unweighted terms by name.

        Raises:
            ValueError: the maps differ in shape, or a term needs a spread.
        """
        check_maps(*inputs[:3])
        if self.needs_spread and inputs.spread is None:
            raise ValueError(NO_SIGMA)
        mask = inputs.mask
        is_relative = mask.new_zeros(len(mask)) if inputs.relative is None else inputs.relative
        is_relative = is_relative.view(-1, 1, 1, 1)
        known = {"metric": mask & ~is_relative, "relative": mask & is_relative}
        values = {
            name: term(inputs._replace(mask=known[term.applies_to])) for name, term in self.terms.items()
        }
        total = torch.stack([self.terms[name].weight * value for name, value in values.items()]).sum()
        return total, values

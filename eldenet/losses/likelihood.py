"""Negative log-likelihood of the true depth under a network's own uncertainty."""

import math

import torch
from torch import Tensor

from eldenet.losses.base import Loss, LossInputs, WeightedTerm, fill_masked, masked_mean
from eldenet.system.checks import one_of
from eldenet.uncertainty import DISTRIBUTIONS


def negative_log_likelihood(error: Tensor, spread: Tensor, distribution: str) -> Tensor:
    """Per pixel, of ``error`` (of ln depth) with standard deviation ``spread``; any one shape.

    Kendall & Gal 2017, eq. 5 (normal); of a Laplace distribution of scale b: ``|error| / b + ln 2b``.
    """
    if distribution == "laplace":
        scale = spread / math.sqrt(2)
        return error.abs() / scale + (2 * scale).log()
    return 0.5 * (error / spread).square() + spread.log() + 0.5 * math.log(2 * math.pi)


class _Likelihood(Loss):
    """Stands for the loss of :class:`LikelihoodTerm`, which needs a spread too."""

    spaces = ("log",)


class LikelihoodTerm(WeightedTerm):
    """``weight`` x the mean negative log-likelihood of ln depth.

    Args:
        weight: 0 or more.
        distribution: "laplace" or "gaussian", as the head's.
        detach_depth: the term's gradient reaches the spread alone, not the depth. Otherwise depth also learns
            from it, most where the network is sure.

    Raises:
        ValueError: an unknown distribution.
    """

    needs_spread = True

    def __init__(
        self, weight: float = 1.0, *, distribution: str = "laplace", detach_depth: bool = True
    ) -> None:
        super().__init__(_Likelihood(), weight, "log")
        one_of("distribution", distribution, DISTRIBUTIONS)
        self.distribution, self.detach_depth = distribution, detach_depth

    def forward(self, inputs: LossInputs) -> Tensor:
        """Return the term without its weight, a scalar; it needs ``spread``."""
        prediction, target, mask = inputs[:3]
        assert inputs.spread is not None  # WeightedSum has checked it
        prediction, target = fill_masked(prediction, target, mask)
        error = target.log() - (prediction.detach() if self.detach_depth else prediction).log()
        spread = inputs.spread.masked_fill(~mask, 1.0)
        with torch.autocast(prediction.device.type, enabled=False):
            nll = negative_log_likelihood(error.float(), spread.float(), self.distribution)
        return masked_mean(nll, mask)

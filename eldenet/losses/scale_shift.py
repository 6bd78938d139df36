"""Loss for depth that is known up to a factor or a shift, as that of teachers for any photograph."""

import torch
from torch import Tensor

from eldenet.losses.base import Loss, check_maps


class ScaleShiftInvariantLoss(Loss):
    """Mean absolute error after both maps of an image have the same median and, by default, the same spread.

    Source: MiDaS (Ranftl et al. 2020, "Towards Robust Monocular Depth Estimation", eqs. 5, 6 and 11): the
    median is the shift, the mean distance from it the scale; gradients of the error are compared at several
    resolutions. The paper divides the sum of a gradient by the number of known pixels; here it is divided by
    the number of pairs of known neighbors, so that holes do not make the term small. MiDaS compares
    disparity (``space: inverse``). In ``space: log``, a shift is a factor on depth: with
    ``match_scale=False`` depth may be wrong by a factor alone, as that of a metric network in front of
    another lens.

    Args:
        match_scale: divide each map by its spread.
        gradient_weight: of the gradient term; 0: none.
        scales: of the gradient term; each halves the resolution.
    """

    def __init__(self, match_scale: bool = True, gradient_weight: float = 0.5, scales: int = 4) -> None:
        super().__init__()
        self.match_scale, self.gradient_weight, self.scales = match_scale, gradient_weight, scales

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` each, mask bool -> scalar: the mean over the images that have known pixels."""
        check_maps(prediction, target, mask)
        error = self._centered(prediction, mask) - self._centered(target, mask)
        total = _mean(error.abs(), mask)
        for step in range(self.scales if self.gradient_weight else 0):
            small, seen = error[..., :: 2**step, :: 2**step], mask[..., :: 2**step, :: 2**step]
            for axis in (-1, -2):
                size = small.shape[axis] - 1
                first, second = (small.narrow(axis, start, size) for start in (0, 1))
                both = seen.narrow(axis, 0, size) & seen.narrow(axis, 1, size)
                total = total + self.gradient_weight * _mean((second - first).abs(), both)
        known = mask.flatten(1).any(1)  # an image without known pixels has a total of 0
        return total.sum() / known.sum().clamp(min=1)

    def _centered(self, values: Tensor, mask: Tensor) -> Tensor:
        """Values ``(B, 1, H, W)`` minus their image's median, over its spread; 0 where the mask is False."""
        flat, seen = values.flatten(1), mask.flatten(1)
        median = flat.masked_fill(~seen, torch.nan).nanmedian(dim=1).values
        centered = (values - median.view(-1, 1, 1, 1)).masked_fill(~mask, 0.0)
        if not self.match_scale:
            return centered
        return centered / _mean(centered.abs(), mask).clamp(min=1e-6).view(-1, 1, 1, 1)


def _mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean ``(B,)`` of each image's values where the mask is True."""
    return values.masked_fill(~mask, 0.0).flatten(1).sum(1) / mask.flatten(1).sum(1).clamp(min=1)

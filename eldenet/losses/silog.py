"""Scale-invariant logarithmic error."""

from torch import Tensor

from eldenet.losses.base import Loss, fill_masked


class SILogLoss(Loss):
    """``scale * sqrt(mean(g^2) - variance_focus * mean(g)^2)`` with ``g = ln prediction - ln target``.

    Convention: Eigen et al. 2014 (eq. 4) has a ``variance_focus`` of 0.5 and no root; BTS (Lee et al. 2019,
    eq. 4) has 0.85, the root and a scale of 10. Means run over all known pixels of the batch.

    Args:
        variance_focus: lambda of the papers; 1 ignores the scale altogether.
    """

    spaces = ("meters",)  # it takes the logarithm itself

    def __init__(self, variance_focus: float = 0.85, scale: float = 10.0) -> None:
        super().__init__()
        self.variance_focus, self.scale = variance_focus, scale

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool -> scalar."""
        prediction, target = fill_masked(prediction, target, mask)
        log_ratio = (prediction.log() - target.log()).masked_fill(~mask, 0.0)
        count = mask.sum().clamp(min=1)
        mean, mean_square = log_ratio.sum() / count, log_ratio.square().sum() / count
        # the root's slope is infinite at 0: a tiny floor keeps the gradient of a perfect prediction finite
        return self.scale * (mean_square - self.variance_focus * mean.square()).clamp(min=1e-12).sqrt()

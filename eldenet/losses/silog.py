"""Scale-invariant logarithmic error."""

from torch import Tensor

from eldenet.losses.base import Loss, neutralise


class SILogLoss(Loss):
    """``scale * sqrt(mean(g^2) - balance * mean(g)^2)`` with ``g = ln prediction - ln target``, per batch.

    Convention: Eigen et al. 2014 (eq. 4) has balance 0.5 and no root; BTS (Lee et al. 2019, eq. 4) balance
    0.85, the root and a scale of 10. Moments are taken over all known pixels of the batch.

    Args:
        balance: lambda; 1 is fully invariant to scale.
        scale: factor on the result.
    """

    spaces = ("meters",)  # it takes the logarithm itself

    def __init__(self, balance: float = 0.85, scale: float = 10.0) -> None:
        super().__init__()
        self.balance, self.scale = balance, scale

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool -> scalar."""
        prediction, target = neutralise(prediction, target, mask)
        log_ratio = (prediction.log() - target.log()).masked_fill(~mask, 0.0)
        count = mask.sum().clamp(min=1)
        mean, mean_square = log_ratio.sum() / count, log_ratio.square().sum() / count
        # the root's slope is infinite at 0: a tiny floor keeps a perfect prediction finite
        return self.scale * (mean_square - self.balance * mean.square()).clamp(min=1e-12).sqrt()

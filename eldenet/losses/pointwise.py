"""Losses that compare pixel by pixel: L1, L2, berHu."""

from torch import Tensor

from eldenet.losses.base import Loss, fill_masked, masked_mean


class L1Loss(Loss):
    """Mean absolute error [m].

    The paper's prose says sum. A mean keeps the weights of the loss right for any size of image.
    """

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool -> scalar [m]."""
        prediction, target = fill_masked(prediction, target, mask)
        return masked_mean((prediction - target).abs(), mask)


class L2Loss(Loss):
    """Mean squared error [m^2]."""

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool -> scalar [m^2]."""
        prediction, target = fill_masked(prediction, target, mask)
        return masked_mean((prediction - target).square(), mask)


class BerHuLoss(Loss):
    """Reverse Huber loss [m] (Laina et al. 2016, eq. 1): L1 below the threshold c, (e^2 + c^2) / 2c above.

    Args:
        threshold_ratio: c divided by the batch's largest error; 0.2 in the paper. c carries no gradient.
    """

    def __init__(self, threshold_ratio: float = 0.2) -> None:
        super().__init__()
        self.threshold_ratio = threshold_ratio

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool -> scalar [m]."""
        prediction, target = fill_masked(prediction, target, mask)
        error = (prediction - target).abs()
        threshold = (self.threshold_ratio * error.detach().max()).clamp(min=1e-6)
        quadratic = (error.square() + threshold.square()) / (2 * threshold)
        return masked_mean(error.where(error <= threshold, quadratic), mask)

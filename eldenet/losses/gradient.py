"""The gradient loss of DenseDepth, which compares depth edges."""

from torch import Tensor

from eldenet.losses.base import Loss, fill_masked, masked_mean


class GradientLoss(Loss):
    """Mean absolute error of the depth steps between neighboring pixels [m] (Alhashim & Wonka 2018, eq. 3).

    A step counts only where both of its pixels are known.
    """

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool -> scalar [m]."""
        prediction, target = fill_masked(prediction, target, mask)
        error = prediction - target
        across = masked_mean(error.diff(dim=-1).abs(), mask[..., 1:] & mask[..., :-1])
        down = masked_mean(error.diff(dim=-2).abs(), mask[..., 1:, :] & mask[..., :-1, :])
        return across + down

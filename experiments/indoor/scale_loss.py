"""The error of a picture's scale alone, as a term of the loss.

``PYTHONPATH=experiments/indoor python -m eldenet.train ... '+loss.terms.scale={...}'`` uses it.
"""

from torch import Tensor

from eldenet.losses.base import Loss


class ScaleLoss(Loss):
    """Mean over pictures of the distance between the mean logarithms of both maps."""

    spaces = ("log",)

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` ln m each, mask bool -> scalar; a picture without known depth counts 0."""
        error = (prediction - target).masked_fill(~mask, 0.0).flatten(1).sum(1)
        return (error / mask.flatten(1).sum(1).clamp(min=1)).abs().mean()

"""A network whose graph gives its sigma too."""

from torch import Tensor, nn

from eldenet.model import DepthNet


class SigmaNet(nn.Module):
    """Depth and standard deviation as two outputs, for exported files.

    Args:
        model: with a head that predicts its sigma.
    """

    def __init__(self, model: DepthNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """``image (B, 3, H, W)`` -> depth and sigma ``(B, 1, H, W)`` [m] each."""
        estimate = self.model.predict(image)
        return estimate.depth, estimate.sigma

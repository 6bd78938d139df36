"""Optional refinement of a depth map, guided by its image."""

from torch import Tensor, nn

from eldenet.configurable import Configurable


class JointBilateral(Configurable, nn.Module):
    """Joint bilateral filter of the depth, guided by the image (ELDE-Net section 3.4 and its ref. 65).

    Moves depth edges toward the image's edges and smooths within surfaces. It has no parameters to learn.

    Args:
        kernel_size: side of the window [px], odd.
        sigma_color: color difference at which weights fall off, for images in [0, 1].
        sigma_space: distance at which weights fall off [px].

    Raises:
        ValueError: an even window.
    """

    def __init__(self, kernel_size: int = 5, sigma_color: float = 0.1, sigma_space: float = 2.0) -> None:
        super().__init__()
        if kernel_size % 2 == 0:
            raise ValueError(f"kernel_size={kernel_size}: give an odd number of pixels")
        self.kernel_size, self.sigma_color, self.sigma_space = kernel_size, sigma_color, sigma_space

    def forward(self, depth: Tensor, image: Tensor) -> Tensor:
        """``depth (B, 1, H, W)`` [m], ``image (B, 3, H, W)`` -> refined depth ``(B, 1, H, W)`` [m]."""
        from kornia.filters import joint_bilateral_blur

        return joint_bilateral_blur(
            depth,
            image.to(depth.dtype),
            (self.kernel_size, self.kernel_size),
            self.sigma_color,
            (self.sigma_space, self.sigma_space),
        )

"""Refinement: depth edges follow the edges of the image."""

import pytest
import torch
from scipy.ndimage import gaussian_filter
from support.networks import picture, small_net
from torch import Tensor, nn

from eldenet.configurable import Configurable
from eldenet.refinement import JointBilateral


def scene() -> tuple[Tensor, Tensor]:
    """A step in the image at column 16, and the same step in depth, but blurred."""
    sharp = torch.full((1, 1, 24, 32), 1.0)
    sharp[..., 16:] = 5.0
    image = (sharp / 5).expand(-1, 3, -1, -1).contiguous()
    blurred = torch.from_numpy(gaussian_filter(sharp.numpy(), (0, 0, 0, 1.5), mode="nearest"))
    return blurred, image


def test_refined_depth_stays_within_its_range() -> None:
    depth = 1 + 4 * torch.rand(2, 1, 20, 30, generator=torch.Generator().manual_seed(0))
    refined = JointBilateral(7)(depth, torch.rand(2, 3, 20, 30))
    assert refined.shape == depth.shape
    assert depth.min() - 1e-5 <= refined.min() < refined.max() <= depth.max() + 1e-5
    assert refined.std() < depth.std()  # it does smooth


def test_refinement_follows_the_images_edges() -> None:
    depth, image = scene()
    refined = JointBilateral()(depth, image)[0, 0, 12]
    gaussian = JointBilateral(sigma_color=1e3)(depth, image)[0, 0, 12]  # all colors alike: a plain Gaussian
    jump = [float(line[16] - line[15]) for line in (gaussian, depth[0, 0, 12], refined)]
    assert jump[0] < jump[1] < jump[2]


def test_a_model_gives_the_image_to_its_refinement() -> None:
    seen: list[Tensor] = []

    class Keep(Configurable, nn.Module):
        def forward(self, depth: Tensor, image: Tensor) -> Tensor:
            seen.append(image)
            return depth + 1

    image = picture(32, 32)
    with torch.inference_mode():
        plain = small_net()(image)
        refined = small_net(refine=Keep())(image)
    assert torch.equal(refined, plain + 1)
    assert torch.equal(seen[0], image)


def test_even_windows_are_refused() -> None:
    with pytest.raises(ValueError, match="kernel_size=4: give an odd number"):
        JointBilateral(4)

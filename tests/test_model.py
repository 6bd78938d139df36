"""DepthNet: images in, meters out."""

import copy
import pickle

import pytest
import torch
from support.networks import picture, same_model, small_net
from torch import Tensor, nn

from eldenet.heads import Head, InverseHead, LinearHead, LogHead
from eldenet.model import DepthNet
from eldenet.refinement import JointBilateral

HEADS = [LinearHead, InverseHead, LogHead]


@pytest.mark.parametrize("head", HEADS)
@pytest.mark.parametrize("size", [(64, 96), (97, 131), (33, 47)])
def test_depth_has_the_images_size_and_the_heads_range(size: tuple[int, int], head: type[Head]) -> None:
    model = small_net(head=head(0.5, 4.0))
    with torch.inference_mode():
        depth = model(picture(*size))
    assert depth.shape == (1, 1, *size)
    assert depth.dtype == torch.float32
    assert 0.5 <= depth.min() < depth.max() <= 4.0 + 1e-6


def test_the_network_sees_normalized_images() -> None:
    seen: list[Tensor] = []

    class Spy(nn.Module):
        def forward(self, image: Tensor) -> Tensor:
            seen.append(image)
            return image[:, :1]

    image = picture(4, 5)
    DepthNet(Spy(), LinearHead())(image)
    DepthNet(Spy(), LinearHead(), mean=(0.5, 0.5, 0.5), std=(2.0, 2.0, 2.0))(image)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    torch.testing.assert_close(seen[0], (image - mean.view(1, 3, 1, 1)) / std.view(1, 3, 1, 1))
    torch.testing.assert_close(seen[1], (image - 0.5) / 2)


def test_a_half_precision_network_returns_float32_meters() -> None:
    model = small_net().bfloat16()
    with torch.inference_mode():
        assert model(picture(32, 32).bfloat16()).dtype == torch.float32


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (torch.rand(3, 32, 32), r"shape \(3, 32, 32\): give \(B, 3, H, W\)"),
        (torch.rand(1, 32, 32, 3), "give"),
        (torch.rand(1, 1, 32, 32), "give"),
        (torch.full((1, 3, 32, 32), 200.0), r"values up to 200: give floats in \[0, 1\]"),
        (torch.zeros(1, 3, 32, 32, dtype=torch.uint8), r"uint8: give floats in \[0, 1\]"),
    ],
)
def test_images_of_wrong_shape_or_type_are_refused(image: Tensor, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        small_net()(image)


def test_copies_and_pickles_equal_the_model() -> None:
    model = small_net(refine=JointBilateral())
    copied, pickled = copy.deepcopy(model), pickle.loads(pickle.dumps(model))
    assert same_model(model, copied)
    assert same_model(model, pickled)
    with torch.no_grad():
        next(copied.parameters()).add_(1)
    copied.config["network"]["backbone"]["scale"] = 9
    assert same_model(model, pickled)

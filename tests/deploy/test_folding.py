"""A folded network computes the same with less work."""

import numpy as np
import pytest
import torch
from support.rooms_network import ROUNDING, SIZE
from torch import nn

import eldenet
from eldenet.decoders.upconv import UpConv2d
from eldenet.deploy.fold import fold, merge_upconv
from eldenet.export import map_errors
from eldenet.heads import LinearHead
from eldenet.model import DepthNet


@pytest.mark.parametrize("fast", [True, False])
def test_a_merged_upconvolution_is_the_operator_itself(fast: bool) -> None:
    layer, x = UpConv2d(5, 3, fast=fast).double(), torch.randn(2, 5, 4, 7, dtype=torch.float64)
    bias = torch.randn(3, dtype=torch.float64)
    torch.testing.assert_close(
        merge_upconv(layer.weight, bias)(x), layer.unpooled(x) + bias[:, None, None], rtol=0, atol=1e-12
    )


def test_folding_changes_neither_depth_nor_model(trained_model, images: np.ndarray, reference) -> None:
    before = {name: value.clone() for name, value in trained_model.state_dict().items()}
    folded = fold(trained_model)
    assert not any(isinstance(part, nn.BatchNorm2d) for part in folded.modules())
    with torch.inference_mode():
        assert map_errors(folded(torch.from_numpy(images)).numpy(), reference)["max_relative"] < ROUNDING
    for name, value in trained_model.state_dict().items():
        assert torch.equal(value, before[name]), name


def test_resnet_blocks_are_folded() -> None:
    torch.manual_seed(0)
    model = eldenet.load("resnet18_upconv").eval()
    for part in model.modules():
        if isinstance(part, nn.BatchNorm2d):
            part.running_mean.uniform_(-0.2, 0.2)
            part.running_var.uniform_(0.5, 1.5)
    folded = fold(model)
    assert not any(isinstance(part, nn.BatchNorm2d) for part in folded.modules())
    image = torch.rand(1, 3, *SIZE)
    with torch.inference_mode():
        assert map_errors(folded(image).numpy(), model(image).numpy())["max_relative"] < ROUNDING


class ActiveNorm(nn.BatchNorm2d):
    """Normalization and activation in one, as timm's ``BatchNormAct2d``."""

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        return super().forward(input).relu()


class HalvedConv(nn.Conv2d):
    """Computes something else from the same weights, as weight standardization does."""

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        return super().forward(input) / 2


@pytest.mark.parametrize("parts", [(nn.Conv2d, ActiveNorm), (HalvedConv, nn.BatchNorm2d)])
def test_subclasses_that_do_more_are_not_folded(parts: tuple[type, type]) -> None:
    torch.manual_seed(0)
    conv, norm = parts
    network = nn.Sequential(conv(3, 4, 3, padding=1), norm(4), nn.Conv2d(4, 1, 1))
    network[1].running_mean.uniform_(-0.2, 0.2)
    network[1].running_var.uniform_(0.5, 1.5)
    model, image = DepthNet(network, LinearHead()).eval(), torch.rand(1, 3, *SIZE)
    with torch.inference_mode():
        assert map_errors(fold(model)(image).numpy(), model(image).numpy())["max_relative"] < ROUNDING


class NormFirst(nn.Sequential):
    """Calls its layers in another order, as blocks with pre-activation do."""

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        conv, norm = self
        return conv(norm(input))


def _relu_between_twice() -> nn.Module:
    relu = nn.ReLU()  # of both places: modules() shows it once
    parts = (nn.Conv2d(3, 4, 3), relu, nn.BatchNorm2d(4), nn.Conv2d(4, 4, 3), relu, nn.BatchNorm2d(4))
    return nn.Sequential(*parts, nn.Conv2d(4, 1, 1))


def _norm_first() -> nn.Module:
    block = NormFirst(nn.Conv2d(4, 4, 3), nn.BatchNorm2d(4))
    return nn.Sequential(nn.Conv2d(3, 4, 3), block, nn.Conv2d(4, 1, 1))


def _norm_of_the_picture() -> nn.Module:
    norm = nn.BatchNorm2d(4, track_running_stats=False)
    return nn.Sequential(nn.Conv2d(3, 4, 3), norm, nn.Conv2d(4, 1, 1))


@pytest.mark.parametrize("build", [_relu_between_twice, _norm_first, _norm_of_the_picture])
def test_other_networks_are_folded_only_where_a_normalization_follows_its_convolution(build) -> None:
    torch.manual_seed(0)
    model, image = DepthNet(build(), LinearHead()).eval(), torch.rand(1, 3, *SIZE)
    for part in model.modules():
        if isinstance(part, nn.BatchNorm2d) and part.running_mean is not None:
            part.running_mean.uniform_(-0.5, 0.5)
            part.running_var.uniform_(0.1, 0.5)
    with torch.inference_mode():
        assert map_errors(fold(model)(image).numpy(), model(image).numpy())["max_relative"] < ROUNDING

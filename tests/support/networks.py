"""Small networks that several tests build."""

from functools import partial
from typing import Any

import pytest
import torch
from torch import Tensor

from eldenet.backbones.efficientnet import EfficientNetLite
from eldenet.backbones.pplcnet import PPLCNet
from eldenet.backbones.timm import TimmBackbone
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.deploy.predictor import DepthPredictor
from eldenet.heads import LinearHead, LogHead, UncertainHead
from eldenet.model import DepthNet
from eldenet.ray_features import RayFeatures
from eldenet.weights import list_models

_LARGE = ("senet154_upconv", "resnet152_upconv", "vgg16_upconv", "seresnet50_upconv", "resnet50_upconv")
#: Names of all networks, as parameters of a test; the largest are slow.
MODELS = [pytest.param(name, marks=pytest.mark.slow if name in _LARGE else ()) for name in list_models()]


def small_net(seed: int = 0, **options: Any) -> DepthNet:
    torch.manual_seed(seed)
    options = {"backbone": PPLCNet(0.25), "decoder": FastUpConvDecoder, "head": LinearHead()} | options
    return DepthNet.from_parts(**options).eval()


def light_net(**options: Any) -> DepthNet:
    """A network of few operations: a file of any size is written in half of :func:`small_net`'s time."""
    backbone, decoder = EfficientNetLite(blocks=[1, 1]), partial(FastUpConvDecoder, modules=2)
    return small_net(**{"backbone": backbone, "decoder": decoder} | options)


def lens_net(height: int, width: int, rays: type[RayFeatures] | None = RayFeatures) -> DepthNet:
    """A network of few operations with sigma and a canonical camera; its weights for rays are random."""
    parts: dict[str, Any] = {"backbone": EfficientNetLite(blocks=[1] * 4), "head": UncertainHead(LogHead())}
    net = light_net(rays=rays, canonical_focal=0.8, canonical_width=width, **parts)
    net.info = {"input_size": [height, width]}
    generator = torch.Generator().manual_seed(0)
    for convs in net.network.rays.convs.values() if rays else ():
        torch.nn.init.normal_(convs[2].weight, std=0.3, generator=generator)
    return net


def rounding_down_net() -> DepthNet:
    """A ConvNeXt, whose features of odd sizes are rounded down; skips the test without timm."""
    pytest.importorskip("timm")
    parts = TimmBackbone("test_convnext2"), partial(FastUpConvDecoder, modules=2), LinearHead()
    return DepthNet.from_parts(*parts)


def canonical_net(height: int, width: int) -> DepthNet:
    """A small network with a canonical camera of 0.8 widths."""
    model = small_net(canonical_focal=0.8, canonical_width=width)
    model.info = {"input_size": [height, width]}
    return model


def canonical_predictor(height: int, width: int) -> DepthPredictor:
    """A predictor of single frames by :func:`canonical_net`."""
    return DepthPredictor(canonical_net(height, width), steady=False)


def picture(*size: int, seed: int = 0, batch: int = 1) -> Tensor:
    return torch.rand(batch, 3, *size, generator=torch.Generator().manual_seed(seed))


def same_model(a: DepthNet, b: DepthNet) -> bool:
    """Same config, same tensors and the same output, bit for bit."""
    image = picture(64, 96)
    with torch.inference_mode():
        same = torch.equal(a.eval()(image), b.eval()(image))
    ours, theirs = a.state_dict(), b.state_dict()
    same &= a.config == b.config and list(ours) == list(theirs)
    return same and all(torch.equal(ours[name], theirs[name]) for name in ours)

"""Models for ``torch.hub``: ``torch.hub.load(<this repository>, "eldenet")``.

Every function takes the options of :func:`eldenet.zoo.load`, such as
``overrides=["model.head.max_depth=80"]``, and returns a freshly initialised network in eval mode: image
``(B, 3, H, W)``, RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m].
"""

from typing import Any as _Any  # torch.hub lists every callable without an underscore

from eldenet.model import DepthNet as _DepthNet
from eldenet.zoo import load as _load

dependencies = ["hydra", "numpy", "omegaconf", "safetensors", "torch", "torchvision"]


def eldenet(**options: _Any) -> _DepthNet:
    """ELDE-Net: PP-LCNet x0.5 and four fast up-convolution modules."""
    return _load("eldenet", **options)


def eldenet_s(**options: _Any) -> _DepthNet:
    """The smallest ELDE-Net: PP-LCNet x0.25."""
    return _load("eldenet_s", **options)


def eldenet_l(**options: _Any) -> _DepthNet:
    """The largest ELDE-Net: PP-LCNet x1.0."""
    return _load("eldenet_l", **options)


def resnet18_upconv(**options: _Any) -> _DepthNet:
    """ResNet18 with sparse-to-dense's UpConv decoder, the paper's baseline."""
    return _load("resnet18_upconv", **options)


def resnet152_upconv(**options: _Any) -> _DepthNet:
    """ResNet152 with the UpConv decoder, the paper's teacher."""
    return _load("resnet152_upconv", **options)


def vgg16_upconv(**options: _Any) -> _DepthNet:
    """VGG16 with the UpConv decoder."""
    return _load("vgg16_upconv", **options)


def mobilenet_v2_upconv(**options: _Any) -> _DepthNet:
    """MobileNetV2 with the UpConv decoder."""
    return _load("mobilenet_v2_upconv", **options)


def mobilenet_v3_upconv(**options: _Any) -> _DepthNet:
    """MobileNetV3 large with the UpConv decoder."""
    return _load("mobilenet_v3_upconv", **options)

"""Models for ``torch.hub``: ``torch.hub.load(<this repository>, "eldenet")``.

Every function takes the options of :func:`eldenet.zoo.load`, such as
``overrides=["model.head.max_depth=80"]``, and returns a network in eval mode: image ``(B, 3, H, W)``, RGB in
[0, 1] -> depth ``(B, 1, H, W)`` [m]. It is freshly initialized but for ``eldenet(weights="rooms")``.
"""

from typing import Any as _Any  # torch.hub lists every callable without an underscore

from eldenet.model import DepthNet as _DepthNet
from eldenet.zoo import load as _load

dependencies = ["hydra", "numpy", "omegaconf", "safetensors", "torch", "torchvision"]


def eldenet(**options: _Any) -> _DepthNet:
    """ELDE-Net: PP-LCNet x0.5 and four fast up-convolution modules."""
    return _load("eldenet", **options)


def eldenet_fast(**options: _Any) -> _DepthNet:
    """ELDE-Net that stops at a quarter of the image: three modules of half the width."""
    return _load("eldenet_fast", **options)


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


def resnet50_upconv(**options: _Any) -> _DepthNet:
    """ResNet50 with the UpConv decoder."""
    return _load("resnet50_upconv", **options)


def mobilenet_v1_upconv(**options: _Any) -> _DepthNet:
    """MobileNetV1 with the UpConv decoder."""
    return _load("mobilenet_v1_upconv", **options)


def mobilenet_v3_small_upconv(**options: _Any) -> _DepthNet:
    """MobileNetV3 small with the UpConv decoder."""
    return _load("mobilenet_v3_small_upconv", **options)


def seresnet18_upconv(**options: _Any) -> _DepthNet:
    """SE-ResNet18 of timm with the UpConv decoder."""
    return _load("seresnet18_upconv", **options)


def seresnet50_upconv(**options: _Any) -> _DepthNet:
    """SE-ResNet50 of timm with the UpConv decoder."""
    return _load("seresnet50_upconv", **options)


def senet154_upconv(**options: _Any) -> _DepthNet:
    """SENet-154 of timm with the UpConv decoder."""
    return _load("senet154_upconv", **options)


def fastdepth(**options: _Any) -> _DepthNet:
    """FastDepth, unpruned: MobileNetV1, depthwise NNConv5 decoder, additive skips."""
    return _load("fastdepth", **options)


def guidedepth(**options: _Any) -> _DepthNet:
    """GuideDepth: DDRNet-23-slim and three guided upsampling blocks."""
    return _load("guidedepth", **options)


def guidedepth_s(**options: _Any) -> _DepthNet:
    """GuideDepth-S."""
    return _load("guidedepth_s", **options)


def lite_mono(**options: _Any) -> _DepthNet:
    """Lite-Mono."""
    return _load("lite_mono", **options)


def lite_mono_tiny(**options: _Any) -> _DepthNet:
    """Lite-Mono-tiny."""
    return _load("lite_mono_tiny", **options)


def lite_mono_small(**options: _Any) -> _DepthNet:
    """Lite-Mono-small."""
    return _load("lite_mono_small", **options)


def lite_mono_8m(**options: _Any) -> _DepthNet:
    """Lite-Mono-8M."""
    return _load("lite_mono_8m", **options)


def meter_xxs(**options: _Any) -> _DepthNet:
    """METER-XXS."""
    return _load("meter_xxs", **options)


def meter_xs(**options: _Any) -> _DepthNet:
    """METER-XS."""
    return _load("meter_xs", **options)


def meter_s(**options: _Any) -> _DepthNet:
    """METER-S."""
    return _load("meter_s", **options)

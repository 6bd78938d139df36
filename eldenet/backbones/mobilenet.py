"""MobileNetV1, V2 and V3, the mobile baselines."""

import re
from pathlib import Path

import torchvision.models as zoo
from torch import Tensor, nn

from eldenet.backbones.base import Backbone
from eldenet.backbones.weights import (
    Weights,
    download_from_hub,
    load_torchvision_weights,
    load_weights,
    read_weights,
)
from eldenet.layers import ConvNormAct, DepthwiseSeparable, init_kaiming
from eldenet.types import FeatureInfo

# For each network the last of torchvision's ``features`` at strides 2, 4, 8, 16, 32, and its channels.
_STAGES = {
    "mobilenet_v2": ((1, 16), (3, 24), (6, 32), (13, 96), (18, 1280)),
    "mobilenet_v3_small": ((0, 16), (1, 16), (3, 24), (8, 48), (12, 576)),
    "mobilenet_v3_large": ((1, 16), (3, 24), (6, 40), (12, 112), (16, 960)),
}

# MobileNetV1's table (the paper's table 1): output channels of the separable convolutions at strides 2, 4, 8,
# 16, 32. The first of each row but the first halves the map.
_V1_STAGES = ((64,), (128, 128), (256, 256), (512,) * 6, (1024, 1024))
_TIMM_V1 = "timm/mobilenetv1_100.ra4_e3600_r224_in1k"
_TIMM_LAYERS = {
    "conv_dw": "depthwise.conv",
    "bn1": "depthwise.norm",
    "conv_pw": "pointwise.conv",
    "bn2": "pointwise.norm",
}


class MobileNetV1(Backbone):
    """MobileNetV1 without its classifier: 3,206,976 parameters.

    Howard et al., "MobileNets: Efficient Convolutional Neural Networks for Mobile Vision Applications" (arXiv
    1704.04861), with ReLU6, as FastDepth and timm have it.

    Features: strides 2, 4, 8, 16, 32 with 64, 128, 256, 512, 1024 channels.

    Args:
        pretrained: ``True`` for timm's ImageNet weights, or a local file with this class's names or those of
            timm's ``mobilenetv1_100``.

    Raises:
        ValueError: for weights that do not exist or do not fit.
        RuntimeError: where weights cannot be downloaded.
    """

    def __init__(self, *, pretrained: bool | str = False) -> None:
        super().__init__()
        self.stem = ConvNormAct(3, 32, 3, stride=2, activation=nn.ReLU6)
        self.stages = nn.ModuleList()
        channels = 32
        for number, widths in enumerate(_V1_STAGES):
            stage = nn.Sequential()
            for place, width in enumerate(widths):
                stride = 2 if number > 0 and place == 0 else 1
                stage.append(DepthwiseSeparable(channels, width, 3, stride=stride, activation=nn.ReLU6))
                channels = width
            self.stages.append(stage)
        self.feature_info = tuple(
            FeatureInfo(widths[-1], stride)
            for widths, stride in zip(_V1_STAGES, (2, 4, 8, 16, 32), strict=True)
        )
        init_kaiming(self)
        if pretrained:
            path = download_from_hub(_TIMM_V1) if pretrained is True else Path(pretrained)
            load_weights(self, _from_timm(read_weights(path)), path)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Encode ``(B, 3, H, W)``; the maps are described in the base class."""
        features = []
        x = self.stem(image)
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        return tuple(features)


def _from_timm(weights: Weights) -> Weights:
    """Names of timm -> this class's; a file that has this class's names already stays as it is."""
    if "conv_stem.weight" not in weights:
        return weights
    renamed = {}
    for name, tensor in weights.items():
        block = re.fullmatch(r"blocks\.(\d+)\.(\d+)\.(\w+)\.(\w+)", name)
        if block and block[3] in _TIMM_LAYERS:
            renamed[f"stages.{block[1]}.{block[2]}.{_TIMM_LAYERS[block[3]]}.{block[4]}"] = tensor
        elif not name.startswith(("classifier.", "conv_head.")):
            renamed[name.replace("conv_stem.", "stem.conv.").replace("bn1.", "stem.norm.")] = tensor
    return renamed


class _TorchvisionMobileNet(Backbone):
    """The ``features`` of one of torchvision's MobileNets, under torchvision's names."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.features: nn.Sequential = zoo.get_model(name, weights=None).features
        self.feature_info = tuple(
            FeatureInfo(channels, stride)
            for (_, channels), stride in zip(_STAGES[name], (2, 4, 8, 16, 32), strict=True)
        )
        self._stage_ends = frozenset(index for index, _ in _STAGES[name])

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Encode ``(B, 3, H, W)``; the maps are described in the base class."""
        features = []
        x = image
        for index, layer in enumerate(self.features):
            x = layer(x)
            if index in self._stage_ends:
                features.append(x)
        return tuple(features)


class MobileNetV2(_TorchvisionMobileNet):
    """torchvision's MobileNetV2 without its classifier.

    Sandler et al., "MobileNetV2: Inverted Residuals and Linear Bottlenecks" (CVPR 2018).

    Features: the last map at strides 2, 4, 8, 16, 32; the coarsest is that of the 1 x 1 convolution to 1280
    channels, which dense-prediction baselines keep.

    Args:
        pretrained: ``True`` for torchvision's first ImageNet weights, the name of others
            (``"IMAGENET1K_V2"``), or a local file. The widespread ImageNet weights of this network in other
            code bases hold the same tensors in the same order under other names; a file whose names differ
            is therefore read by order, and refused unless number and shapes agree, one by one.

    Raises:
        ValueError: for weights that do not exist or do not fit.
        RuntimeError: where weights cannot be downloaded.
    """

    def __init__(self, *, pretrained: bool | str = False) -> None:
        super().__init__("mobilenet_v2")
        if pretrained:
            load_torchvision_weights(self, "mobilenet_v2", pretrained, by_order=True)


class MobileNetV3(_TorchvisionMobileNet):
    """torchvision's MobileNetV3 without its classifier.

    Howard et al., "Searching for MobileNetV3" (ICCV 2019).

    Features: the last map at strides 2, 4, 8, 16, 32; the coarsest is that of the last 1 x 1 convolution (576
    channels in the small network, 960 in the large one).

    Args:
        size: ``"small"`` or ``"large"``.
        pretrained: ``True`` for torchvision's first ImageNet weights, the name of others
            (``"IMAGENET1K_V2"``, large only), or a local file.

    Raises:
        ValueError: for a size or weights that do not exist, or weights that do not fit.
        RuntimeError: where weights cannot be downloaded.
    """

    def __init__(self, size: str = "large", *, pretrained: bool | str = False) -> None:
        if size not in ("small", "large"):
            raise ValueError(f"MobileNetV3 has no size {size!r}; choose small or large")
        super().__init__(f"mobilenet_v3_{size}")
        if pretrained:
            load_torchvision_weights(self, f"mobilenet_v3_{size}", pretrained)

"""MobileNetV2 and MobileNetV3, the mobile baselines."""

import torchvision.models as zoo
from torch import Tensor, nn

from eldenet.backbones.base import Backbone
from eldenet.backbones.weights import load_torchvision_weights
from eldenet.types import FeatureInfo

# For each network the last of torchvision's ``features`` at strides 2, 4, 8, 16, 32, and its channels.
_STAGES = {
    "mobilenet_v2": ((1, 16), (3, 24), (6, 32), (13, 96), (18, 1280)),
    "mobilenet_v3_small": ((0, 16), (1, 16), (3, 24), (8, 48), (12, 576)),
    "mobilenet_v3_large": ((1, 16), (3, 24), (6, 40), (12, 112), (16, 960)),
}


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

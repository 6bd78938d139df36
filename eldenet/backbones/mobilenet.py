"""MobileNetV1, V2 and V3, the baseline encoders for mobile devices."""

from pathlib import Path

import torchvision.models as zoo
from torch import Tensor, nn

from eldenet.backbones.base import Backbone, five_stages, outputs_of
from eldenet.backbones.weights import (
    download_from_hub,
    load_torchvision_weights,
    load_weights,
    read_weights,
    rename_timm,
)
from eldenet.layers import ConvNormAct, DepthwiseSeparable, init_kaiming
from eldenet.system.checks import one_of

# Per network: the last layer in torchvision's ``features`` at strides 2, 4, 8, 16, 32, and its channels.
_STAGES = {
    "mobilenet_v2": ((1, 16), (3, 24), (6, 32), (13, 96), (18, 1280)),
    "mobilenet_v3_small": ((0, 16), (1, 16), (3, 24), (8, 48), (12, 576)),
    "mobilenet_v3_large": ((1, 16), (3, 24), (6, 40), (12, 112), (16, 960)),
}

# Output channels of MobileNetV1's separable convolutions at strides 2, 4, 8, 16, 32 (the paper's table 1).
# From the second stage on, the first convolution of each stage has stride 2.
_V1_STAGES = ((64,), (128, 128), (256, 256), (512,) * 6, (1024, 1024))
_TIMM_V1 = "timm/mobilenetv1_100.ra4_e3600_r224_in1k"


class MobileNetV1(Backbone):
    """MobileNetV1 without its classifier: 3,206,976 parameters.

    Howard et al., "MobileNets: Efficient Convolutional Neural Networks for Mobile Vision Applications" (arXiv
    1704.04861), with ReLU6, as in FastDepth and timm.

    Features: strides 2, 4, 8, 16, 32 with 64, 128, 256, 512, 1024 channels.

    Args:
        pretrained: ``True`` for timm's ImageNet weights, or a local file with the names of this class or of
            timm's ``mobilenetv1_100``.

    Raises:
        ValueError: weights that do not exist or do not fit.
        ConnectionError: the weights cannot be downloaded.
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
        self.feature_info = five_stages(*(widths[-1] for widths in _V1_STAGES))
        init_kaiming(self)
        if pretrained:
            path = download_from_hub(_TIMM_V1) if pretrained is True else Path(pretrained)
            stages = {number: (f"stages.{number}", 0) for number in range(len(_V1_STAGES))}
            load_weights(self, rename_timm(read_weights(path), stages), path)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Return the features of ``(B, 3, H, W)``, finest first."""
        return outputs_of(self.stages, self.stem(image), range(len(self.stages)))


class _TorchvisionMobileNet(Backbone):
    """The ``features`` of a torchvision MobileNet, with torchvision's names."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.features: nn.Sequential = zoo.get_model(name, weights=None).features
        self.feature_info = five_stages(*(channels for _, channels in _STAGES[name]))
        self._stage_ends = frozenset(index for index, _ in _STAGES[name])

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Return the features of ``(B, 3, H, W)``, finest first."""
        return outputs_of(self.features, image, self._stage_ends)


class MobileNetV2(_TorchvisionMobileNet):
    """torchvision's MobileNetV2 without its classifier.

    Sandler et al., "MobileNetV2: Inverted Residuals and Linear Bottlenecks" (CVPR 2018).

    Features: the last map at strides 2, 4, 8, 16, 32; the coarsest is the output of the 1 x 1 convolution to
    1280 channels, which dense-prediction baselines keep.

    Args:
        pretrained: ``True`` for torchvision's ``IMAGENET1K_V1`` weights, the name of others
            (``"IMAGENET1K_V2"``), or a local file. Widely used weights of this network hold the same tensors
            in the same order under other names, so a file with other names is read by order if the number
            of tensors and every shape agree.

    Raises:
        ValueError: weights that do not exist or do not fit.
        ConnectionError: the weights cannot be downloaded.
    """

    def __init__(self, *, pretrained: bool | str = False) -> None:
        super().__init__("mobilenet_v2")
        if pretrained:
            load_torchvision_weights(self, "mobilenet_v2", pretrained, by_order=True)


class MobileNetV3(_TorchvisionMobileNet):
    """torchvision's MobileNetV3 without its classifier.

    Howard et al., "Searching for MobileNetV3" (ICCV 2019).

    Features: the last map at strides 2, 4, 8, 16, 32; the coarsest is the output of the last 1 x 1
    convolution (576 channels in the small network, 960 in the large one).

    Args:
        size: ``"small"`` or ``"large"``.
        pretrained: ``True`` for torchvision's ``IMAGENET1K_V1`` weights, the name of others
            (``"IMAGENET1K_V2"``, large only), or a local file.

    Raises:
        ValueError: a size or weights that do not exist, or weights that do not fit.
        ConnectionError: the weights cannot be downloaded.
    """

    def __init__(self, size: str = "large", *, pretrained: bool | str = False) -> None:
        one_of("size", size, ("small", "large"))
        super().__init__(f"mobilenet_v3_{size}")
        if pretrained:
            load_torchvision_weights(self, f"mobilenet_v3_{size}", pretrained)

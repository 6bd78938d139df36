"""FastDepth's decoder, in the three forms that its paper compares."""

from collections.abc import Sequence
from itertools import pairwise

import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.decoders.base import Decoder, crop_or_pad
from eldenet.decoders.upconv import UpConvBlock
from eldenet.layers import ConvNormAct, DepthwiseSeparable
from eldenet.types import FeatureInfo

CHANNELS = (1024, 512, 256, 128, 64, 32)
OPERATORS = ("nnconv5_dw", "nnconv5", "upconv")
SKIP_STRIDES = (8, 4, 2)


class FastDepthDecoder(Decoder):
    """Five modules that halve the channels and double the map, 1024 to 32, and a 1x1 convolution.

    Wofk et al., "FastDepth: Fast Monocular Depth Estimation on Embedded Systems" (ICRA 2019). "NNConv5" is a
    5x5 convolution followed by nearest-neighbor interpolation; depthwise separable in the network that is
    called FastDepth, which adds the encoder's features of strides 8, 4 and 2. Unpruned; with MobileNetV1:
    3,960,930 parameters (the published code).

    Convention: the published network ends in batch normalization and ReLU; the ReLU is left out here, as the
    head needs both signs. Rows and columns beyond the image are dropped after every doubling.

    Args:
        feature_info: of the backbone; a deepest feature that has not 1024 channels first goes through a 1x1
            convolution, as the published ResNets do.
        operator: ``"nnconv5_dw"``, ``"nnconv5"`` or ``"upconv"`` (unpool, then a 5x5 convolution).
        skips: add the features of strides 8, 4 and 2, where the backbone has them; MobileNetV1's as they are,
            others through a 1x1 convolution to 256, 128 and 64 channels.
        fast: compute ``"upconv"`` in its fast form (same weights, same output).

    Raises:
        ValueError: an unknown operator, or features that do not fit.
    """

    def __init__(
        self,
        feature_info: Sequence[FeatureInfo],
        *,
        operator: str = "nnconv5_dw",
        skips: bool = True,
        fast: bool = False,
    ) -> None:
        super().__init__(feature_info)
        if operator not in OPERATORS:
            raise ValueError(f"operator={operator!r}: choose one of {', '.join(OPERATORS)}")
        self.deepest_stride = max(self.index_of)
        if self.deepest_stride < 32:
            raise ValueError(
                f"five doublings need a feature of stride 32 or more, the deepest has {self.deepest_stride}"
            )
        self.stride = self.deepest_stride // 32
        self.interpolate = operator != "upconv"
        widths = {self.deepest_stride // 2**step: width for step, width in enumerate(CHANNELS)}
        self.lateral = nn.ModuleDict()  # by stride
        for stride in SKIP_STRIDES:
            if skips and stride in self.channels_at and stride in widths:
                own, width = self.channels_at[stride], widths[stride]
                self.lateral[str(stride)] = nn.Identity() if own == width else nn.Conv2d(own, width, 1)
        width = self.channels_at[self.deepest_stride]
        self.widen = nn.Identity() if width == CHANNELS[0] else nn.Conv2d(width, CHANNELS[0], 1)
        self.steps = nn.ModuleList()
        for wide, narrow in pairwise(CHANNELS):
            if operator == "upconv":
                self.steps.append(UpConvBlock(wide, narrow, fast=fast))
            elif operator == "nnconv5":
                self.steps.append(ConvNormAct(wide, narrow, 5))
            else:
                self.steps.append(DepthwiseSeparable(wide, narrow, 5))
        self.predict = ConvNormAct(CHANNELS[-1], 1, 1, activation=nn.Identity)

    def forward(self, features: Sequence[Tensor]) -> Tensor:
        """Features, finest first -> raw map ``(B, 1, h, w)``."""
        stride = self.deepest_stride
        x = self.widen(features[self.index_of[stride]])
        for step in self.steps:
            x = step(x)
            if self.interpolate:
                x = F.interpolate(x, scale_factor=2, mode="nearest")
            stride //= 2
            if stride in self.index_of:
                feature = features[self.index_of[stride]]
                x = crop_or_pad(x, feature)
                if str(stride) in self.lateral:
                    x = x + self.lateral[str(stride)](feature)
        return self.within_image(self.predict(x), features)

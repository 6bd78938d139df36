"""FastDepth's decoder, with the three operators that its paper compares."""

from collections.abc import Sequence
from itertools import pairwise

import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.decoders.base import Decoder, crop_or_pad
from eldenet.decoders.upconv import UpConvBlock
from eldenet.layers import ConvNormAct, DepthwiseSeparable
from eldenet.system.checks import one_of
from eldenet.types import FeatureInfo

CHANNELS = (1024, 512, 256, 128, 64, 32)
OPERATORS = ("nnconv5_dw", "nnconv5", "upconv")
SKIP_STRIDES = (8, 4, 2)


class FastDepthDecoder(Decoder):
    """Five modules that halve the channels and double the map, 1024 to 32, and a 1x1 convolution.

    Wofk et al., "FastDepth: Fast Monocular Depth Estimation on Embedded Systems" (ICRA 2019). "NNConv5" is a
    5x5 convolution followed by nearest-neighbor interpolation. The network called FastDepth has it depthwise
    separable and adds the encoder's features of strides 8, 4 and 2. Not pruned; with MobileNetV1 3,960,930
    parameters, as in the published code.

    Convention: the published network ends in batch normalization and ReLU; there is no ReLU here, because the
    head needs both signs. Rows and columns beyond the image are cropped after every doubling.

    Args:
        feature_info: of the backbone; a 1x1 convolution brings the deepest feature to 1024 channels if it has
            another number, as in the published ResNets.
        operator: ``"nnconv5_dw"``, ``"nnconv5"`` or ``"upconv"`` (unpool, then a 5x5 convolution).
        skips: add the backbone's features of strides 8, 4 and 2; a 1x1 convolution brings them to 256, 128
            and 64 channels if they have other numbers (MobileNetV1's do not need it).
        fast: compute ``"upconv"`` in its fast form (same weights, same output).

    Raises:
        ValueError: an unknown operator, or a deepest stride below 32.
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
        one_of("operator", operator, OPERATORS)
        self.deepest_stride = max(self.index_of)
        if self.deepest_stride < 32:
            raise ValueError(
                f"the deepest feature has stride {self.deepest_stride}: five doublings need 32 or more"
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

"""GuideDepth: three steps double the depth features in size, each guided by the image."""

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.baselines.ddrnet import DDRNet
from eldenet.configurable import Configurable
from eldenet.decoders.base import crop_or_pad
from eldenet.layers import ConvNormAct
from eldenet.system.checks import one_of

# Channels of the depth features at strides 8, 4, 2 (``up_features`` in the published code).
SIZES = {"full": (64, 32, 16), "small": (32, 8, 4)}


class GuidedUpsampling(nn.Module):
    """The guided upsampling block: weighted features of depth and image are added to the depth features."""

    def __init__(self, channels: int, out_channels: int) -> None:
        super().__init__()
        self.depth_features = nn.Sequential(
            ConvNormAct(channels, channels, 3), ConvNormAct(channels, channels // 2, 1)
        )
        self.guide_features = nn.Sequential(
            ConvNormAct(3, channels, 3), ConvNormAct(channels, channels // 2, 1)
        )
        self.attention = nn.Sequential(
            nn.AdaptiveAvgPool2d(1),
            nn.Conv2d(channels, channels, 1, bias=False),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 1, bias=False),
            nn.Sigmoid(),
        )
        self.combine = nn.Sequential(ConvNormAct(channels, channels, 3), ConvNormAct(channels, channels, 1))
        self.reduce = nn.Conv2d(channels, out_channels, 1)

    def forward(self, guide: Tensor, depth: Tensor) -> Tensor:
        """Image ``(B, 3, H, W)`` and features ``(B, channels, H, W)`` -> ``(B, out_channels, H, W)``."""
        both = torch.cat([self.depth_features(depth), self.guide_features(guide)], dim=1)
        return self.reduce(self.combine(both * self.attention(both)) + depth)


class GuideDepth(Configurable, nn.Module):
    """GuideDepth: 5.82 M parameters, GuideDepth-S: 5.72 M.

    Rudolph et al., "Lightweight Monocular Depth Estimation through Guided Decoding" (ICRA 2022, arXiv
    2203.04206). The raw map has the image's size.

    Convention: convolutions before a normalization have no bias (the published ones have: 624 of 5.8 million
    parameters, which the normalization cancels). Training needs batches of two images or more.

    Args:
        size: ``"full"``, or ``"small"`` for GuideDepth-S, whose decoder is narrower.

    Raises:
        ValueError: an unknown size.
    """

    def __init__(self, size: str = "full") -> None:
        super().__init__()
        one_of("size", size, SIZES)
        channels = (*SIZES[size], 1)
        self.features = DDRNet(channels[0])
        self.up = nn.ModuleList(GuidedUpsampling(wide, narrow) for wide, narrow in pairwise(channels))

    def forward(self, image: Tensor) -> Tensor:
        """Normalized image ``(B, 3, H, W)`` -> raw map ``(B, 1, H, W)``."""
        x = self.features(image)
        for step, stride in zip(self.up, (4, 2, 1), strict=True):
            guide = image[..., ::stride, ::stride]  # nearest-neighbor interpolation
            x = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
            x = step(guide, crop_or_pad(x, guide))
        return x

"""A reading of the paper's decoder: one kernel shape per encoder stage, concatenated at one size."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from eldenet.decoders.base import Decoder, crop_or_pad, kernel_conv
from eldenet.types import FeatureInfo

# For strides 2, 4, 8 and 32: with a 224 x 224 input, maps of 112, 56, 28 and 7 (the paper, section 3.2).
KERNELS = ((3, 3), (3, 2), (2, 3), (2, 2))


class MultiKernelDecoder(Decoder):
    """One convolution per encoder stage, pixel shuffle to the finest stage's size, concatenation, fusion.

    3x3 on the finest stage, 3x2 and 2x3 on the middle ones, 2x2 on the last (ELDE-Net, section 3.4). A pixel
    shuffle enlarges each branch, so nearly all convolutions run on the small maps.

    Args:
        feature_info: of the backbone, finest first.
        branch_channels: channels of each branch after its shuffle.
        fuse_channels: channels of the 3x3 convolution after the concatenation.
        kernels: ``(height, width)``, finest first: the last is the deepest feature's, the others are those
            of the finest features.
        max_shuffle: largest factor of a shuffle; bilinear up-sampling does the rest. A single shuffle by 16
            for the deepest stage would double the network's parameters.

    Raises:
        ValueError: fewer features than kernels.
    """

    def __init__(
        self,
        feature_info: Sequence[FeatureInfo],
        *,
        branch_channels: int = 4,
        fuse_channels: int = 16,
        kernels: Sequence[Sequence[int]] = KERNELS,
        max_shuffle: int = 4,
    ) -> None:
        super().__init__(feature_info)
        strides = sorted(self.index_of)
        if len(strides) < len(kernels):
            raise ValueError(
                f"kernels={kernels}: one feature per kernel is needed, the backbone has {len(strides)}"
            )
        # the finest features and the deepest, as in the paper, which skips the one between (14 x 14)
        self.strides = [*strides[: len(kernels) - 1], strides[-1]]
        self.stride = strides[0]
        self.branches = nn.ModuleList()
        for stride, kernel in zip(self.strides, kernels, strict=True):
            enlarge = stride // self.stride
            scale = min(enlarge, max_shuffle)
            self.branches.append(
                nn.Sequential(
                    *kernel_conv(self.channels_at[stride], branch_channels * scale**2, kernel),
                    nn.ReLU(inplace=True),
                    nn.PixelShuffle(scale),
                    nn.Upsample(scale_factor=enlarge // scale, mode="bilinear")
                    if enlarge > scale
                    else nn.Identity(),
                )
            )
        self.fuse = nn.Sequential(
            nn.Conv2d(branch_channels * len(kernels), fuse_channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(fuse_channels),
            nn.ReLU(inplace=True),
        )
        self.predict = nn.Conv2d(fuse_channels, 1, 3, padding=1)

    def forward(self, features: Sequence[Tensor]) -> Tensor:
        """Features, finest first -> raw map ``(B, 1, h, w)``."""
        finest = features[self.index_of[self.stride]]
        maps = [
            crop_or_pad(branch(features[self.index_of[stride]]), finest)
            for stride, branch in zip(self.strides, self.branches, strict=True)
        ]
        return self.predict(self.fuse(torch.cat(maps, dim=1)))

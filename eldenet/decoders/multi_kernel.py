"""The paper's decoder read literally: one kernel shape per encoder stage, all concatenated at one size."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from eldenet.decoders.base import Decoder, crop_or_pad
from eldenet.types import FeatureInfo

# A 224 x 224 input gives 112, 56, 28 and 7: the strides 2, 4, 8 and 32 (the paper, section 3.2).
KERNELS = ((3, 3), (3, 2), (2, 3), (2, 2))


class MultiKernelDecoder(Decoder):
    """One convolution per encoder stage, then sub-pixel shuffle to the finest stage's size, concat, fuse.

    3x3 on the finest stage, 3x2 and 2x3 on the middle ones, 2x2 on the last (ELDE-Net, section 3.4). Each
    branch is enlarged by a pixel shuffle, so that almost all of its work is done on the small maps.

    Args:
        feature_info: of the backbone, finest first.
        branch_channels: of each branch after its shuffle.
        fuse_channels: of the 3x3 convolution after the concatenation.
        kernels: ``(height, width)`` per stage, finest first.
        max_shuffle: a branch is enlarged at most this much by its shuffle and bilinearly from there on: one
            shuffle over the deepest stage's factor of 16 alone would double the network's parameters.
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
            raise ValueError(f"{len(kernels)} kernels need as many features, the backbone has {len(strides)}")
        # as in the paper: the finest ones and the deepest; the one before the deepest (14 x 14) is skipped
        self.strides = [*strides[: len(kernels) - 1], strides[-1]]
        self.stride = strides[0]
        self.branches = nn.ModuleList()
        for stride, (height, width) in zip(self.strides, kernels, strict=True):
            enlarge = stride // self.stride
            scale = min(enlarge, max_shuffle)
            # the odd row or column of an even kernel is padded at the far side
            padding = ((width - 1) // 2, width // 2, (height - 1) // 2, height // 2)
            self.branches.append(
                nn.Sequential(
                    nn.ZeroPad2d(padding),
                    nn.Conv2d(
                        self.channels_at[stride], branch_channels * scale**2, (height, width), bias=False
                    ),
                    nn.BatchNorm2d(branch_channels * scale**2),
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

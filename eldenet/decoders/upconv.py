"""The UpConv decoder: unpooling + 5x5 convolution, also as the same operator at a quarter of the cost."""

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.decoders.base import Decoder
from eldenet.types import FeatureInfo

# Per parity of the output row and column: the taps of the 5x5 kernel that meet a nonzero pixel, and the
# padding (left, right, top, bottom) that aligns them. They make kernels of 3x3, 3x2, 2x3 and 2x2.
PARITIES = (
    (slice(0, None, 2), slice(0, None, 2), (1, 1, 1, 1)),
    (slice(0, None, 2), slice(1, None, 2), (0, 1, 1, 1)),
    (slice(1, None, 2), slice(0, None, 2), (1, 1, 0, 1)),
    (slice(1, None, 2), slice(1, None, 2), (0, 1, 0, 1)),
)


class UpConv2d(nn.Module):
    """Doubles height and width: unpooling that inserts zeros, then a 5x5 convolution without bias.

    With ``fast=True`` four kernels of 3x3, 3x2, 2x3 and 2x2 run on the map *before* unpooling, and a pixel
    shuffle interleaves their outputs (fast up-convolution, Laina et al. 2016). Both forms are the same
    operator with the same weight; the fast one needs a quarter of the multiply-adds.

    Convention: unpooling puts a value at the top left of its 2x2 cell, as Ma & Karaman's ``Unpool`` does
    (Laina's TensorFlow code pads on the other side: the same operator, shifted by one pixel).
    """

    def __init__(self, in_channels: int, out_channels: int, *, fast: bool = True) -> None:
        super().__init__()
        self.fast = fast
        self.weight = nn.Parameter(torch.empty(out_channels, in_channels, 5, 5))
        # of the 25 taps, an output pixel meets 25 / 4 nonzero inputs on average: the effective fan in
        nn.init.normal_(self.weight, std=(2 / (in_channels * 25 / 4)) ** 0.5)

    def forward(self, x: Tensor) -> Tensor:
        """``(B, in, H, W)`` -> ``(B, out, 2H, 2W)``."""
        return self.interleaved(x) if self.fast else self.unpooled(x)

    def unpooled(self, x: Tensor) -> Tensor:
        """Compute the operator by its definition: ``(B, out, 2H, 2W)``."""
        batch, channels, height, width = x.shape
        sparse = x.new_zeros(batch, channels, 2 * height, 2 * width)
        sparse[..., ::2, ::2] = x
        return F.conv2d(sparse, self.weight, padding=2)

    def interleaved(self, x: Tensor) -> Tensor:
        """Compute the operator without the multiplications by zero: ``(B, out, 2H, 2W)``."""
        phases = [
            F.conv2d(F.pad(x, padding), self.weight[:, :, rows, cols]) for rows, cols, padding in PARITIES
        ]
        return F.pixel_shuffle(torch.stack(phases, dim=2).flatten(1, 2), 2)


class UpConvBlock(nn.Sequential):
    """An up-convolution, batch normalization and ReLU: doubles height and width."""

    def __init__(self, in_channels: int, out_channels: int, *, fast: bool = True) -> None:
        super().__init__(
            UpConv2d(in_channels, out_channels, fast=fast),
            nn.BatchNorm2d(out_channels),
            nn.ReLU(inplace=True),
        )


class UpConvDecoder(Decoder):
    """The UpConv decoder of sparse-to-dense (Ma & Karaman 2018): our reading of the paper's "Upconv".

    The deepest feature -> 1x1 convolution to half the channels and batch normalization -> four up-convolution
    modules, each halving the channels -> 3x3 convolution to one channel. There are no skips. With ResNet18:
    12,396,720 parameters.

    Convention: where the image is not a multiple of the deepest stride, rows and columns beyond the image are
    cropped; sparse-to-dense keeps them and squeezes the whole map to the image (256 rows to 228). It also
    aligns the corners in that resize, and starts from a variance of 2 / (25 x output channels).

    Args:
        feature_info: of the backbone; only the deepest feature is used.
        fast: compute each module in its fast form (same weights, same output).

    Raises:
        ValueError: a deepest stride below 16.
    """

    def __init__(self, feature_info: Sequence[FeatureInfo], *, fast: bool = False) -> None:
        super().__init__(feature_info)
        deepest = max(self.index_of)
        if deepest < 16:
            raise ValueError(f"the deepest feature has stride {deepest}: four doublings need 16 or more")
        self.deepest, self.stride = self.index_of[deepest], deepest // 16
        channels = [self.channels_at[deepest] // 2**step for step in range(1, 6)]
        self.reduce = nn.Sequential(
            nn.Conv2d(self.channels_at[deepest], channels[0], 1, bias=False), nn.BatchNorm2d(channels[0])
        )
        self.modules_up = nn.Sequential(
            *(UpConvBlock(wide, narrow, fast=fast) for wide, narrow in pairwise(channels))
        )
        self.predict = nn.Conv2d(channels[-1], 1, 3, padding=1, bias=False)

    def forward(self, features: Sequence[Tensor]) -> Tensor:
        """Features, finest first -> raw map ``(B, 1, h, w)``."""
        raw = self.predict(self.modules_up(self.reduce(features[self.deepest])))
        return self.within_image(raw, features)

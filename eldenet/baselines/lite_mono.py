"""Lite-Mono: dilated depthwise convolutions for local context, attention over channels for global context."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision.ops import StochasticDepth

from eldenet.configurable import Configurable
from eldenet.decoders.base import crop_or_pad
from eldenet.layers import DepthwiseConv2d, init_kaiming
from eldenet.system.checks import one_of


class Size(NamedTuple):
    """Channels of a network at strides 4, 8, 16, and rounds of three dilations in its third stage."""

    widths: tuple[int, int, int]
    rounds: int


SIZES = {
    "tiny": Size((32, 64, 128), 1),
    "small": Size((48, 80, 128), 1),
    "base": Size((48, 80, 128), 2),
    "8m": Size((64, 128, 224), 2),
}
# Dilations of a round, and of the last round of stage three (table 2 of the paper and the published code).
DILATIONS = {"low": ((1, 2, 3), (2, 4, 6)), "high": ((1, 2, 5), (2, 4, 10))}
EXPANSION, HEADS, FREQUENCIES, LAYER_SCALE = 6, 8, 16, 1e-6


class DilatedBlock(nn.Module):
    """One dilated convolution of the CDC module: ``x + scale * MLP(BN(DWConv(x)))``, ``(B, C, H, W)``.

    Args:
        channels: C.
        dilation: of the depthwise 3x3 convolution.
        drop_path: probability that a sample skips the branch in training.
    """

    def __init__(self, channels: int, dilation: int, *, drop_path: float = 0.0) -> None:
        super().__init__()
        self.branch = nn.Sequential(
            DepthwiseConv2d(
                channels, channels, 3, padding=dilation, dilation=dilation, groups=channels, bias=False
            ),
            nn.BatchNorm2d(channels),
            nn.Conv2d(channels, EXPANSION * channels, 1),
            nn.GELU(),
            nn.Conv2d(EXPANSION * channels, channels, 1),
        )
        self.scale = nn.Parameter(torch.full((channels, 1, 1), LAYER_SCALE))
        self.drop_path = StochasticDepth(drop_path, "row")

    def forward(self, x: Tensor) -> Tensor:
        """``(B, C, H, W)`` -> the same shape."""
        return x + self.drop_path(self.scale * self.branch(x))


class CrossCovarianceAttention(nn.Module):
    """XCA (El-Nouby et al., NeurIPS 2021): attention between channels, ``(B, N, C) -> (B, N, C)``."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.temperature = nn.Parameter(torch.ones(HEADS, 1, 1))
        self.qkv = nn.Linear(channels, 3 * channels)
        self.out = nn.Linear(channels, channels)

    def forward(self, tokens: Tensor) -> Tensor:
        """``(B, N, C)`` -> the same shape."""
        batch, number, channels = tokens.shape
        qkv = self.qkv(tokens).view(batch, number, 3, HEADS, channels // HEADS)
        query, key, value = qkv.permute(2, 0, 3, 4, 1).unbind()  # each (B, heads, C / heads, N)
        covariance = F.normalize(query, dim=-1) @ F.normalize(key, dim=-1).transpose(-2, -1)
        weights = (covariance * self.temperature).softmax(dim=-1)
        return self.out((weights @ value).permute(0, 3, 1, 2).reshape(batch, number, channels))


class FourierPosition(nn.Module):
    """Sines and cosines of row and column at 16 frequencies, projected to C channels."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.project = nn.Conv2d(4 * FREQUENCIES, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """``(B, C, H, W)``, of which only the size matters -> ``(1, C, H, W)``."""
        height, width = x.shape[-2:]
        steps = torch.arange(FREQUENCIES, device=x.device, dtype=torch.float32)
        rates = 10000 ** (-steps / FREQUENCIES)

        def waves(count: int) -> Tensor:
            """Sines and cosines of every position ``(2 * FREQUENCIES, count)``."""
            positions = torch.arange(1, count + 1, device=x.device, dtype=torch.float32)
            angles = rates[:, None] * positions * (2 * math.pi / count)
            return torch.stack([angles.sin(), angles.cos()], dim=1).flatten(0, 1)

        rows = waves(height)[:, :, None].expand(-1, -1, width)
        columns = waves(width)[:, None, :].expand(-1, height, -1)
        return self.project(torch.cat([rows, columns])[None].to(self.project.weight.dtype))


class GlobalBlock(nn.Module):
    """LGFI, the last block of each stage: attention over channels, then an MLP; ``(B, C, H, W)``.

    Convention: as in the published code, the residual of the whole block starts before the attention, whose
    result reaches the output only through the MLP.

    Args:
        channels: C.
        position: add a positional encoding.
        drop_path: probability that a sample skips the block in training.
    """

    def __init__(self, channels: int, *, position: bool, drop_path: float = 0.0) -> None:
        super().__init__()
        self.position = FourierPosition(channels) if position else None
        self.attention_norm = nn.LayerNorm(channels, eps=1e-6)
        self.attention = CrossCovarianceAttention(channels)
        self.attention_scale = nn.Parameter(torch.full((channels,), LAYER_SCALE))
        self.mlp = nn.Sequential(
            nn.LayerNorm(channels, eps=1e-6),
            nn.Linear(channels, EXPANSION * channels),
            nn.GELU(),
            nn.Linear(EXPANSION * channels, channels),
        )
        self.scale = nn.Parameter(torch.full((channels,), LAYER_SCALE))
        self.drop_path = StochasticDepth(drop_path, "row")

    def forward(self, x: Tensor) -> Tensor:
        """``(B, C, H, W)`` -> the same shape."""
        placed = x if self.position is None else x + self.position(x)
        tokens = placed.flatten(2).transpose(1, 2)
        tokens = tokens + self.attention_scale * self.attention(self.attention_norm(tokens))
        change = (self.scale * self.mlp(tokens)).transpose(1, 2).reshape(x.shape)
        return x + self.drop_path(change)


class ReflectConv(nn.Sequential):
    """3x3 convolution with reflected padding, and ELU: ``(B, in, H, W) -> (B, out, H, W)``."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__(nn.Conv2d(in_channels, out_channels, 3, padding=1, padding_mode="reflect"), nn.ELU())


class Encoder(nn.Module):
    """Image ``(B, 3, H, W)`` -> features at strides 4, 8, 16; each stage also sees the shrunk image."""

    def __init__(
        self, widths: Sequence[int], dilations: Sequence[Sequence[int]], *, drop_path: float
    ) -> None:
        super().__init__()
        first = widths[0]
        stem: list[nn.Module] = []
        for place, channels in enumerate((3, first, first)):
            stride = 2 if place == 0 else 1
            stem += [nn.Conv2d(channels, first, 3, stride=stride, padding=1, bias=False)]
            stem += [nn.BatchNorm2d(first), nn.GELU()]
        self.stem = nn.Sequential(*stem)
        self.pool = nn.AvgPool2d(3, stride=2, padding=1)
        self.down = nn.ModuleList([nn.Conv2d(first + 3, first, 3, stride=2, padding=1, bias=False)])
        for wide, wider in pairwise(widths):
            self.down.append(nn.Conv2d(2 * wide + 3, wider, 3, stride=2, padding=1, bias=False))
        depth = sum(len(row) + 1 for row in dilations)
        rates = iter(torch.linspace(0, drop_path, depth).tolist())
        self.stages = nn.ModuleList()
        for number, (width, row) in enumerate(zip(widths, dilations, strict=True)):
            blocks = [DilatedBlock(width, dilation, drop_path=next(rates)) for dilation in row]
            last = GlobalBlock(width, position=number == 0, drop_path=next(rates))
            self.stages.append(nn.Sequential(*blocks, last))
        init_kaiming(self)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Image ``(B, 3, H, W)`` -> features ``(B, C, h, w)``, finest first."""
        shrunk, joined = image, [self.stem(image)]
        features = []
        for down, stage in zip(self.down, self.stages, strict=True):
            shrunk = self.pool(shrunk)
            x = down(torch.cat([*joined, shrunk], dim=1))
            features.append(stage(x))
            joined = [x, features[-1]]
        return features


class LiteMono(Configurable, nn.Module):
    """Lite-Mono: 3.07 M parameters, tiny 2.15 M, small 2.47 M, 8M 8.77 M.

    Zhang et al., "Lite-Mono: A Lightweight CNN and Transformer Architecture for Self-Supervised Monocular
    Depth Estimation" (CVPR 2023, arXiv 2211.13202). The raw map has stride 2; the paper's sigmoid of it is
    inverse depth (``model/head=inverse``).

    Convention: this network has 0.1 to 0.2 % fewer parameters than the published one. It lacks the two
    coarser outputs, which serve self-supervised training, and layer normalizations that the published code
    holds but does not use. Images need at least 17 pixels on each side.

    Args:
        size: ``"tiny"``, ``"small"``, ``"base"`` or ``"8m"``.
        dilations: ``"low"``, the paper's for images of 640 x 192, or ``"high"``, for 1024 x 320 (the
            published 8M network uses ``"low"`` for both).
        drop_path: probability of skipping the deepest residual branch in training; it grows linearly from 0
            at the first.

    Raises:
        ValueError: an unknown size or set of dilations.
    """

    def __init__(self, size: str = "base", *, dilations: str = "low", drop_path: float = 0.2) -> None:
        super().__init__()
        one_of("size", size, SIZES)
        one_of("dilations", dilations, DILATIONS)
        widths, rounds = SIZES[size]
        near, far = DILATIONS[dilations]
        self.encoder = Encoder(widths, (near, near, near * rounds + far), drop_path=drop_path)
        narrow = [width // 2 for width in widths]
        self.before = nn.ModuleList(  # coarsest first
            ReflectConv(*pair)
            for pair in ((widths[2], narrow[2]), (narrow[2], narrow[1]), (narrow[1], narrow[0]))
        )
        self.after = nn.ModuleList(
            ReflectConv(*pair)
            for pair in (
                (narrow[2] + widths[1], narrow[2]),
                (narrow[1] + widths[0], narrow[1]),
                (narrow[0],) * 2,
            )
        )
        self.predict = nn.Conv2d(narrow[0], 1, 3, padding=1, padding_mode="reflect")
        for layer in (*self.before.modules(), *self.after.modules(), self.predict):
            if isinstance(layer, nn.Conv2d) and layer.bias is not None:
                nn.init.trunc_normal_(layer.weight, std=0.02)
                nn.init.zeros_(layer.bias)

    def forward(self, image: Tensor) -> Tensor:
        """Normalized image ``(B, 3, H, W)`` -> raw map ``(B, 1, ceil(H / 2), ceil(W / 2))``."""
        features = self.encoder(image)
        x = features[-1]
        for before, after, skip in zip(
            self.before, self.after, (features[1], features[0], None), strict=True
        ):
            x = F.interpolate(before(x), scale_factor=2, mode="bilinear", align_corners=False)
            x = after(torch.cat([crop_or_pad(x, skip), skip], dim=1) if skip is not None else x)
        return self.predict(x)[..., : -(-image.shape[-2] // 2), : -(-image.shape[-1] // 2)]

"""METER: MobileNetV2 blocks, small transformers at strides 8, 16 and 32, and a light decoder."""

import re
from collections import OrderedDict
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.backbones.weights import Weights, load_weights, read_weights
from eldenet.configurable import Configurable
from eldenet.decoders.base import crop_or_pad
from eldenet.layers import ConvNormAct
from eldenet.system.checks import one_of


class Size(NamedTuple):
    """Sizes of one network of the paper.

    Attributes:
        widths: channels of the stem, at strides 2, 4, 8, 16, 32, and of the encoder's last convolution.
        expansion: expansion factor of the MobileNetV2 blocks.
        tokens: channels of the transformers at strides 8, 16, 32.
        decoder: channels of the decoder at strides 32, 16, 8, 4.
    """

    widths: tuple[int, ...]
    expansion: int
    tokens: tuple[int, int, int]
    decoder: tuple[int, int, int, int]


SIZES = {
    "xxs": Size((16, 16, 24, 48, 64, 80, 160), 2, (64, 80, 96), (64, 32, 16, 8)),
    "xs": Size((16, 32, 48, 64, 80, 96, 192), 4, (96, 120, 144), (128, 64, 32, 16)),
    "s": Size((16, 32, 64, 96, 128, 160, 320), 4, (144, 192, 240), (128, 64, 32, 16)),
}
MLP_RATIOS = (2, 4, 4)
HEADS, HEAD_CHANNELS, PATCH = 4, 8, 2


def _conv_pair(in_channels: int, out_channels: int, stride: int = 1) -> nn.Sequential:
    """3x3 and 1x1 convolution without bias; the first is not depthwise, though METER calls them separable."""
    first = nn.Conv2d(in_channels, out_channels, 3, stride=stride, padding=1, bias=False)
    second = nn.Conv2d(out_channels, out_channels, 1, bias=False)
    return nn.Sequential(OrderedDict(spatial=first, pointwise=second))


def _pair_norm_act(in_channels: int, out_channels: int, stride: int = 1) -> nn.Sequential:
    pair = _conv_pair(in_channels, out_channels, stride)
    return nn.Sequential(OrderedDict(conv=pair, norm=nn.BatchNorm2d(out_channels), activation=nn.ReLU()))


class InvertedResidual(nn.Module):
    """MobileNetV2's block with ReLU: ``(B, in, H, W) -> (B, out, ceil(H / stride), ceil(W / stride))``."""

    def __init__(self, in_channels: int, out_channels: int, *, expansion: int, stride: int = 1) -> None:
        super().__init__()
        hidden = in_channels * expansion
        self.expand = ConvNormAct(in_channels, hidden, 1)
        self.depthwise = ConvNormAct(hidden, hidden, 3, stride=stride, groups=hidden)
        self.project = ConvNormAct(hidden, out_channels, 1, activation=nn.Identity)
        self.residual = stride == 1 and in_channels == out_channels

    def forward(self, x: Tensor) -> Tensor:
        """``(B, in, H, W)`` -> ``(B, out, ceil(H / stride), ceil(W / stride))``."""
        y = self.project(self.depthwise(self.expand(x)))
        return x + y if self.residual else y


class Attention(nn.Module):
    """Self-attention of four heads with 8 channels each: ``(..., N, C) -> (..., N, C)``."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.qkv = nn.Linear(channels, 3 * HEADS * HEAD_CHANNELS, bias=False)
        self.out = nn.Linear(HEADS * HEAD_CHANNELS, channels)

    def forward(self, tokens: Tensor) -> Tensor:
        """``(..., N, C)`` -> the same shape."""
        qkv = self.qkv(tokens).unflatten(-1, (3, HEADS, HEAD_CHANNELS))
        query, key, value = (part.transpose(-3, -2) for part in qkv.unbind(-3))  # (..., heads, N, 8)
        weights = (query @ key.transpose(-2, -1) * HEAD_CHANNELS**-0.5).softmax(dim=-1)
        return self.out((weights @ value).transpose(-3, -2).flatten(-2))


class TransformerBlock(nn.Module):
    """METER's block, after MobileViT's (Mehta and Rastegari, ICLR 2022): ``(B, C, H, W)`` -> the same.

    The pixels at one place of all 2x2 patches attend to each other; odd sizes are padded for it.

    Args:
        channels: C.
        width: channels of the tokens.
        mlp_ratio: hidden channels of the transformer's MLP divided by ``width``.
    """

    def __init__(self, channels: int, width: int, *, mlp_ratio: int) -> None:
        super().__init__()
        self.local = _pair_norm_act(channels, channels)
        self.widen = ConvNormAct(channels, width, 1)
        self.attention_norm, self.attention = nn.LayerNorm(width), Attention(width)
        self.mlp_norm = nn.LayerNorm(width)
        self.mlp = nn.Sequential(
            nn.Linear(width, mlp_ratio * width), nn.ReLU(), nn.Linear(mlp_ratio * width, width)
        )
        self.narrow = ConvNormAct(width, channels, 1)
        self.fuse = _pair_norm_act(2 * channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        """``(B, C, H, W)`` -> the same shape."""
        y = self.widen(self.local(x))
        y = F.pad(y, (0, y.shape[-1] % PATCH, 0, y.shape[-2] % PATCH), mode="replicate")
        batch, width, height, length = y.shape
        rows, columns = height // PATCH, length // PATCH
        tokens = y.view(batch, width, rows, PATCH, columns, PATCH).permute(0, 3, 5, 2, 4, 1)
        tokens = tokens.reshape(batch, PATCH * PATCH, rows * columns, width)
        tokens = tokens + self.attention(self.attention_norm(tokens))
        tokens = tokens + self.mlp(self.mlp_norm(tokens))
        y = tokens.view(batch, PATCH, PATCH, rows, columns, width).permute(0, 5, 3, 1, 4, 2)
        y = crop_or_pad(y.reshape(batch, width, height, length), x)
        return self.fuse(torch.cat([self.narrow(y), x], dim=1))


class UpBlock(nn.Module):
    """Transposed convolution to twice the size, concatenation with a skip, convolutions, ReLU."""

    def __init__(self, in_channels: int, skip_channels: int, out_channels: int) -> None:
        super().__init__()
        self.transposed = nn.ConvTranspose2d(
            in_channels, out_channels, 3, stride=2, padding=1, output_padding=1, bias=False
        )
        self.fuse = _conv_pair(out_channels + skip_channels, out_channels)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """``(B, in, h, w)`` and ``(B, skip, H, W)`` -> ``(B, out, H, W)``."""
        return self.fuse(torch.cat([crop_or_pad(self.transposed(x), skip), skip], dim=1)).relu()


class METER(Configurable, nn.Module):
    """METER: XXS 0.713 M parameters, XS 1.450 M, S 3.295 M.

    Papa et al., "METER: A Mobile Vision Transformer Architecture for Monocular Depth Estimation" (IEEE TCSVT
    2023); the published weights fit. The raw map has stride 4.

    Args:
        size: ``"xxs"``, ``"xs"`` or ``"s"``.
        weights: a file of published weights, see :func:`load_published`.

    Raises:
        ValueError: an unknown size, or weights that do not exist or do not fit.
    """

    transient_arguments = ("weights",)  # a saved model has its own weights

    def __init__(self, size: str = "xxs", *, weights: str | None = None) -> None:
        super().__init__()
        one_of("size", size, SIZES)
        widths, expansion, tokens, decoder = SIZES[size]
        stem, w2, w4, w8, w16, w32, last = widths
        self.stem = _pair_norm_act(3, stem, stride=2)
        channels, strides = (stem, w2, w4, w4, w4, w8, w16, w32), (1, 2, 1, 1, 2, 2, 2)
        self.convolutions = nn.ModuleList(
            InvertedResidual(*pair, expansion=expansion, stride=stride)
            for pair, stride in zip(pairwise(channels), strides, strict=True)
        )
        self.transformers = nn.ModuleList(
            TransformerBlock(channels, width, mlp_ratio=ratio)
            for channels, width, ratio in zip((w8, w16, w32), tokens, MLP_RATIOS, strict=True)
        )
        self.last = ConvNormAct(w32, last, 1)
        self.reduce = nn.Conv2d(last, decoder[0], 1, bias=False)
        self.up = nn.ModuleList(
            UpBlock(decoder[step], skip, decoder[step + 1]) for step, skip in enumerate((w16, w8, w4))
        )
        self.predict = nn.Conv2d(decoder[-1], 1, 3, padding=1, bias=False)
        if weights is not None:
            load_published(self, weights)

    def forward(self, image: Tensor) -> Tensor:
        """Normalized image ``(B, 3, H, W)`` -> raw map ``(B, 1, ceil(H / 4), ceil(W / 4))``."""
        stride4 = self.convolutions[1](self.convolutions[0](self.stem(image)))
        x = self.convolutions[3](self.convolutions[2](stride4))
        skips = [stride4]
        for convolution, transformer in zip(self.convolutions[4:], self.transformers, strict=True):
            skips.append(convolution(x))
            x = transformer(skips[-1])
        x = self.reduce(self.last(x))
        for up, skip in zip(self.up, (skips[2], skips[1], skips[0]), strict=True):
            x = up(x, skip)
        return self.predict(x)


# The published names -> ours, applied in this order, all of them to each name.
_RENAMES = (
    (r"^encoder\.mv2\.", "convolutions."),
    (r"^encoder\.mvit\.", "transformers."),
    (r"^encoder\.conv1\.", "stem."),
    (r"^encoder\.conv2\.0\.", "last.conv."),
    (r"^encoder\.conv2\.1\.", "last.norm."),
    (r"^decoder\.conv2d_in\.", "reduce."),
    (r"^decoder\.conv2d_out\.", "predict."),
    (r"^decoder\.ups_block_1\.", "up.0."),
    (r"^decoder\.ups_block_2\.", "up.1."),
    (r"^decoder\.ups_block_3\.", "up.2."),
    (r"\.conv2d_transpose\.", ".transposed."),
    (r"\.end_up_layer\.0\.", ".fuse."),
    (r"\.conv\.0\.", ".expand.conv."),
    (r"\.conv\.1\.", ".expand.norm."),
    (r"\.conv\.3\.", ".depthwise.conv."),
    (r"\.conv\.4\.", ".depthwise.norm."),
    (r"\.conv\.6\.", ".project.conv."),
    (r"\.conv\.7\.", ".project.norm."),
    (r"\.conv1\.", ".local."),
    (r"\.conv2\.", ".widen."),
    (r"\.conv3\.", ".narrow."),
    (r"\.conv4\.", ".fuse."),
    (r"\.transformer\.layers\.0\.0\.norm\.", ".attention_norm."),
    (r"\.transformer\.layers\.0\.0\.fn\.to_qkv\.", ".attention.qkv."),
    (r"\.transformer\.layers\.0\.0\.fn\.to_out\.0\.", ".attention.out."),
    (r"\.transformer\.layers\.0\.1\.norm\.", ".mlp_norm."),
    (r"\.transformer\.layers\.0\.1\.fn\.net\.0\.", ".mlp.0."),
    (r"\.transformer\.layers\.0\.1\.fn\.net\.3\.", ".mlp.2."),
    (r"(^stem|\.local|\.fuse|\.widen|\.narrow)\.0\.", r"\1.conv."),
    (r"(^stem|\.local|\.fuse|\.widen|\.narrow)\.1\.", r"\1.norm."),
    (r"\.depthwise\.weight$", ".spatial.weight"),
)


def load_published(network: METER, path: str | Path) -> None:
    """Load a file of METER's published weights, without running code from it.

    Convention: inputs and outputs of the published networks (measured, the repository does not state them):
    NYU: ImageNet's normalization, 256 x 192 images, centimeters: ``ScaledHead(0.01)``;
    KITTI: no normalization (``mean=(0, 0, 0), std=(1, 1, 1)``), 636 x 192 images, decimeters:
    ``ScaledHead(0.1, max_depth=80)``. At a width of 636 METER's own code pads a skip with a column of zeros
    on the left, where this one crops the map (:class:`UpBlock`): 640 gives the same function.

    Args:
        network: a network of the file's size (only XXS is published).
        path: the state dict of https://github.com/lorenzopapa5/METER, or one with this class's names.

    Raises:
        ValueError: no such file, or one with missing, surplus or differently shaped tensors.
    """
    weights: Weights = {}
    for name, tensor in read_weights(path).items():
        for pattern, replacement in _RENAMES:
            name = re.sub(pattern, replacement, name)
        weights[name] = tensor
    load_weights(network, weights, path)

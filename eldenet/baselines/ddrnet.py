"""DDRNet-23-slim, GuideDepth's feature extractor: a fine and a coarse branch that exchange features."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.layers import ConvNormAct, init_kaiming


def _conv_norm(in_channels: int, out_channels: int, kernel_size: int, stride: int = 1) -> ConvNormAct:
    return ConvNormAct(in_channels, out_channels, kernel_size, stride=stride, activation=nn.Identity)


def _norm_act_conv(in_channels: int, out_channels: int, kernel_size: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.BatchNorm2d(in_channels),
        nn.ReLU(),
        nn.Conv2d(in_channels, out_channels, kernel_size, padding=kernel_size // 2, bias=False),
    )


class Residual(nn.Module):
    """A residual block without a final activation: two 3x3 convolutions, or a bottleneck.

    ``(B, in_channels, H, W) -> (B, out_channels, ceil(H / stride), ceil(W / stride))``

    Args:
        stride: of the first 3x3 convolution.
        bottleneck: 1x1, 3x3 and 1x1 convolutions, the first two with half of ``out_channels``.
    """

    def __init__(
        self, in_channels: int, out_channels: int, *, stride: int = 1, bottleneck: bool = False
    ) -> None:
        super().__init__()
        if bottleneck:
            middle = out_channels // 2
            self.body = nn.Sequential(
                ConvNormAct(in_channels, middle, 1),
                ConvNormAct(middle, middle, 3, stride=stride),
                _conv_norm(middle, out_channels, 1),
            )
        else:
            self.body = nn.Sequential(
                ConvNormAct(in_channels, out_channels, 3, stride=stride),
                _conv_norm(out_channels, out_channels, 3),
            )
        same = stride == 1 and in_channels == out_channels
        self.shortcut = nn.Identity() if same else _conv_norm(in_channels, out_channels, 1, stride)

    def forward(self, x: Tensor) -> Tensor:
        """``(B, in, H, W)`` -> ``(B, out, ceil(H / stride), ceil(W / stride))``."""
        return self.body(x) + self.shortcut(x)


def _stage(in_channels: int, out_channels: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        Residual(in_channels, out_channels, stride=stride), nn.ReLU(), Residual(out_channels, out_channels)
    )


class PyramidPooling(nn.Module):
    """DAPPM (section 3.3 of the paper): averages over growing windows, each fused with the one before.

    ``(B, in_channels, H, W) -> (B, out_channels, H, W)``. The largest window is the whole map, so training
    needs batches of two images or more.
    """

    def __init__(self, in_channels: int, branch_channels: int, out_channels: int) -> None:
        super().__init__()
        windows = ((5, 2), (9, 4), (17, 8))  # (size, stride)
        pools = [nn.AvgPool2d(size, stride, padding=size // 2) for size, stride in windows]
        self.pools = nn.ModuleList([*pools, nn.AdaptiveAvgPool2d(1)])
        self.scales = nn.ModuleList(_norm_act_conv(in_channels, branch_channels) for _ in range(5))
        self.fuse = nn.ModuleList(_norm_act_conv(branch_channels, branch_channels, 3) for _ in range(4))
        self.compress = _norm_act_conv(branch_channels * 5, out_channels)
        self.shortcut = _norm_act_conv(in_channels, out_channels)

    def forward(self, x: Tensor) -> Tensor:
        """``(B, in, H, W)`` -> ``(B, out, H, W)``."""
        branches = [self.scales[0](x)]
        for pool, scale, fuse in zip(self.pools, self.scales[1:], self.fuse, strict=True):
            branches.append(fuse(_resize(scale(pool(x)), x) + branches[-1]))
        return self.compress(torch.cat(branches, 1)) + self.shortcut(x)


class DDRNet(nn.Module):
    """DDRNet-23-slim: ``(B, 3, H, W) -> (B, out_channels, ceil(H / 8), ceil(W / 8))``.

    Hong et al., "Deep Dual-resolution Networks for Real-time and Accurate Semantic Segmentation of Road
    Scenes" (arXiv 2101.06085), ending in its segmentation head, as in GuideDepth.

    Convention: convolutions before a normalization have no bias (those of the published stem have one, which
    the normalization cancels).
    """

    def __init__(self, out_channels: int) -> None:
        super().__init__()
        width, fine, head = 32, 64, 64  # channels of the stem, the fine branch and the head
        self.stem = nn.Sequential(ConvNormAct(3, width, 3, stride=2), ConvNormAct(width, width, 3, stride=2))
        self.shared = nn.Sequential(_stage(width, width), nn.ReLU(), _stage(width, fine, stride=2))
        self.coarse = nn.ModuleList(
            [_stage(fine, 4 * width, stride=2), _stage(4 * width, 8 * width, stride=2)]
        )
        self.fine = nn.ModuleList([_stage(fine, fine), _stage(fine, fine)])
        self.to_coarse = nn.ModuleList(
            [
                _conv_norm(fine, 4 * width, 3, 2),
                nn.Sequential(
                    ConvNormAct(fine, 4 * width, 3, stride=2), _conv_norm(4 * width, 8 * width, 3, 2)
                ),
            ]
        )
        self.to_fine = nn.ModuleList([_conv_norm(4 * width, fine, 1), _conv_norm(8 * width, fine, 1)])
        self.coarse_end = Residual(8 * width, 16 * width, stride=2, bottleneck=True)
        self.fine_end = Residual(fine, 2 * fine, bottleneck=True)
        self.pooling = PyramidPooling(16 * width, 128, 2 * fine)
        self.head = nn.Sequential(
            _norm_act_conv(2 * fine, head, 3),
            nn.BatchNorm2d(head),
            nn.ReLU(),
            nn.Conv2d(head, out_channels, 1),
        )
        init_kaiming(self)

    def forward(self, image: Tensor) -> Tensor:
        """Normalized image ``(B, 3, H, W)`` -> features at stride 8."""
        fine = coarse = self.shared(self.stem(image)).relu()
        for index in range(2):
            coarse, fine = self.coarse[index](coarse), self.fine[index](fine)
            down = self.to_coarse[index](fine.relu())
            up = _resize(self.to_fine[index](coarse.relu()), fine)
            coarse, fine = (coarse + down).relu(), (fine + up).relu()
        fine = self.fine_end(fine)
        return self.head(fine + _resize(self.pooling(self.coarse_end(coarse)), fine))


def _resize(x: Tensor, like: Tensor) -> Tensor:
    """``x (B, C, h, w)`` at the size of ``like (B, C, H, W)``."""
    return F.interpolate(x, size=like.shape[-2:], mode="bilinear", align_corners=False)

"""ELDE-Net's default decoder: fast up-convolution modules with lateral connections."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from eldenet.decoders.base import Decoder, crop_or_pad, kernel_conv
from eldenet.decoders.upconv import UpConvBlock
from eldenet.layers import ConvNormAct
from eldenet.system.checks import one_of
from eldenet.types import FeatureInfo

FUSIONS = ("add", "concat", "none")


class FastUpConvDecoder(Decoder):
    """Fast up-convolution modules, each with the kernels 3x3, 3x2, 2x3 and 2x2 and a pixel shuffle.

    A convolution reduces the deepest feature. Each module then doubles the size and halves the channels, and
    the encoder's feature of that stride joins through a convolution: it is added, or a concatenation block
    (concatenation, 1x1 convolution, batch normalization, ReLU) merges both. The readings of the paper's
    decoder are ``fusion`` and ``kernels``; see ``docs/paper.md``.

    Args:
        feature_info: of the backbone, finest first.
        width: channels to which the deepest feature is reduced; None: half of its own.
        fusion: "add" adds the encoder's features; "concat" joins them by a concatenation block; "none" uses
            the deepest feature alone.
        min_channels: least number of channels of a module.
        lateral_strides: strides whose features join; None: all that a module reaches.
        modules: number of doublings. With an encoder of stride 32, the baseline's four end at stride 2 and
            three end at stride 4; the last module is the most expensive.
        kernels: ``(height, width)`` of the convolutions on the encoder's features: one for each of the finest
            features that a module reaches, and last the deepest feature's. Features between take no part.
            None: 1x1 on all.

    Raises:
        ValueError: an unknown fusion, more modules than the encoder has halvings, lateral strides at which
            no module ends, or ``kernels`` together with ``lateral_strides`` or without a fusion.
    """

    def __init__(
        self,
        feature_info: Sequence[FeatureInfo],
        *,
        width: int | None = None,
        fusion: str = "add",
        min_channels: int = 8,
        lateral_strides: Sequence[int] | None = None,
        modules: int = 4,
        kernels: Sequence[Sequence[int]] | None = None,
    ) -> None:
        super().__init__(feature_info)
        one_of("fusion", fusion, FUSIONS)
        deepest = max(self.index_of)
        most = int(math.log2(deepest))
        if not 1 <= modules <= most:
            raise ValueError(
                f"modules={modules}: each doubles the size, starting at stride {deepest}; choose 1 to {most}"
            )
        self.deepest, self.stride = self.index_of[deepest], deepest // 2**modules
        self.strides = [deepest // 2 ** (step + 1) for step in range(modules)]
        reached = [stride for stride in self.strides if stride in self.channels_at]
        if kernels is not None:
            if not 1 < len(kernels) <= len(reached) + 1 or lateral_strides is not None or fusion == "none":
                raise ValueError(
                    f"kernels={kernels}: give 2 to {len(reached) + 1}, the last for the deepest feature, and "
                    "neither lateral_strides nor fusion=none"
                )
            lateral_strides = sorted(reached)[: len(kernels) - 1]
        wanted = reached if lateral_strides is None else list(lateral_strides)
        if not set(wanted) <= set(reached):
            raise ValueError(f"lateral_strides={wanted}: the modules reach features of strides {reached}")
        width = self.channels_at[deepest] // 2 if width is None else width
        channels = [max(width // 2**step, min_channels) for step in range(modules + 1)]
        kernel_at = {} if kernels is None else dict(zip([*wanted, deepest], kernels, strict=True))

        def converted(stride: int, out_channels: int) -> nn.Sequential:
            if stride in kernel_at:
                return nn.Sequential(*kernel_conv(self.channels_at[stride], out_channels, kernel_at[stride]))
            return nn.Sequential(
                nn.Conv2d(self.channels_at[stride], out_channels, 1, bias=False), nn.BatchNorm2d(out_channels)
            )

        self.reduce = converted(deepest, channels[0])
        self.up = nn.ModuleList()
        self.lateral = nn.ModuleDict()  # by stride
        self.merge = nn.ModuleDict()  # by stride, for fusion="concat"
        for step, stride in enumerate(self.strides):
            width = channels[step + 1]
            self.up.append(UpConvBlock(channels[step], width))
            if fusion != "none" and stride in wanted:
                self.lateral[str(stride)] = converted(stride, width)
                if fusion == "concat":
                    self.merge[str(stride)] = ConvNormAct(2 * width, width, 1, activation=nn.ReLU)
        self.predict = nn.Conv2d(channels[-1], 1, 3, padding=1)

    def forward(self, features: Sequence[Tensor]) -> Tensor:
        """Features, finest first -> raw map ``(B, 1, h, w)``."""
        x = self.reduce(features[self.deepest])
        for stride, module in zip(self.strides, self.up, strict=True):
            x = module(x)
            if str(stride) in self.lateral:
                lateral = self.lateral[str(stride)](features[self.index_of[stride]])
                x = crop_or_pad(x, lateral)
                if str(stride) in self.merge:
                    x = self.merge[str(stride)](torch.cat((x, lateral), dim=1))
                else:
                    x = x + lateral
        raw = self.predict(x)
        return raw if str(self.stride) in self.lateral else self.within_image(raw, features)

"""ELDE-Net's default decoder: fast up-convolution modules with lateral connections."""

import math
from collections.abc import Sequence

from torch import Tensor, nn

from eldenet.decoders.base import Decoder, crop_or_pad
from eldenet.decoders.upconv import UpConvBlock
from eldenet.types import FeatureInfo

FUSIONS = ("add", "none")


class FastUpConvDecoder(Decoder):
    """Fast up-convolution modules, each with the kernels 3x3, 3x2, 2x3 and 2x2 and a pixel shuffle.

    A 1x1 convolution reduces the deepest feature. Each module then doubles the size and halves the channels,
    and the encoder's feature of that stride is added through a 1x1 convolution.

    Args:
        feature_info: of the backbone, finest first.
        width: channels after the first 1x1 convolution; None: half of the deepest feature's.
        fusion: "add" adds the encoder's features; "none" uses the deepest feature alone.
        min_channels: least number of channels of a module.
        lateral_strides: strides whose features are added; None: all.
        modules: number of doublings. With an encoder of stride 32, the baseline's four end at stride 2 and
            three end at stride 4; the last module is the most expensive.

    Raises:
        ValueError: an unknown fusion, more modules than the encoder has halvings, or lateral strides at which
            no module ends.
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
    ) -> None:
        super().__init__(feature_info)
        if fusion not in FUSIONS:
            raise ValueError(f"fusion={fusion!r}: choose one of {', '.join(FUSIONS)}")
        deepest = max(self.index_of)
        most = int(math.log2(deepest))
        if not 1 <= modules <= most:
            raise ValueError(
                f"modules={modules}: each doubles the size, starting at stride {deepest}; choose 1 to {most}"
            )
        self.deepest, self.stride = self.index_of[deepest], deepest // 2**modules
        self.strides = [deepest // 2 ** (step + 1) for step in range(modules)]
        reached = [stride for stride in self.strides if stride in self.channels_at]
        wanted = reached if lateral_strides is None else list(lateral_strides)
        if not set(wanted) <= set(reached):
            raise ValueError(f"lateral_strides={wanted}: the modules reach features of strides {reached}")
        width = self.channels_at[deepest] // 2 if width is None else width
        channels = [max(width // 2**step, min_channels) for step in range(modules + 1)]
        self.reduce = nn.Sequential(
            nn.Conv2d(self.channels_at[deepest], channels[0], 1, bias=False), nn.BatchNorm2d(channels[0])
        )
        self.up = nn.ModuleList()
        self.lateral = nn.ModuleDict()  # by stride
        for step, stride in enumerate(self.strides):
            self.up.append(UpConvBlock(channels[step], channels[step + 1]))
            if fusion == "add" and stride in wanted:
                self.lateral[str(stride)] = nn.Sequential(
                    nn.Conv2d(self.channels_at[stride], channels[step + 1], 1, bias=False),
                    nn.BatchNorm2d(channels[step + 1]),
                )
        self.predict = nn.Conv2d(channels[-1], 1, 3, padding=1)

    def forward(self, features: Sequence[Tensor]) -> Tensor:
        """Features, finest first -> raw map ``(B, 1, h, w)``."""
        x = self.reduce(features[self.deepest])
        for stride, module in zip(self.strides, self.up, strict=True):
            x = module(x)
            if str(stride) in self.lateral:
                lateral = self.lateral[str(stride)](features[self.index_of[stride]])
                x = crop_or_pad(x, lateral) + lateral
        raw = self.predict(x)
        return raw if str(self.stride) in self.lateral else self.within_image(raw, features)

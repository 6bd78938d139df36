"""PP-LCNet, the light-weight CPU network that ELDE-Net encodes with."""

from typing import NamedTuple

from torch import Tensor, nn

from eldenet.backbones.base import Backbone
from eldenet.backbones.pplcnet_weights import load_pplcnet_weights
from eldenet.layers import ConvNormAct, DepthwiseSeparable, init_kaiming
from eldenet.types import FeatureInfo


class Block(NamedTuple):
    """One depthwise separable convolution of the paper's table, at scale 1."""

    kernel: int
    in_channels: int
    out_channels: int
    stride: int
    squeeze_excite: bool


# The paper's table of blocks (PaddleClas: NET_CONFIG). After the stem, which has stride 2, every stage but
# blocks2 opens with a stride of 2: blocks2 to blocks6 end at strides 2, 4, 8, 16, 32.
STAGES: dict[str, tuple[Block, ...]] = {
    #                 k   in  out  s  SE
    "blocks2": (Block(3, 16, 32, 1, False),),
    "blocks3": (Block(3, 32, 64, 2, False), Block(3, 64, 64, 1, False)),
    "blocks4": (Block(3, 64, 128, 2, False), Block(3, 128, 128, 1, False)),
    "blocks5": (Block(3, 128, 256, 2, False), *[Block(5, 256, 256, 1, False)] * 5),
    "blocks6": (Block(5, 256, 512, 2, True), Block(5, 512, 512, 1, True)),
}
STEM_CHANNELS = 16
HEAD_CHANNELS = 1280  # the classifier's, not scaled
SCALES = (0.25, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5)


def scale_channels(channels: int, scale: float, divisor: int = 8) -> int:
    """``channels * scale`` as the nearest multiple of ``divisor``, never more than 10 % below it."""
    wanted = channels * scale
    rounded = max(divisor, int(wanted + divisor / 2) // divisor * divisor)
    return rounded + divisor if rounded < 0.9 * wanted else rounded


class PPLCNet(Backbone):
    """PP-LCNet without its classifier.

    Cui et al., "PP-LCNet: A Lightweight CPU Convolutional Neural Network" (arXiv 2109.15099): depthwise
    separable convolutions without residuals, h-swish, 5 x 5 kernels in the second half and
    squeeze-excitation in the last two blocks only. Parameters: 0.27 M at scale 0.5, 1.02 M at scale 1.

    Features: strides 2, 4, 8, 16, 32, the outputs of blocks2 to blocks6.

    Args:
        scale: width; one of 0.25, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5.
        stem_feature: give the stem's output as the stride 2 feature in place of that of blocks2, which has
            the same stride and more channels. Nothing else changes: blocks2 still feeds blocks3.
        squeeze_excite: False leaves squeeze-excitation out of the last two blocks, for ablations.
        shortcuts: add a block's input to its output wherever both have one shape. The paper's network has
            none, and neither have its published weights.
        pretrained: ``True`` for timm's ImageNet weights of this scale (0.5, 0.75 and 1.0 have them), their
            name (``"lcnet_050.ra2_in1k"``), or a local file: see
            :func:`~eldenet.backbones.pplcnet_weights.load_pplcnet_weights`.

    Raises:
        ValueError: for a scale or weights that do not exist, or ``shortcuts`` beside published weights.
        RuntimeError: where weights cannot be downloaded.
    """

    def __init__(
        self,
        scale: float = 0.5,
        *,
        stem_feature: bool = False,
        squeeze_excite: bool = True,
        shortcuts: bool = False,
        pretrained: bool | str = False,
    ) -> None:
        super().__init__()
        if scale not in SCALES:
            raise ValueError(f"PP-LCNet has no scale {scale}; choose one of {', '.join(map(str, SCALES))}")
        if shortcuts and pretrained:
            raise ValueError(
                f"pretrained={pretrained}: PP-LCNet's published weights were trained without shortcuts; "
                "give model.backbone.shortcuts=false too"
            )
        self.scale = scale
        self.stem_feature = stem_feature

        self.stem = ConvNormAct(3, scale_channels(STEM_CHANNELS, scale), 3, stride=2, activation=nn.Hardswish)
        self.blocks2 = _stage(STAGES["blocks2"], scale, shortcuts)
        self.blocks3 = _stage(STAGES["blocks3"], scale, shortcuts)
        self.blocks4 = _stage(STAGES["blocks4"], scale, shortcuts)
        self.blocks5 = _stage(STAGES["blocks5"], scale, shortcuts)
        last = STAGES["blocks6"]
        if not squeeze_excite:
            last = tuple(block._replace(squeeze_excite=False) for block in last)
        self.blocks6 = _stage(last, scale, shortcuts)

        channels = [scale_channels(stage[-1].out_channels, scale) for stage in STAGES.values()]
        if stem_feature:
            channels[0] = scale_channels(STEM_CHANNELS, scale)
        self.feature_info = tuple(
            FeatureInfo(width, stride) for width, stride in zip(channels, (2, 4, 8, 16, 32), strict=True)
        )

        init_kaiming(self)
        if pretrained:
            load_pplcnet_weights(self, pretrained, scale)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Encode ``(B, 3, H, W)``; the maps are described in the base class."""
        stem = self.stem(image)
        stride2 = self.blocks2(stem)
        stride4 = self.blocks3(stride2)
        stride8 = self.blocks4(stride4)
        stride16 = self.blocks5(stride8)
        stride32 = self.blocks6(stride16)
        return (stem if self.stem_feature else stride2), stride4, stride8, stride16, stride32


class PPLCNetClassifier(nn.Module):
    """The whole PP-LCNet of the paper: ``(B, 3, H, W) -> (B, num_classes)`` logits.

    Depth does not need it. It stands here because the published parameter and operation counts are the
    classifier's, and so that the published classification weights can be tried as what they are.

    Args:
        scale: width, as of :class:`PPLCNet`.
        num_classes: of the last layer.
        head_bias: give the 1 x 1 convolution of the head a bias: timm's weights have one, the paper's do not.
        dropout: before the last layer.
    """

    def __init__(
        self, scale: float = 1.0, num_classes: int = 1000, *, head_bias: bool = False, dropout: float = 0.2
    ) -> None:
        super().__init__()
        self.encoder = PPLCNet(scale)
        self.pool = nn.AdaptiveAvgPool2d(1)
        self.last_conv = nn.Conv2d(self.encoder.feature_info[-1].channels, HEAD_CHANNELS, 1, bias=head_bias)
        self.activation = nn.Hardswish()
        self.dropout = nn.Dropout(dropout)
        self.fc = nn.Linear(HEAD_CHANNELS, num_classes)
        init_kaiming(self.last_conv)

    def forward(self, image: Tensor) -> Tensor:
        """``(B, 3, H, W) -> (B, num_classes)``."""
        features = self.encoder(image)[-1]
        hidden = self.activation(self.last_conv(self.pool(features)))
        return self.fc(self.dropout(hidden.flatten(1)))


def _stage(blocks: tuple[Block, ...], scale: float, shortcuts: bool) -> nn.Sequential:
    return nn.Sequential(
        *(
            DepthwiseSeparable(
                scale_channels(block.in_channels, scale),
                scale_channels(block.out_channels, scale),
                block.kernel,
                stride=block.stride,
                squeeze_excite=block.squeeze_excite,
                shortcut=shortcuts,
                activation=nn.Hardswish,
            )
            for block in blocks
        )
    )

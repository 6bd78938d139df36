"""PP-LCNet, a light-weight network for CPUs and ELDE-Net's encoder."""

from typing import NamedTuple

from torch import Tensor, nn

from eldenet.backbones.base import Backbone, five_stages
from eldenet.backbones.pplcnet_weights import load_pplcnet_weights
from eldenet.layers import ConvNormAct, DepthwiseSeparable, init_kaiming
from eldenet.system.checks import one_of


class Block(NamedTuple):
    """One depthwise separable convolution of the paper's table, at scale 1."""

    kernel: int
    in_channels: int
    out_channels: int
    stride: int
    squeeze_excite: bool


# The paper's table of blocks (NET_CONFIG in PaddleClas). The stem has stride 2, and every stage but blocks2
# starts with a stride of 2, so blocks2 to blocks6 end at strides 2, 4, 8, 16, 32.
STAGES: dict[str, tuple[Block, ...]] = {
    #                 k   in  out  s  SE
    "blocks2": (Block(3, 16, 32, 1, False),),
    "blocks3": (Block(3, 32, 64, 2, False), Block(3, 64, 64, 1, False)),
    "blocks4": (Block(3, 64, 128, 2, False), Block(3, 128, 128, 1, False)),
    "blocks5": (Block(3, 128, 256, 2, False), *[Block(5, 256, 256, 1, False)] * 5),
    "blocks6": (Block(5, 256, 512, 2, True), Block(5, 512, 512, 1, True)),
}
STEM_CHANNELS = 16
SCALES = (0.25, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5)


def scale_channels(channels: int, scale: float) -> int:
    """Round ``channels * scale`` to the nearest multiple of 8, never more than 10 % down."""
    wanted = channels * scale
    rounded = max(8, int(wanted + 4) // 8 * 8)
    return rounded + 8 if rounded < 0.9 * wanted else rounded


class PPLCNet(Backbone):
    """PP-LCNet without its classifier.

    Cui et al., "PP-LCNet: A Lightweight CPU Convolutional Neural Network" (arXiv 2109.15099): depthwise
    separable convolutions without residuals, h-swish, 5 x 5 kernels in the second half and
    squeeze-excitation in the last two blocks only. Parameters: 0.27 M at scale 0.5, 1.02 M at scale 1.

    Features: strides 2, 4, 8, 16, 32, the outputs of blocks2 to blocks6.

    Args:
        scale: width; one of 0.25, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5.
        stem_feature: return the stem's output as the stride 2 feature, not the wider output of blocks2.
        squeeze_excite: False removes squeeze-excitation from the last two blocks, for ablations.
        shortcuts: add a block's input to its output wherever their shapes are equal. The paper's network and
            its published weights have no shortcuts.
        pretrained: ``True`` for timm's ImageNet weights of this scale (for 0.5, 0.75 and 1.0), their name
            (``"lcnet_050.ra2_in1k"``), or a local file, see
            :func:`~eldenet.backbones.pplcnet_weights.load_pplcnet_weights`.

    Raises:
        ValueError: a scale or weights that do not exist, or ``shortcuts`` together with ``pretrained``.
        ConnectionError: the weights cannot be downloaded.
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
        one_of("scale", scale, SCALES)
        if shortcuts and pretrained:
            raise ValueError(
                f"pretrained={pretrained}: PP-LCNet's published weights were trained without shortcuts; "
                "also give model.backbone.shortcuts=false"
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
        self.feature_info = five_stages(*channels)
        init_kaiming(self)
        if pretrained:
            load_pplcnet_weights(self, pretrained, scale)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Return the features of ``(B, 3, H, W)``, finest first."""
        stem = self.stem(image)
        stride2 = self.blocks2(stem)
        stride4 = self.blocks3(stride2)
        stride8 = self.blocks4(stride4)
        stride16 = self.blocks5(stride8)
        stride32 = self.blocks6(stride16)
        return (stem if self.stem_feature else stride2), stride4, stride8, stride16, stride32


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

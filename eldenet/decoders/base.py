"""The base class of decoders: feature maps in, one raw map out, skips looked up by stride."""

from collections.abc import Sequence

import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.configurable import Configurable
from eldenet.types import FeatureInfo


class Decoder(Configurable, nn.Module):
    """Base of decoders.

    Args:
        feature_info: channels and strides of the backbone's features, finest first;
            :class:`~eldenet.model.EncoderDecoder` supplies it.

    Attributes:
        stride: stride of the raw map ``(B, 1, ceil(H / stride), ceil(W / stride))``.

    Raises:
        ValueError: two features with the same stride.
    """

    supplied_arguments = ("feature_info",)
    stride: int

    def __init__(self, feature_info: Sequence[FeatureInfo]) -> None:
        super().__init__()
        self.index_of = {info.stride: index for index, info in enumerate(feature_info)}
        self.channels_at = {info.stride: info.channels for info in feature_info}
        if len(self.index_of) != len(feature_info):
            strides = [info.stride for info in feature_info]
            raise ValueError(
                f"features of strides {strides}: strides must be distinct, as in a convolutional network; "
                "choose another backbone"
            )

    def forward(self, features: Sequence[Tensor]) -> Tensor:
        """Features, finest first -> raw map ``(B, 1, h, w)`` at :attr:`stride`."""
        raise NotImplementedError

    def within_image(self, raw: Tensor, features: Sequence[Tensor]) -> Tensor:
        """Crop a raw map ``(B, 1, h, w)`` at :attr:`stride` to the image.

        Doubling the deepest feature gives the map of a padded image: 4 rows of stride 32 stand for 128 rows,
        where the image may have 97. Without the crop, resizing to the image would squeeze the depth map.
        """
        finest = min(self.index_of)
        height, width = features[self.index_of[finest]].shape[-2:]
        return raw[..., : -(-height * finest // self.stride), : -(-width * finest // self.stride)]


def kernel_conv(in_channels: int, out_channels: int, kernel: Sequence[int]) -> list[nn.Module]:
    """Return a convolution of ``kernel`` (height, width) that keeps the size, and batch normalization.

    An even kernel needs one more row or column of padding at the bottom or right.
    """
    height, width = kernel
    return [
        nn.ZeroPad2d(((width - 1) // 2, width // 2, (height - 1) // 2, height // 2)),
        nn.Conv2d(in_channels, out_channels, (height, width), bias=False),
        nn.BatchNorm2d(out_channels),
    ]


def crop_or_pad(x: Tensor, like: Tensor) -> Tensor:
    """``x (B, C, h, w)`` at the height and width of ``like``: odd sizes leave up-sampled maps a pixel off."""
    missing_rows, missing_cols = like.shape[-2] - x.shape[-2], like.shape[-1] - x.shape[-1]
    if missing_rows > 0 or missing_cols > 0:
        x = F.pad(x, (0, max(missing_cols, 0), 0, max(missing_rows, 0)), mode="replicate")
    return x[..., : like.shape[-2], : like.shape[-1]]

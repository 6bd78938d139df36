"""The base class of backbones: an image in, feature maps out, each described by channels and stride."""

from collections.abc import Collection, Iterable

from torch import Tensor, nn

from eldenet.configurable import Configurable
from eldenet.types import FeatureInfo


class Backbone(Configurable, nn.Module):
    """Base of encoders; decoders need to know nothing but ``feature_info``.

    A new backbone sets ``feature_info`` in its constructor, implements ``forward`` and gets one YAML file in
    ``configs/model/backbone/``; ``tests/backbones/test_backbones.py`` then checks it.

    Convention: an ``(H, W)`` image has a feature of ``(ceil(H / s), ceil(W / s))`` at stride s, for any size.

    Attributes:
        feature_info: channels and stride of each feature map, finest first; strides are distinct.
    """

    transient_arguments = ("pretrained",)  # a saved model has its own weights and downloads none

    feature_info: tuple[FeatureInfo, ...]

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Encode a batch of images.

        Args:
            image: ``(B, 3, H, W)``, normalized by mean and standard deviation (``DepthNet`` does that).

        Returns:
            One map ``(B, channels, ceil(H / stride), ceil(W / stride))`` per entry of ``feature_info``.
        """
        raise NotImplementedError(f"{type(self).__name__} has no forward")


def outputs_of(layers: Iterable[nn.Module], x: Tensor, ends: Collection[int]) -> tuple[Tensor, ...]:
    """Run layers one after the other on ``(B, C, H, W)``; return the outputs of the numbers ``ends``."""
    outputs = []
    for number, layer in enumerate(layers):
        x = layer(x)
        if number in ends:
            outputs.append(x)
    return tuple(outputs)


def five_stages(*channels: int) -> tuple[FeatureInfo, ...]:
    """Return the ``feature_info`` of maps with these channels at strides 2, 4, 8, 16 and 32."""
    return tuple(
        FeatureInfo(width, stride) for width, stride in zip(channels, (2, 4, 8, 16, 32), strict=True)
    )

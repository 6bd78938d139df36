"""What every backbone is: an image in, feature maps out, each described by channels and stride."""

from torch import Tensor, nn

from eldenet.configurable import Configurable
from eldenet.types import FeatureInfo


class Backbone(Configurable, nn.Module):
    """An encoder that decoders can read without knowing which one it is.

    A subclass sets ``feature_info`` in its constructor and writes ``forward``. That, and one YAML file in
    ``configs/model/backbone/``, is all a new backbone takes; ``tests/test_backbones.py`` then measures it.

    Convention: the feature of stride s of an ``(H, W)`` image is ``(ceil(H / s), ceil(W / s))``, whatever
    the size.

    Attributes:
        feature_info: channels and stride of each feature map, finest first; no stride occurs twice.
    """

    transient_arguments = ("pretrained",)  # a saved model brings its own weights: it must not download others

    feature_info: tuple[FeatureInfo, ...]

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Encode a batch of images.

        Args:
            image: ``(B, 3, H, W)``, normalized by mean and standard deviation (``DepthNet`` does that).

        Returns:
            One map ``(B, channels, ceil(H / stride), ceil(W / stride))`` per entry of ``feature_info``.
        """
        raise NotImplementedError(f"{type(self).__name__} has no forward")

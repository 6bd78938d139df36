"""VGG16, the heavy baseline."""

from torch import Tensor, nn
from torchvision.models import vgg

from eldenet.backbones.base import Backbone
from eldenet.backbones.weights import load_torchvision_weights
from eldenet.layers import init_kaiming
from eldenet.types import FeatureInfo


class VGG16(Backbone):
    """torchvision's VGG16 without its classifier.

    Simonyan and Zisserman, "Very Deep Convolutional Networks for Large-Scale Image Recognition" (ICLR 2015).

    Features: strides 2, 4, 8, 16, 32, the outputs of the five max-pools.

    Convention: the max-pools round sizes up, as the strided convolutions of every other backbone do;
    torchvision's round down. The two agree for sizes that 32 divides.

    Args:
        batch_norm: with batch normalization after every convolution.
        pretrained: ``True`` for torchvision's ImageNet weights, their name, or a local file.

    Raises:
        ValueError: for weights that do not exist or do not fit.
        RuntimeError: where weights cannot be downloaded.
    """

    def __init__(self, *, batch_norm: bool = False, pretrained: bool | str = False) -> None:
        super().__init__()
        # Only the convolutions are built: the classifier's 124 M parameters would take seconds to draw and
        # throw away.
        self.features: nn.Sequential = vgg.make_layers(vgg.cfgs["D"], batch_norm=batch_norm)
        for layer in self.features:
            if isinstance(layer, nn.MaxPool2d):
                layer.ceil_mode = True
        widths = (64, 128, 256, 512, 512)
        self.feature_info = tuple(
            FeatureInfo(width, stride) for width, stride in zip(widths, (2, 4, 8, 16, 32), strict=True)
        )
        init_kaiming(self)
        if pretrained:
            load_torchvision_weights(self, "vgg16_bn" if batch_norm else "vgg16", pretrained)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Encode ``(B, 3, H, W)``; the maps are described in the base class."""
        features = []
        x = image
        for layer in self.features:
            x = layer(x)
            if isinstance(layer, nn.MaxPool2d):
                features.append(x)
        return tuple(features)

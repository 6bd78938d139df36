"""VGG16, the heaviest of the baseline encoders."""

from torch import Tensor, nn
from torchvision.models import vgg

from eldenet.backbones.base import Backbone, five_stages, outputs_of
from eldenet.backbones.weights import load_torchvision_weights
from eldenet.layers import init_kaiming


class VGG16(Backbone):
    """torchvision's VGG16 without its classifier.

    Simonyan and Zisserman, "Very Deep Convolutional Networks for Large-Scale Image Recognition" (ICLR 2015).

    Features: strides 2, 4, 8, 16, 32, the outputs of the five max-pools.

    Convention: the max-pools round sizes up, as the strided convolutions of every other backbone do;
    torchvision's round down. Both agree for sizes that are multiples of 32.

    Args:
        batch_norm: add batch normalization after every convolution.
        pretrained: ``True`` for torchvision's ImageNet weights, their name, or a local file.

    Raises:
        ValueError: weights that do not exist or do not fit.
        ConnectionError: the weights cannot be downloaded.
    """

    def __init__(self, *, batch_norm: bool = False, pretrained: bool | str = False) -> None:
        super().__init__()
        # Only the convolutions: initializing the classifier's 124 M parameters would take seconds.
        self.features: nn.Sequential = vgg.make_layers(vgg.cfgs["D"], batch_norm=batch_norm)
        self._pools = [n for n, layer in enumerate(self.features) if isinstance(layer, nn.MaxPool2d)]
        for number in self._pools:
            self.features[number].ceil_mode = True
        self.feature_info = five_stages(64, 128, 256, 512, 512)
        init_kaiming(self)
        if pretrained:
            load_torchvision_weights(self, "vgg16_bn" if batch_norm else "vgg16", pretrained)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Return the features of ``(B, 3, H, W)``, finest first."""
        return outputs_of(self.features, image, self._pools)

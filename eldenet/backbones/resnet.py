"""ResNet: the usual baseline encoder (ResNet18) and the paper's teacher (ResNet152)."""

import torchvision.models as zoo
from torch import Tensor

from eldenet.backbones.base import Backbone, five_stages
from eldenet.backbones.weights import load_torchvision_weights
from eldenet.system.checks import one_of

DEPTHS = (18, 34, 50, 101, 152)


class ResNet(Backbone):
    """torchvision's ResNet without its classifier.

    He et al., "Deep Residual Learning for Image Recognition" (CVPR 2016); torchvision's "v1.5" has the stride
    of a bottleneck in its 3 x 3 convolution. The modules keep torchvision's names, so its state dicts load
    unchanged.

    Features: strides 2 (before the max-pool), 4, 8, 16, 32.

    Args:
        depth: number of layers; one of 18, 34, 50, 101, 152.
        pretrained: ``True`` for torchvision's ``IMAGENET1K_V1`` weights, the name of others
            (``"IMAGENET1K_V2"``), or a local file.

    Raises:
        ValueError: a depth or weights that do not exist, or weights that do not fit.
        ConnectionError: the weights cannot be downloaded.
    """

    def __init__(self, depth: int = 18, *, pretrained: bool | str = False) -> None:
        super().__init__()
        one_of("depth", depth, DEPTHS)
        net = zoo.get_model(f"resnet{depth}", weights=None)
        self.conv1, self.bn1, self.relu, self.maxpool = net.conv1, net.bn1, net.relu, net.maxpool
        self.layer1, self.layer2, self.layer3, self.layer4 = net.layer1, net.layer2, net.layer3, net.layer4

        expansion = net.fc.in_features // 512  # 1 for basic blocks, 4 for bottlenecks
        self.feature_info = five_stages(64, *(width * expansion for width in (64, 128, 256, 512)))
        if pretrained:
            load_torchvision_weights(self, f"resnet{depth}", pretrained)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Return the features of ``(B, 3, H, W)``, finest first."""
        stride2 = self.relu(self.bn1(self.conv1(image)))
        stride4 = self.layer1(self.maxpool(stride2))
        stride8 = self.layer2(stride4)
        stride16 = self.layer3(stride8)
        stride32 = self.layer4(stride16)
        return stride2, stride4, stride8, stride16, stride32

"""The whole PP-LCNet of the paper, whose published sizes and weights include a classifier."""

from torch import Tensor, nn

from eldenet.backbones.pplcnet import PPLCNet


class PPLCNetClassifier(nn.Module):
    """``(B, 3, H, W) -> (B, 1000)`` logits. timm's weights have a bias in the head, the paper's do not."""

    def __init__(self, scale: float = 1.0, *, head_bias: bool = False) -> None:
        super().__init__()
        self.encoder = PPLCNet(scale)
        self.pool = nn.AdaptiveAvgPool2d(1)
        self.conv_head = nn.Conv2d(self.encoder.feature_info[-1].channels, 1280, 1, bias=head_bias)
        self.activation = nn.Hardswish()
        self.classifier = nn.Linear(1280, 1000)

    def forward(self, image: Tensor) -> Tensor:
        hidden = self.activation(self.conv_head(self.pool(self.encoder(image)[-1])))
        return self.classifier(hidden.flatten(1))

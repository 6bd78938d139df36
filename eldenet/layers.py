"""Layers that backbones and decoders share."""

from collections.abc import Callable

import torch
from torch import Tensor, nn


class DepthwiseConv2d(nn.Conv2d):
    """A depthwise convolution that stays in fp32 under bf16 autocast on a CPU.

    oneDNN's bf16 backward pass of strided and 5 x 5 depthwise convolutions takes five times as long as the
    fp32 one, which alone made bf16 training slower than fp32.
    """

    def forward(self, input: Tensor) -> Tensor:
        """``(B, C, H, W)`` -> the shape that :class:`torch.nn.Conv2d` gives."""
        if input.device.type == "cpu" and torch.is_autocast_enabled("cpu"):
            with torch.autocast("cpu", enabled=False):
                return super().forward(input.float())
        return super().forward(input)


class ConvNormAct(nn.Sequential):
    """Convolution without bias, batch normalization, activation.

    ``(B, in_channels, H, W) -> (B, out_channels, ceil(H / stride), ceil(W / stride))``

    Convention: zero padding of ``(kernel_size - 1) // 2`` on every side (PyTorch, Paddle). TensorFlow's
    "same" padding of a strided convolution differs by up to one pixel.

    Args:
        kernel_size: odd.
        groups: ``in_channels`` makes it depthwise.
        activation: class of the activation; ``nn.Identity`` for none.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_size: int,
        *,
        stride: int = 1,
        groups: int = 1,
        activation: Callable[[], nn.Module] = nn.ReLU,
    ) -> None:
        super().__init__()
        make = DepthwiseConv2d if groups == in_channels > 1 else nn.Conv2d
        self.conv = make(
            in_channels,
            out_channels,
            kernel_size,
            stride=stride,
            padding=(kernel_size - 1) // 2,
            groups=groups,
            bias=False,  # the normalization adds one
        )
        self.norm = nn.BatchNorm2d(out_channels)
        self.activation = activation()


class SqueezeExcite(nn.Module):
    """Squeeze and excitation: channels weighted by their global averages, ``(B, C, H, W)`` -> the same shape.

    Hu et al., "Squeeze-and-Excitation Networks" (CVPR 2018), with MobileNetV3's hard sigmoid as the gate.

    Args:
        channels: C, a multiple of 4; the squeeze keeps a fourth of them.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        # it exports as GlobalAveragePool, which every runtime has; x.mean((2, 3)) does not
        self.pool = nn.AdaptiveAvgPool2d(1)
        self.reduce = nn.Conv2d(channels, channels // 4, 1)
        self.activation = nn.ReLU()
        self.expand = nn.Conv2d(channels // 4, channels, 1)
        self.gate = nn.Hardsigmoid()

    def forward(self, x: Tensor) -> Tensor:
        """``(B, C, H, W) -> (B, C, H, W)``."""
        weights = self.activation(self.reduce(self.pool(x)))
        return x * self.gate(self.expand(weights))


class DepthwiseSeparable(nn.Sequential):
    """Depthwise k x k, optional squeeze-excitation, pointwise 1 x 1.

    ``(B, in_channels, H, W) -> (B, out_channels, ceil(H / stride), ceil(W / stride))``

    A normalization and an activation follow both convolutions, as in MobileNetV1 and PP-LCNet.

    Args:
        kernel_size: of the depthwise convolution, odd.
        squeeze_excite: apply :class:`SqueezeExcite` between the convolutions.
        shortcut: add the input to the output if their shapes are equal; the papers' networks do not.
        activation: class of both activations.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_size: int,
        *,
        stride: int = 1,
        squeeze_excite: bool = False,
        shortcut: bool = False,
        activation: Callable[[], nn.Module] = nn.ReLU,
    ) -> None:
        super().__init__()
        self.shortcut = shortcut and stride == 1 and in_channels == out_channels
        self.depthwise = ConvNormAct(
            in_channels, in_channels, kernel_size, stride=stride, groups=in_channels, activation=activation
        )
        if squeeze_excite:
            self.squeeze_excite = SqueezeExcite(in_channels)
        self.pointwise = ConvNormAct(in_channels, out_channels, 1, activation=activation)

    def forward(self, input: Tensor) -> Tensor:
        """``(B, in, H, W)`` -> ``(B, out, ceil(H / stride), ceil(W / stride))``."""
        output = super().forward(input)
        return input + output if self.shortcut else output


def init_kaiming(module: nn.Module) -> None:
    """Initialize the convolutions of ``module`` by Kaiming's normal distribution; set biases to 0.

    Convention: fan in and the gain of ReLU, as in Paddle; torchvision's networks use fan out. For a depthwise
    convolution torch ignores the groups in the fan out, which makes weights ``sqrt(channels)`` times too
    small.
    """
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight, mode="fan_in", nonlinearity="relu")
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)

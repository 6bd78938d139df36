"""The few layers that backbones and decoders share."""

from collections.abc import Callable

import torch
from torch import Tensor, nn


class DepthwiseConv2d(nn.Conv2d):
    """A depthwise convolution that stays in fp32 under a CPU's bf16 autocast.

    There is next to nothing to multiply in it, and oneDNN's bf16 backward pass of strided and 5 x 5 depthwise
    convolutions takes five times as long as the fp32 one: it alone made bf16 training slower than fp32.
    """

    def forward(self, input: Tensor) -> Tensor:
        """``(B, C, H, W) -> (B, C, ceil(H / stride), ceil(W / stride))``."""
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
        in_channels: channels in.
        out_channels: channels out.
        kernel_size: odd.
        stride: of the convolution.
        groups: ``in_channels`` makes it depthwise.
        activation: makes the activation; ``nn.Identity`` for none.
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
            bias=False,  # the normalization has one
        )
        self.norm = nn.BatchNorm2d(out_channels)
        self.activation = activation()


class SqueezeExcite(nn.Module):
    """Squeeze and excitation: channels weighed by a look at all, ``(B, C, H, W) -> (B, C, H, W)``.

    Hu et al., "Squeeze-and-Excitation Networks" (CVPR 2018), with the hard sigmoid of MobileNetV3 as the
    gate.

    Args:
        channels: C, a multiple of ``reduction``.
        reduction: C is squeezed to ``C / reduction``.
    """

    def __init__(self, channels: int, *, reduction: int = 4) -> None:
        super().__init__()
        # Pooled by a module, not by x.mean((2, 3)): it exports as GlobalAveragePool, which every runtime has.
        self.pool = nn.AdaptiveAvgPool2d(1)
        self.reduce = nn.Conv2d(channels, channels // reduction, 1)
        self.activation = nn.ReLU()
        self.expand = nn.Conv2d(channels // reduction, channels, 1)
        self.gate = nn.Hardsigmoid()

    def forward(self, x: Tensor) -> Tensor:
        """``(B, C, H, W) -> (B, C, H, W)``."""
        weights = self.activation(self.reduce(self.pool(x)))
        return x * self.gate(self.expand(weights))


class DepthwiseSeparable(nn.Sequential):
    """Depthwise k x k, optional squeeze-excitation, pointwise 1 x 1.

    ``(B, in_channels, H, W) -> (B, out_channels, ceil(H / stride), ceil(W / stride))``

    Both convolutions end in normalization and activation (MobileNetV1, PP-LCNet), and those networks have no
    shortcut.

    Args:
        in_channels: channels in.
        out_channels: channels out.
        kernel_size: of the depthwise convolution, odd.
        stride: of the depthwise convolution.
        squeeze_excite: weigh the depthwise convolution's output by :class:`SqueezeExcite`.
        shortcut: add the input to the output where both have one shape.
        activation: makes the activation of both convolutions.
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
        """The shapes are above."""
        output = super().forward(input)
        return input + output if self.shortcut else output


def init_kaiming(module: nn.Module) -> None:
    """Draw the convolutions of ``module`` from Kaiming's normal distribution; biases are 0.

    Convention: fan in and the gain of ReLU, as Paddle does; torchvision's networks take fan out. For a
    depthwise convolution torch counts the fan out without the groups, which would start it
    ``sqrt(channels)`` times too small.
    """
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight, mode="fan_in", nonlinearity="relu")
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)

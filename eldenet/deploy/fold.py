"""Fold a network for inference: the same numbers from fewer operations."""

import copy

from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from eldenet.decoders.upconv import PARITIES, UpConv2d
from eldenet.layers import DepthwiseConv2d
from eldenet.model import DepthNet

# by name, as torchvision is loaded only for networks that are made of it
RESNET_PARTS = {
    "eldenet.backbones.resnet.ResNet",
    "torchvision.models.resnet.BasicBlock",
    "torchvision.models.resnet.Bottleneck",
}
PLAIN = (nn.Conv2d, DepthwiseConv2d)  # subclasses may do more


def fold(model: DepthNet) -> DepthNet:
    """Return a copy of ``model`` for inference, in eval mode; its depth differs by rounding only.

    - Batch normalizations are folded into the convolution before them, in an ``nn.Sequential`` and in
      torchvision's ResNet blocks. Subclasses of convolutions and normalizations are left alone, because
      they may do more.
    - Every up-convolution becomes one 3x3 convolution and its activation on the small map, and a pixel
      shuffle (:func:`merge_upconv`).

    The copy cannot be trained or saved; runtimes and exports use it.
    """
    folded = copy.deepcopy(model).eval()
    for part in list(folded.modules()):
        if isinstance(part, nn.Sequential) and type(part).forward is nn.Sequential.forward:
            _fold_sequence(part)
        elif RESNET_PARTS & {f"{kind.__module__}.{kind.__qualname__}" for kind in type(part).__mro__}:
            _fold_numbered(part)
    for part in list(folded.modules()):
        for name, child in list(part.named_children()):
            if isinstance(child, UpConv2d):
                setattr(part, name, merge_upconv(child.weight, None))
    folded.network = _Unblocked(folded.network)
    return folded.requires_grad_(False)


class _Unblocked(nn.Module):
    """A network whose raw map ``(B, C, h, w)`` goes through two operations that change nothing.

    ONNX Runtime keeps channels in blocks of 16 until an operation does not support blocks. A raw map has one
    or two channels, so resizing it in blocks would take 16 or 8 times the work.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor, *focal: Tensor) -> Tensor:
        raw: Tensor = self.network(image, *focal)
        return raw.squeeze(1).unsqueeze(1) if raw.shape[1] == 1 else raw.unsqueeze(1).squeeze(1)


def _fold_numbered(part: nn.Module) -> None:
    """Fold ``bn1`` into ``conv1`` and so on, in place, as torchvision's blocks name them."""
    for number in (1, 2, 3):
        conv, norm = getattr(part, f"conv{number}", None), getattr(part, f"bn{number}", None)
        if type(conv) in PLAIN and type(norm) is nn.BatchNorm2d:
            setattr(part, f"conv{number}", fuse_conv_bn_eval(conv, norm))  # type: ignore[type-var]
            setattr(part, f"bn{number}", nn.Identity())


def _fold_sequence(sequence: nn.Sequential) -> None:
    """Fold consecutive layers of ``sequence`` in place; folded layers become identities."""
    parts = dict(sequence._modules)  # named_children() leaves out a layer that comes again
    names = [*parts, ""]
    for name, second, third in zip(names, names[1:], names[2:], strict=False):
        layer, norm = parts[name], parts[second]
        if type(norm) is not nn.BatchNorm2d or norm.running_mean is None:
            continue  # timm's contains its activation; one without statistics takes each batch's own
        if type(layer) in PLAIN:
            parts[name] = fuse_conv_bn_eval(layer, norm)  # type: ignore[type-var]
            parts[second] = nn.Identity()
        elif isinstance(layer, UpConv2d):
            scale = norm.weight / (norm.running_var + norm.eps).sqrt()  # type: ignore[operator,union-attr]
            bias = norm.bias - norm.running_mean * scale
            moves = isinstance(parts.get(third), nn.ReLU)  # beside its convolution it costs nothing
            parts[name] = merge_upconv(
                layer.weight * scale[:, None, None, None], bias, nn.ReLU(inplace=True) if moves else None
            )
            parts[second] = nn.Identity()
            if moves:
                parts[third] = nn.Identity()
    for name, part in parts.items():
        sequence._modules[name] = part


def merge_upconv(weight: Tensor, bias: Tensor | None, activation: nn.Module | None = None) -> nn.Sequential:
    """The operator of :class:`~eldenet.decoders.upconv.UpConv2d` as one 3x3 convolution and a pixel shuffle.

    The kernels 3x3, 3x2, 2x3 and 2x2 are each padded to 3x3 with zeros: 36 taps for 25, but one convolution
    with four times the channels for four small ones. On CPUs that is as fast or faster.

    Args:
        weight: ``(out, in, 5, 5)``.
        bias: ``(out,)`` or None.
    """
    out_channels, in_channels = weight.shape[:2]
    kernels = weight.new_zeros(out_channels, 4, in_channels, 3, 3)
    for number, (rows, cols, (left, _, top, _)) in enumerate(PARITIES):
        part = weight.detach()[:, :, rows, cols]
        first_row, first_col = 1 - top, 1 - left  # padded by 1 at the top or left: the kernel starts there
        kernels[
            :, number, :, first_row : first_row + part.shape[2], first_col : first_col + part.shape[3]
        ] = part
    conv = nn.Conv2d(in_channels, 4 * out_channels, 3, padding=1, bias=bias is not None)
    conv.weight = nn.Parameter(kernels.flatten(0, 1))
    if bias is not None:
        conv.bias = nn.Parameter(bias.detach().repeat_interleave(4))
    layers = [conv, nn.PixelShuffle(2)] if activation is None else [conv, activation, nn.PixelShuffle(2)]
    return nn.Sequential(*layers)

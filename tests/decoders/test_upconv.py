"""The fast up-convolution is the same operator as the slow one, at a quarter of the cost."""

import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from eldenet.decoders.upconv import UpConv2d
from eldenet.evaluation.cost import count_macs


def by_transposed_convolution(x: Tensor, weight: Tensor) -> Tensor:
    """Unpool + 5x5 convolution as the adjoint of a strided convolution with the kernel turned round.

    ``conv_transpose2d`` adds ``w[i] x[m]`` at row ``2 m + i - padding``; the convolution of the unpooled map
    reads ``w[i]`` at row ``y + i - 2``, so the kernel is flipped and one more row is asked for.
    """
    turned = weight.flip(-1, -2).transpose(0, 1)
    return F.conv_transpose2d(x, turned, stride=2, padding=2, output_padding=1)


@given(
    channels=st.tuples(st.integers(1, 3), st.integers(1, 3)),
    size=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    seed=st.integers(0, 2**31),
)
@settings(max_examples=40, deadline=None)
def test_both_forms_give_the_same_output(channels: tuple[int, int], size: tuple[int, int], seed: int) -> None:
    torch.manual_seed(seed)
    layer = UpConv2d(*channels).double()
    x = torch.randn(2, channels[0], *size, dtype=torch.float64, requires_grad=True)
    defined, fast = layer.unpooled(x), layer.interleaved(x)
    assert fast.shape == (2, channels[1], 2 * size[0], 2 * size[1])
    torch.testing.assert_close(fast, defined, atol=1e-12, rtol=1e-12)
    torch.testing.assert_close(fast, by_transposed_convolution(x, layer.weight), atol=1e-12, rtol=1e-12)
    grown = torch.randn_like(fast)
    for ours, theirs in zip(
        torch.autograd.grad(fast, (x, layer.weight), grown),
        torch.autograd.grad(defined, (x, layer.weight), grown),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs, atol=1e-11, rtol=1e-11)


def test_the_fast_form_needs_a_quarter_of_the_macs() -> None:
    slow, fast = (count_macs(UpConv2d(3, 7, fast=fast), (20, 24)) for fast in (False, True))
    assert slow == 4 * 20 * 24 * 25 * 3 * 7
    assert fast * 4 == slow


def test_the_initialization_keeps_the_variance() -> None:
    torch.manual_seed(0)
    x = torch.randn(1, 64, 32, 32)
    assert 0.8 < UpConv2d(64, 64)(x).var().item() / 2 < 1.2  # doubled, because a ReLU halves it

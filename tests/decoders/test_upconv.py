"""The fast up-convolution is the slow one: the same operator, a quarter of the work."""

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

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
def test_fast_is_the_same_operator(channels: tuple[int, int], size: tuple[int, int], seed: int) -> None:
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


def test_operator_by_explicit_loops() -> None:
    torch.manual_seed(0)
    layer = UpConv2d(1, 1).double()
    x, w = torch.randn(1, 1, 3, 4, dtype=torch.float64), layer.weight[0, 0]
    expected = torch.zeros(6, 8, dtype=torch.float64)
    for row in range(6):
        for col in range(8):
            for i in range(5):
                for j in range(5):
                    y, z = row + i - 2, col + j - 2  # the pixel of the unpooled map that tap (i, j) reads
                    if y % 2 == 0 and z % 2 == 0 and 0 <= y < 6 and 0 <= z < 8:
                        expected[row, col] += w[i, j] * x[0, 0, y // 2, z // 2]
    torch.testing.assert_close(layer(x)[0, 0], expected)


@pytest.mark.parametrize("fast", [True, False])
def test_choice_of_form(fast: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    layer, called = UpConv2d(2, 3, fast=fast), []
    for form in ("unpooled", "interleaved"):
        monkeypatch.setattr(layer, form, lambda x, form=form: called.append(form))
    layer(torch.rand(1, 2, 4, 4))
    assert called == ["interleaved" if fast else "unpooled"]


def test_fast_form_costs_a_quarter() -> None:
    class Tripled(nn.Sequential):
        """So that an image of three channels can be counted."""

    slow, fast = (count_macs(Tripled(UpConv2d(3, 7, fast=fast)), (20, 24)) for fast in (False, True))
    assert slow == 4 * 20 * 24 * 25 * 3 * 7
    assert fast * 4 == slow


def test_output_keeps_the_variance_of_its_input() -> None:
    torch.manual_seed(0)
    x = torch.randn(1, 64, 32, 32)
    assert 0.8 < UpConv2d(64, 64)(x).var().item() / 2 < 1.2  # twice, since a ReLU halves it again

"""The scale-and-shift-invariant loss ignores what a teacher of relative depth cannot know, nothing else."""

import pytest
import torch

from eldenet.losses.base import LossInputs, WeightedTerm
from eldenet.losses.scale_shift import ScaleShiftInvariantLoss


@pytest.fixture
def depth() -> torch.Tensor:
    return 1 + 4 * torch.rand(2, 1, 12, 16, generator=torch.Generator().manual_seed(0))


KNOWN = torch.ones(2, 1, 12, 16, dtype=torch.bool)


def test_scale_and_shift_of_disparity_do_not_count(depth: torch.Tensor) -> None:
    term = WeightedTerm(ScaleShiftInvariantLoss(), space="inverse")
    moved = 1 / (0.3 / depth + 0.2)
    assert term(LossInputs(moved, depth, KNOWN)) < 1e-5
    assert term(LossInputs(depth.flip(-1), depth, KNOWN)) > 0.5


def test_without_match_scale_a_factor_on_depth_alone_does_not_count(depth: torch.Tensor) -> None:
    term = WeightedTerm(ScaleShiftInvariantLoss(match_scale=False), space="log")
    assert term(LossInputs(1.7 * depth, depth, KNOWN)) < 1e-5
    assert term(LossInputs(depth**1.5, depth, KNOWN)) > 0.05


def test_it_equals_midas_formula(depth: torch.Tensor) -> None:
    other = depth.flip(-1)
    loss = ScaleShiftInvariantLoss(gradient_weight=0.0)(other, depth, KNOWN)
    expected = []
    for one, two in zip(other, depth, strict=True):
        aligned = []
        for values in (one, two):
            shifted = values - values.median()
            aligned.append(shifted / shifted.abs().mean())
        expected.append((aligned[0] - aligned[1]).abs().mean())
    torch.testing.assert_close(loss, torch.stack(expected).mean())


def test_masked_pixels_and_images_do_not_count(depth: torch.Tensor) -> None:
    loss = ScaleShiftInvariantLoss()
    mask = KNOWN.clone()
    mask[0, :, :5] = False
    junk = depth.clone()
    junk[0, :, :5] = torch.nan
    prediction = depth.flip(-1).requires_grad_()
    one, two = loss(prediction, depth, mask), loss(prediction, junk, mask)
    torch.testing.assert_close(one, two)
    two.backward()
    assert prediction.grad is not None
    assert prediction.grad.isfinite().all()
    assert (prediction.grad[0, :, :5] == 0).all()
    none = mask.clone()
    none[0] = False
    torch.testing.assert_close(loss(prediction, junk, none), loss(prediction[1:], junk[1:], none[1:]))
    assert loss(prediction, depth, torch.zeros_like(mask)) == 0

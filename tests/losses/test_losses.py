"""Losses: equal to independent formulas, unaffected by masked pixels, differentiable."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support.depth_maps import maps, patchy, value_and_gradient
from torch import Tensor

from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.losses.base import Loss, LossInputs, WeightedSum, WeightedTerm
from eldenet.losses.gradient import GradientLoss
from eldenet.losses.pointwise import BerHuLoss, L1Loss, L2Loss
from eldenet.losses.scale_shift import ScaleShiftInvariantLoss
from eldenet.losses.silog import SILogLoss
from eldenet.losses.ssim import SSIMLoss
from eldenet.train import TrainSettings

FOLDER = Path(__file__).parents[2] / "configs" / "loss"
OF_THEIR_OWN = {
    "ssim_l1_distill",  # needs a teacher: tests/training/test_distillation.py
    "ssim_nll",  # needs a spread: tests/losses/test_likelihood.py
}
NAMES = sorted({path.stem for path in FOLDER.glob("*.yaml")} - OF_THEIR_OWN)
LOSSES: dict[str, Callable[[], Loss]] = {
    "l1": L1Loss,
    "l2": L2Loss,
    "berhu": BerHuLoss,
    "silog": SILogLoss,
    "gradient": GradientLoss,
    "ssim": SSIMLoss,
    "ssim_7": lambda: SSIMLoss(window=7, value_range=4.0),
}
ANYTHING = [0.0, -3.0, 1e6, 1e30, math.nan, math.inf, -math.inf]


def from_yaml(name: str) -> WeightedSum:
    return instantiate(compose(TrainSettings, [f"loss={name}"]).loss)


# --- every loss that a YAML file names ---


SPACED = {
    space: lambda space=space: WeightedSum({"l1": WeightedTerm(L1Loss(), space=space)})
    for space in ("log", "inverse")
}


@pytest.fixture(params=[*NAMES, *SPACED], scope="module")
def total(request: pytest.FixtureRequest) -> Callable[..., Tensor]:
    loss = SPACED[request.param]() if request.param in SPACED else from_yaml(request.param)
    return lambda *maps: loss(LossInputs(*maps))[0]


def test_a_perfect_prediction_has_the_least_loss(total: Callable[..., Tensor]) -> None:
    prediction, target = maps(0)
    mask = torch.ones_like(target, dtype=torch.bool)
    at_equal, gradient = value_and_gradient(total, target, target, mask)
    assert abs(at_equal) < 1e-4
    assert torch.isfinite(gradient).all()
    assert total(prediction, target, mask) > at_equal + 0.01


@given(
    seed=st.integers(0, 2**31),
    share=st.sampled_from([0.02, 0.2, 0.7]),
    junk=st.lists(st.sampled_from(ANYTHING), min_size=2, max_size=2),
)
@settings(max_examples=25, deadline=None)
def test_masked_pixels_do_not_count(total, seed: int, share: float, junk: list[float]) -> None:
    prediction, target = maps(seed)
    mask = patchy(seed + 1, target.shape, share)
    value, gradient = value_and_gradient(total, prediction, target, mask)
    assert torch.isfinite(value)
    assert (gradient[~mask] == 0).all()
    spoiled = prediction.masked_fill(~mask, junk[0]), target.masked_fill(~mask, junk[1])
    value_again, gradient_again = value_and_gradient(total, *spoiled, mask)
    assert torch.equal(value, value_again)
    assert torch.equal(gradient, gradient_again)


def test_a_batch_without_known_pixels_gives_zero(total: Callable[..., Tensor]) -> None:
    prediction, target = maps(0)
    nothing = torch.zeros_like(target, dtype=torch.bool)
    for junk in (1.0, *ANYTHING):
        spoiled = torch.full_like(prediction, junk)
        value, gradient = value_and_gradient(total, spoiled, target, nothing)
        assert abs(value) < 1e-4
        assert (gradient == 0).all()


def test_a_single_known_pixel_gives_a_finite_loss(total: Callable[..., Tensor]) -> None:
    prediction, target = maps(0)
    mask = torch.zeros_like(target, dtype=torch.bool)
    mask[1, 0, 3, 4] = True
    value, gradient = value_and_gradient(total, prediction, target, mask)
    assert torch.isfinite(value)
    assert torch.isfinite(gradient).all()


# --- each loss against another formulation ---


def berhu(prediction: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float:
    error = np.abs(prediction - target)[mask]
    c = 0.2 * error.max()
    return float(np.where(error <= c, error, (error**2 + c**2) / (2 * c)).mean())


def silog(prediction: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float:
    g = np.log(prediction[mask]) - np.log(target[mask])
    return float(10 * np.sqrt((g**2).mean() - 0.85 * g.mean() ** 2))


def steps(prediction: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float:
    error = np.where(mask, prediction - target, np.nan)
    return float(sum(np.nanmean(np.abs(np.diff(error, axis=axis))) for axis in (-1, -2)))


REFERENCES = {
    "l1": lambda p, t, m: np.abs(p - t)[m].mean(),
    "l2": lambda p, t, m: ((p - t) ** 2)[m].mean(),
    "berhu": berhu,
    "silog": silog,
    "gradient": steps,
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", REFERENCES)
def test_the_loss_equals_its_numpy_formula(name: str, seed: int) -> None:
    prediction, target = maps(seed, dtype=torch.float64)
    mask = patchy(seed, target.shape, 0.3)
    expected = REFERENCES[name](prediction.numpy(), target.numpy(), mask.numpy())
    assert LOSSES[name]()(prediction, target, mask).item() == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", LOSSES)
def test_gradients_match_finite_differences(name: str) -> None:
    prediction, target = maps(3, size=(7, 8), batch=1, dtype=torch.float64)
    loss, mask = LOSSES[name](), patchy(4, target.shape, 0.02)
    mask[0, 0, 0, 0] = True
    # berHu's threshold follows the largest error but carries no gradient: that pixel is kept constant
    largest = torch.zeros_like(mask)
    largest[0, 0, 0, 0] = True

    def function(values: Tensor) -> Tensor:
        return loss(values.masked_fill(largest, 50.0), target, mask)

    assert torch.autograd.gradcheck(function, prediction.requires_grad_())


# --- the sum ---


def test_the_total_weighs_every_term_and_reports_it_without_the_weight() -> None:
    prediction, target = maps(11)
    mask = patchy(12, target.shape, 0.1)
    weights = {"l1": 0.3, "ssim": 2.0, "gradient": 0.0}
    loss = WeightedSum({name: WeightedTerm(LOSSES[name](), weight) for name, weight in weights.items()})
    total, terms = loss(LossInputs(prediction, target, mask))
    assert list(terms) == list(weights)
    for name, value in terms.items():
        torch.testing.assert_close(value, LOSSES[name]()(prediction, target, mask))
    torch.testing.assert_close(total, 0.3 * terms["l1"] + 2.0 * terms["ssim"])


@pytest.mark.parametrize("name", ["l1", "berhu", "gradient"])
@pytest.mark.parametrize(("space", "change"), [("log", torch.log), ("inverse", torch.reciprocal)])
def test_a_term_can_compare_logarithms_or_inverse_depth(name: str, space: str, change) -> None:
    prediction, target = maps(14)
    mask = patchy(15, target.shape, 0.2)
    value = WeightedTerm(LOSSES[name](), space=space)(LossInputs(prediction, target, mask))
    torch.testing.assert_close(value, LOSSES[name]()(change(prediction), change(target), mask))


def test_the_named_losses_hold_the_terms_of_their_papers() -> None:
    loss = from_yaml("ssim_l1")
    assert {name: term.weight for name, term in loss.terms.items()} == {"ssim": 1.0, "l1": 1.0}
    assert loss.terms["ssim"].loss.value_range == 10.0
    assert set(from_yaml("ssim_l1_gradient").terms) == {"ssim", "l1", "gradient"}
    assert from_yaml("ssim_l1_log").terms["log_l1"].space == "log"


DEPTH, KNOWN = torch.ones(2, 1, 16, 20), torch.ones(2, 1, 16, 20, dtype=torch.bool)


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (
            lambda loss: loss(LossInputs(DEPTH[:1], DEPTH, KNOWN)),
            r"prediction \(1, 1, 16, 20\), target \(2, 1, 16, 20\).*the same shape",
        ),
        (lambda loss: loss(LossInputs(DEPTH, DEPTH, KNOWN[..., :5])), "the same shape"),
        (lambda _: WeightedSum({}), "all weights of the loss are 0"),
        (lambda _: WeightedTerm(L1Loss(), space="disparity"), "space='disparity': give one of meters"),
        (lambda _: WeightedTerm(torch.nn.L1Loss()), "loss=L1Loss: derive it from eldenet.losses.base.Loss"),
        (lambda _: WeightedTerm(SILogLoss(), space="log"), "space='log' does not fit SILogLoss"),
    ],
)
def test_wrong_input_is_named(use: Callable, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        use(WeightedSum({"l1": WeightedTerm(L1Loss())}))


@pytest.mark.parametrize("make", [*LOSSES.values(), ScaleShiftInvariantLoss])
@pytest.mark.parametrize("give", [lambda depth: depth[:, 0], lambda depth: depth[:1]])
def test_a_loss_alone_refuses_maps_that_would_broadcast(make: Callable[[], Loss], give: Callable) -> None:
    """``(B, H, W)`` beside ``(B, 1, H, W)`` would compare every image with the depth of all others."""
    prediction, (target, mask) = DEPTH, map(give, (DEPTH, KNOWN))
    with pytest.raises(ValueError, match="give maps of the same shape"):
        make()(prediction, target, mask)
    with pytest.raises(ValueError, match=r"prediction \(2, 16, 20\), .*same shape \(B, 1, H, W\)"):
        make()(prediction[:, 0], DEPTH[:, 0], KNOWN[:, 0])

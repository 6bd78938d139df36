"""Measures of sigma, against answers worked out by hand and errors drawn from known distributions."""

import math
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch
from scipy import stats
from support.networks import small_net
from support.scoring import score_small

from eldenet.compose import compose
from eldenet.evaluation.calibration import fit_temperature
from eldenet.evaluation.evaluator import evaluate_batches
from eldenet.evaluation.metric_names import UNCERTAINTY_METRICS, in_range
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.uncertainty_metrics import (
    PROTOCOL,
    RELIABILITY_LEVELS,
    STEPS,
    UncertaintyMeter,
    score_image,
    sparsification,
)
from eldenet.heads import LinearHead, UncertainHead
from eldenet.train import TrainSettings
from eldenet.uncertainty import LEVELS


def values(scored) -> dict[str, float]:
    return dict(zip(UNCERTAINTY_METRICS, scored.values, strict=True))


def test_a_perfect_order_has_no_area_and_a_reversed_one_the_largest() -> None:
    error = np.arange(1.0, 201.0)  # steps of 5 % are whole numbers of pixels
    own, oracle = sparsification(error, error)
    np.testing.assert_allclose(own, oracle)
    # the mean of the n smallest of 1 ... 200 is (n + 1) / 2, that of all 100.5
    left = 200 * (1 - np.arange(STEPS) / STEPS)
    np.testing.assert_allclose(oracle[:-1], (left + 1) / 201)
    assert oracle[-1] == 0
    own, _ = sparsification(error, -error)
    np.testing.assert_allclose(own[:-1], (401 - left) / 201)  # the mean of the n largest


def test_an_order_that_knows_nothing_keeps_the_whole_error() -> None:
    rng = np.random.default_rng(0)
    error = rng.exponential(size=200_000)
    own, _ = sparsification(error, rng.random(error.size))
    np.testing.assert_allclose(own[:-1], 1, atol=0.02)


def test_ause_of_two_kinds_of_pixels_is_worked_out_by_hand() -> None:
    """Half of the pixels are exact, half have an AbsRel of 0.2; sigma takes the one half for the other."""
    truth = np.full(400, 2.0)
    depth = np.where(np.arange(400) < 200, 2.0, 2.4)
    good, bad = (np.where((np.arange(400) < 200) == first, 0.1, 0.3) for first in (True, False))
    assert values(score_image(depth, truth, good, "laplace"))["ause_abs_rel"] == pytest.approx(0)
    # removing a share f of exact pixels leaves 1 / (1 - f) of the error up to f = 0.5, then 2;
    # the oracle has 2 - 1 / (1 - f), then 0
    share = np.arange(STEPS) / STEPS
    own = np.minimum(1 / (1 - share), 2)
    oracle = np.maximum(2 - 1 / (1 - share), 0)
    found = values(score_image(depth, truth, bad, "laplace"))
    assert found["ause_abs_rel"] == pytest.approx((own - oracle).sum() / STEPS)
    assert found["abs_rel_sure80"] == pytest.approx(0.125)  # 200 of 320 pixels have 0.2
    assert values(score_image(depth, truth, good, "laplace"))["abs_rel_sure80"] == pytest.approx(0.075)


def test_sigma_ranks_rmse_in_meters_and_abs_rel_by_its_share() -> None:
    """Near pixels have the larger relative error, far ones the larger error in meters; sigma knows both."""
    truth = np.repeat([1.0, 10.0], 100)
    depth = np.repeat([1.2, 11.0], 100)
    spread = np.repeat([0.2, 0.1], 100)
    found = values(score_image(depth, truth, spread, "gaussian"))
    assert found["ause_abs_rel"] == pytest.approx(0)
    assert found["ause_rmse"] == pytest.approx(0)


@pytest.mark.parametrize("distribution", ["laplace", "gaussian"])
def test_coverage_and_likelihood_are_those_of_the_distribution(distribution: str) -> None:
    rng = np.random.default_rng(1)
    spread = rng.uniform(0.05, 0.4, 300_000)
    scale = spread / math.sqrt(2) if distribution == "laplace" else spread
    error = rng.laplace(0, scale) if distribution == "laplace" else rng.normal(0, scale)
    depth = rng.uniform(0.5, 5, spread.size)
    scored = score_image(depth, depth * np.exp(error), spread, distribution)
    found = values(scored)
    for level in LEVELS:
        assert found[f"coverage{100 * level:.0f}"] == pytest.approx(level, abs=0.005)
    np.testing.assert_allclose(scored.coverage, RELIABILITY_LEVELS, atol=0.005)
    density = stats.laplace.logpdf if distribution == "laplace" else stats.norm.logpdf
    assert found["nll"] == pytest.approx(-density(error, scale=scale).mean())


def test_means_are_over_images_and_empty_images_do_not_count() -> None:
    meter = UncertaintyMeter("laplace")
    truth = torch.full((3, 1, 4, 5), 2.0)
    depth, spread = truth * torch.tensor([1.0, 1.1, 9.0]).view(3, 1, 1, 1), torch.full_like(truth, 0.1)
    valid = torch.ones_like(truth, dtype=torch.bool)
    valid[2] = False
    meter.update(["a", "b", "c"], depth, truth, spread, valid)
    scores = meter.compute()
    assert [row[0] for row in scores.rows] == ["a", "b", "c"]
    assert math.isnan(scores.rows[2][1])
    assert scores.metrics["coverage50"] == pytest.approx(0.5)  # all of the first, none of the second
    assert scores.metrics["abs_rel_sure80"] == pytest.approx(0.05)
    assert all(in_range(name, value) for name, value in scores.metrics.items())


class Frames(list):
    """Frames with errors of one distribution, and a network that predicts 2 m with a sigma of 10 %."""

    ground_truth, names = "dense", ()


class Constant(torch.nn.Module):
    """Depth 2 m, and a spread of 0.1 times the head's temperature."""

    def __init__(self, distribution: str) -> None:
        super().__init__()
        self.head = UncertainHead(LinearHead(), distribution=distribution)

    def forward(self, image: torch.Tensor, *, with_spread: bool) -> tuple[torch.Tensor, torch.Tensor]:
        shape = (len(image), 1, 60, 80)
        return torch.full(shape, 2.0), self.head.temperature * torch.full(shape, 0.1)


@pytest.mark.parametrize("distribution", ["laplace", "gaussian"])
def test_the_temperature_corrects_a_sigma_that_is_too_small(distribution: str, monkeypatch) -> None:
    from eldenet.evaluation import calibration

    rng = np.random.default_rng(2)
    draw = (
        (lambda n: rng.laplace(0, 0.25 / math.sqrt(2), n))
        if distribution == "laplace"
        else (lambda n: rng.normal(0, 0.25, n))
    )
    depth = torch.tensor(2.0 * np.exp(draw((8, 1, 60, 80))), dtype=torch.float32)
    batch = {
        "image": torch.zeros(8, 3, 60, 80),
        "depth": depth,
        "mask": torch.ones_like(depth, dtype=torch.bool),
        "intrinsics": torch.zeros(8, 3, 3),
    }
    monkeypatch.setattr(calibration, "evaluation_loader", lambda *_: [[batch]])
    model, frames = Constant(distribution), MagicMock(stretch=None)
    frames.__len__.return_value = 8
    protocol = EvalProtocol("p", max_depth=100.0, ground_truth="dense")
    assert fit_temperature(model, frames, protocol) == pytest.approx(2.5, abs=0.05)
    assert fit_temperature(model, frames, protocol) == pytest.approx(2.5, abs=0.05)  # fitted again, it stays
    batch["mask"].zero_()
    with pytest.raises(ValueError, match="no pixel of 8 frames has a known depth that protocol p counts"):
        fit_temperature(model, frames, protocol)


def test_a_network_without_sigma_has_no_temperature() -> None:
    with pytest.raises(ValueError, match="this network predicts no sigma"):
        fit_temperature(small_net(), MagicMock(), EvalProtocol("p"))


def test_measures_compare_the_inverse_depth_where_the_metrics_do() -> None:
    model = Constant("laplace")
    model.distribution = "laplace"
    depth = torch.ones(1, 1, 60, 80)  # the network sees 2 m everywhere: half of the inverse depth
    batch = {
        "name": ["a"],
        "image": torch.zeros(1, 3, 60, 80),
        "depth": depth,
        "mask": torch.ones_like(depth, dtype=torch.bool),
        "intrinsics": torch.zeros(1, 3, 3),
    }
    loader = MagicMock()
    loader.__iter__.return_value = iter([[batch]])
    loader.dataset = MagicMock(ground_truth="raw", class_names=(), stretch=None)
    protocol = EvalProtocol("p", max_depth=100.0, ground_truth="raw", inverse_scale=3.0)
    found = evaluate_batches(model, loader, protocol).metrics
    assert found["abs_rel"] == pytest.approx(0.5)
    assert found["abs_rel_sure80"] == pytest.approx(0.5)
    assert found["nll"] == pytest.approx(math.log(2) / 0.1 * math.sqrt(2) + math.log(math.sqrt(2) * 0.1))


class Seen(Constant):
    """Depth and spread are the first two channels of the picture."""

    distribution = "gaussian"

    def forward(self, image: torch.Tensor, *, with_spread: bool) -> tuple[torch.Tensor, torch.Tensor]:
        return image[:, :1], self.head.temperature * image[:, 1:2]


@pytest.mark.parametrize("scale", ["metric", "median", "affine_depth", "affine_disparity"])
def test_a_right_sigma_stays_right_where_depth_is_aligned(scale: str, monkeypatch) -> None:
    """The truth is the network's own distribution, before a factor and shift that the alignment undoes."""
    from eldenet.evaluation import calibration

    draw = torch.Generator().manual_seed(0)
    depth, spread = (
        low + size * torch.rand(4, 1, 60, 80, generator=draw) for low, size in ((2, 6), (0.03, 0.1))
    )
    own = depth * (spread * torch.randn(depth.shape, generator=draw)).exp()
    truth = {
        "metric": own,
        "median": 3 * own,
        "affine_depth": 0.5 * own + 3,
        "affine_disparity": 1 / (0.7 / own + 0.3),
    }[scale]
    batch = {
        "name": list("abcd"),
        "image": torch.cat([depth, spread, spread], dim=1),
        "depth": truth,
        "mask": torch.ones_like(truth, dtype=torch.bool),
        "intrinsics": torch.zeros(4, 3, 3),
    }
    frames = MagicMock(ground_truth="raw", class_names=(), stretch=None)
    loader = MagicMock(dataset=frames)
    loader.__iter__.return_value = iter([[batch]])
    monkeypatch.setattr(calibration, "evaluation_loader", lambda *_: [[batch]])
    model, protocol = Seen("gaussian"), EvalProtocol("p", max_depth=100.0, scale=scale)
    found = evaluate_batches(model, loader, protocol).metrics
    for level in (50, 80, 90, 95):
        assert found[f"coverage{level}"] == pytest.approx(level / 100, abs=0.015)
    assert fit_temperature(model, frames, protocol) == pytest.approx(1.0, abs=0.03)


def test_an_image_whose_fit_has_no_factor_keeps_its_spread() -> None:
    """A single known pixel: the alignment puts the truth in its place, and no factor follows from it."""
    depth = torch.full((1, 1, 4, 4), 3.0)
    known = torch.zeros_like(depth, dtype=torch.bool)
    known[..., 1, 1] = True
    protocol = EvalProtocol("p", scale="affine_depth")
    spread = protocol.align_spread(torch.full_like(depth, 0.2), torch.full_like(depth, 2.0), depth, known)
    assert spread[known].tolist() == pytest.approx([0.2])


def test_a_run_folder_shows_the_measures(tmp_path, monkeypatch) -> None:
    from support import scoring

    words = [
        "model_name=small",
        "output=x",
        "data.size=[32,40]",
        "data.input_size=[32,40]",
        "data.frames={train:2,val:2,test:2}",
    ]
    monkeypatch.setattr(scoring, "small_net", lambda: small_net(head=UncertainHead(LinearHead())))
    record = score_small(compose(TrainSettings, words), tmp_path, "val")
    assert set(UNCERTAINTY_METRICS) < set(record["metrics"])
    assert record["uncertainty_protocol"]["name"] == PROTOCOL["name"]
    for name in ("uncertainty.csv", "sparsification.png", "reliability.png"):
        assert (tmp_path / name).stat().st_size > 100

"""A head that knows its sigma: every network takes it, depth stays, intervals follow their distribution."""

import math

import numpy as np
import pytest
import torch
from support.networks import MODELS, picture, same_model, small_net

import eldenet
from eldenet.heads import LinearHead, LogHead, UncertainHead
from eldenet.model import DepthNet
from eldenet.uncertainty import DISTRIBUTIONS, NO_SIGMA, DepthEstimate, as_estimate, deviations


def uncertain(seed: int = 0, **options) -> DepthNet:
    return small_net(seed, head=UncertainHead(LinearHead(), **options))


@pytest.mark.parametrize("name", MODELS)
def test_every_network_takes_the_head_and_keeps_its_depth(name: str) -> None:
    nets = []
    for overrides in ([], ["model/head=uncertain"]):
        torch.manual_seed(0)
        nets.append(eldenet.load(name, overrides=overrides).eval())
    plain, other = nets
    image = picture(64, 96)
    with torch.inference_mode():
        depth, estimate = plain(image), other.predict(image)
        torch.testing.assert_close(other(image), depth)  # kernels round in another way on some processors
    assert plain.predict(image).sigma is None
    assert estimate.depth.shape == estimate.sigma.shape == (1, 1, 64, 96)
    torch.testing.assert_close(estimate.depth, depth)
    spread = estimate.sigma / estimate.depth
    assert ((spread >= 0.0099) & (spread <= 1.01)).all()


def test_the_depth_may_have_any_head() -> None:
    model = eldenet.load("eldenet_s", overrides=["model/head=uncertain", "model/head@model.head.depth=log"])
    assert isinstance(model.head.depth, LogHead)
    assert (model.head.min_depth, model.head.max_depth) == (0.1, 10.0)


def test_a_saved_model_keeps_its_sigma_and_its_temperature(tmp_path) -> None:
    model = uncertain(distribution="gaussian")
    model.head.temperature.fill_(1.7)
    again = DepthNet.from_pretrained(model.save_pretrained(tmp_path))
    assert same_model(model, again)
    with torch.inference_mode():
        pair = [one.predict(picture(64, 96)).sigma for one in (model, again)]
    assert torch.equal(*pair)
    assert again.distribution == "gaussian"
    assert again.head.temperature == pytest.approx(1.7)


def test_sigma_scales_with_the_focal_length() -> None:
    model = small_net(head=UncertainHead(LinearHead()), canonical_focal=0.8, canonical_width=100)
    with torch.inference_mode():
        near, far = (model.predict(picture(64, 96), focal=focal) for focal in (40.0, 160.0))
    torch.testing.assert_close(far.depth, 4 * near.depth)
    torch.testing.assert_close(far.sigma, 4 * near.sigma)


@pytest.mark.parametrize("level", [0.5, 0.8, 0.9, 0.95])
def test_intervals_hold_their_share_of_a_distribution(level: float) -> None:
    rng = np.random.default_rng(0)
    depth, spread = np.full(200_000, 3.0), 0.2
    for name, errors in (
        ("laplace", rng.laplace(0, spread / math.sqrt(2), depth.size)),
        ("gaussian", rng.normal(0, spread, depth.size)),
    ):
        low, high = DepthEstimate(depth, spread * depth, name).interval(level)
        truth = depth * np.exp(errors)
        assert ((truth >= low) & (truth <= high)).mean() == pytest.approx(level, abs=0.004)


def test_intervals_are_those_of_tables() -> None:
    assert deviations("gaussian", 0.9) == pytest.approx(1.6449, abs=1e-4)
    assert deviations("laplace", 0.9) == pytest.approx(math.log(10) / math.sqrt(2))
    for level in (0.0, 1.0, 90):
        with pytest.raises(ValueError, match=f"level={level}: give a share between 0 and 1"):
            deviations("laplace", level)


def test_a_model_without_sigma_says_so_in_one_line() -> None:
    estimate = small_net().predict(picture(32, 32))
    assert estimate.sigma is estimate.unsure is estimate.spread is None
    with pytest.raises(ValueError, match=NO_SIGMA):
        estimate.interval(0.9)
    with pytest.raises(ValueError, match=NO_SIGMA):
        small_net()(picture(32, 32), with_spread=True)


def test_depth_alone_becomes_an_estimate_without_sigma() -> None:
    depth = np.ones((2, 3))
    assert as_estimate(depth).depth is depth
    whole = DepthEstimate(depth, 0.4 * depth, "laplace")
    assert as_estimate(whole) is whole
    assert whole.unsure.all()


def test_impossible_heads_are_refused() -> None:
    with pytest.raises(ValueError, match=f"distribution='cauchy': give one of {', '.join(DISTRIBUTIONS)}"):
        UncertainHead(LinearHead(), distribution="cauchy")
    with pytest.raises(ValueError, match="give 0 < min_spread < max_spread"):
        UncertainHead(LinearHead(), min_spread=0.5, max_spread=0.1)


def test_a_network_without_a_last_convolution_of_one_channel_is_refused() -> None:
    with pytest.raises(ValueError, match="no convolution of Conv2d has one channel"):
        DepthNet(torch.nn.Conv2d(3, 2, 1), UncertainHead(LinearHead()))

"""The likelihood that trains sigma: its values, its gradients, and what it asks of head and loss."""

import math
from itertools import pairwise

import pytest
import torch
from scipy import stats

from eldenet.losses.base import LossInputs, WeightedSum, WeightedTerm
from eldenet.losses.likelihood import LikelihoodTerm, negative_log_likelihood
from eldenet.losses.pointwise import L1Loss
from eldenet.uncertainty import NO_SIGMA


def maps(*values: float) -> list[torch.Tensor]:
    return [torch.full((1, 1, 2, 3), value) for value in values]


@pytest.mark.parametrize("error", [-0.4, 0.0, 1.3])
@pytest.mark.parametrize("spread", [0.02, 0.3])
def test_it_is_the_density_of_its_distribution(error: float, spread: float) -> None:
    found = [
        negative_log_likelihood(torch.tensor(error), torch.tensor(spread), name).item()
        for name in ("laplace", "gaussian")
    ]
    expected = stats.laplace(scale=spread / math.sqrt(2)), stats.norm(scale=spread)
    assert found == pytest.approx([-one.logpdf(error) for one in expected], rel=1e-5)


@pytest.mark.parametrize("distribution", ["laplace", "gaussian"])
def test_the_true_spread_is_the_most_likely_one(distribution: str) -> None:
    generator = torch.Generator().manual_seed(0)
    uniform = torch.rand(100_000, generator=generator).double() - 0.5
    errors = {
        "laplace": -uniform.sign() * (1 - 2 * uniform.abs()).log() * 0.2 / math.sqrt(2),
        "gaussian": torch.randn(100_000, generator=generator).double() * 0.2,
    }[distribution]
    spreads = (0.1, 0.17, 0.2, 0.23, 0.4)
    costs = [negative_log_likelihood(errors, torch.tensor(s), distribution).mean().item() for s in spreads]
    assert all(a > b for a, b in pairwise(costs[:3]))
    assert all(a < b for a, b in pairwise(costs[2:]))


@pytest.mark.parametrize("detached", [True, False])
def test_depth_learns_from_it_only_if_it_may(detached: bool) -> None:
    depth, spread = (one.requires_grad_() for one in maps(2.0, 0.1))
    (target,) = maps(3.0)
    mask = torch.ones_like(target, dtype=torch.bool)
    mask[..., 0] = False
    target[..., 0] = math.nan
    LikelihoodTerm(detach_depth=detached)(LossInputs(depth, target, mask, spread=spread)).backward()
    assert (spread.grad[mask] < 0).all()  # the error is larger than sigma says
    assert (spread.grad[~mask] == 0).all()
    assert (depth.grad is None) == detached


def test_a_sum_passes_the_spread_to_the_terms_that_need_it() -> None:
    loss = WeightedSum({"l1": WeightedTerm(L1Loss()), "nll": LikelihoodTerm(0.5)})
    depth, target, spread = maps(2.0, 3.0, 0.5)
    mask = torch.ones_like(target, dtype=torch.bool)
    total, terms = loss(LossInputs(depth, target, mask, spread=spread))
    assert loss.needs_spread
    assert total == pytest.approx(terms["l1"].item() + 0.5 * terms["nll"].item())
    with pytest.raises(ValueError, match=NO_SIGMA):
        loss(LossInputs(depth, target, mask))

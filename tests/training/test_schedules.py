"""Learning rates over time, and of the parts of a network."""

from functools import partial

import pytest
import torch

import eldenet
from eldenet.training.optim import build_optimizer, constant, cosine, epoch_decay, one_cycle


def test_the_backbone_learns_at_its_own_rate():
    model, adam = eldenet.load("eldenet_s"), partial(torch.optim.Adam, lr=1e-3)
    optimizer = build_optimizer(adam, model, torch.nn.L1Loss(), backbone_lr_factor=0.1)
    scheduler = one_cycle(optimizer, 100, 10, max_lr_factor=10.0, warmup_fraction=0.1)
    rest, backbone = optimizer.param_groups
    assert [group["lr"] for group in (rest, backbone)] == pytest.approx([1e-3, 1e-4])
    for _ in range(10):
        optimizer.step()
        scheduler.step()
    assert [group["lr"] for group in (rest, backbone)] == pytest.approx([1e-2, 1e-3])
    theirs = {id(parameter) for parameter in backbone["params"]}
    assert theirs == {id(parameter) for parameter in model.network.backbone.parameters()}
    assert len(theirs) + len(rest["params"]) == len(list(model.parameters()))
    assert len(build_optimizer(adam, model, torch.nn.L1Loss()).param_groups) == 1
    for wrong, network, message in (
        (-0.1, model, "0 \\(frozen"),
        (0.1, eldenet.load("guidedepth"), "has no separate backbone"),
    ):
        with pytest.raises(ValueError, match=message):
            build_optimizer(adam, network, torch.nn.L1Loss(), backbone_lr_factor=wrong)


def test_schedules():
    def rates(schedule, steps=10):
        optimizer = torch.optim.SGD([torch.zeros(1, requires_grad=True)], lr=1.0)
        scheduler = schedule(optimizer, steps, 5)
        values = []
        for _ in range(steps):
            values.append(scheduler.get_last_lr()[0])
            optimizer.step()
            scheduler.step()
        return values

    assert rates(constant) == [1.0] * 10
    assert rates(partial(epoch_decay, decay=0.9)) == pytest.approx([1.0] * 5 + [0.9] * 5)
    values = rates(partial(cosine, warmup_fraction=0.2, final=0.1))
    assert values[:2] == pytest.approx([1 / 3, 2 / 3])
    assert values[2] == 1.0
    assert values == sorted(values[:3]) + sorted(values[3:], reverse=True)
    assert values[-1] > 0.1
    values = rates(partial(one_cycle, max_lr_factor=10, warmup_fraction=0.2))
    assert values[:3] == pytest.approx([1.0, 5.5, 10.0])
    assert values[2:] == sorted(values[2:], reverse=True)
    assert values[-1] < 1.0

"""Settings of a trainer: early stopping, frozen parts, plateau, compile, profile, batches of one frame."""

import json
import math
from functools import partial
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import torch
from support.synthetic import SyntheticDepth
from support.training import ONE_THREAD, PROTOCOL, Stopped, digest, fit, make_trainer
from torch import nn

import eldenet
from eldenet.evaluation.metric_names import METRICS
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.losses.ssim import SSIMLoss
from eldenet.training.cuda_graph import WARM_UP, GraphedStep
from eldenet.training.optim import constant, frozen_parts, fused, plateau
from eldenet.training.profile import PARTS
from eldenet.training.trainer import Trainer, TrainingData

VALUES = [0.5, 0.7, 0.6, 0.6, 0.8, 0.6, 0.6, 0.6]  # of delta1: two worse ones, a better one, three worse ones


class Scripted(Trainer):
    """Validates to :data:`VALUES`."""

    def _validate(self):
        return dict.fromkeys(METRICS, VALUES[self.progress.epoch - 1])


@pytest.mark.slow
def test_patience_ends_a_training_and_counts_on_in_a_resumed_one(tmp_path, capsys):
    options = {"epochs": 8, "patience": 3}
    _, _, whole = fit(tmp_path / "whole", trainer=make_trainer(Scripted, **options))
    assert [row["epoch"] for row in whole.history] == list(range(1, 9))
    _, _, short = fit(tmp_path / "short", trainer=make_trainer(Scripted, **options | {"patience": 2}))
    assert (short.epoch, short.best_epoch) == (4, 2)
    assert "ends here: no better delta1 in 2 validations" in capsys.readouterr().out

    class Stopping(Scripted):
        def _end_epoch(self, epoch):
            super()._end_epoch(epoch)
            if epoch == 2:
                raise Stopped

    with pytest.raises(Stopped):
        fit(tmp_path / "part", trainer=make_trainer(Stopping, **options | {"patience": 2}))
    again = make_trainer(Scripted, **options | {"patience": 2})
    _, _, resumed = fit(tmp_path / "part", trainer=again, ckpt_path=tmp_path / "part")
    assert resumed.epoch == 4
    assert digest(tmp_path / "part") == digest(tmp_path / "short")


def test_a_plateau_halves_the_rate_after_validations_that_are_no_better(tmp_path):
    slow = partial(plateau, factor=0.5, patience=1)
    options = {"epochs": 8, "scheduler": slow, "optimizer": partial(torch.optim.SGD, lr=1e-3)}
    _, _, progress = fit(tmp_path, trainer=make_trainer(Scripted, **options))
    rates = [row["lr"] for row in progress.history]
    assert rates == pytest.approx([1e-3] * 4 + [5e-4] * 3 + [2.5e-4])  # of the epochs' training


def test_a_frozen_part_stays_as_it_is_with_its_statistics(tmp_path):
    before = {name: value.clone() for name, value in start().state_dict().items()}
    _, model, _ = fit(tmp_path, freeze=["backbone"], epochs=1)
    changed = {name for name, value in model.state_dict().items() if not torch.equal(value, before[name])}
    assert changed
    assert all(name.startswith("network.decoder") for name in changed)
    _, model, _ = fit(tmp_path / "batchnorm", freeze=["batchnorm"], epochs=1)
    changed = {name for name, value in model.state_dict().items() if not torch.equal(value, before[name])}
    norms = [name for name, part in model.named_modules() if isinstance(part, nn.BatchNorm2d)]
    assert changed
    assert not [name for name in changed if name.rpartition(".")[0] in norms]
    for names, line in (
        (["backbon"], r"freeze=backbon: this network has no such part; it has backbone, decoder"),
        (["backbone", "decoder"], "leaves nothing to learn"),
    ):
        with pytest.raises(ValueError, match=line):
            fit(tmp_path / "new", freeze=names, epochs=1)
    with pytest.raises(ValueError, match="freeze=batchnorm: this network has no such part; it has 0"):
        frozen_parts(nn.Sequential(nn.Conv2d(3, 1, 1)), ["batchnorm"])


def start() -> nn.Module:
    from eldenet.system.resources import seed_everything

    seed_everything(0)
    return eldenet.load("eldenet_s")


@pytest.mark.slow
def test_a_compiled_step_gives_the_same_losses(tmp_path, monkeypatch):
    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend="eager"))
    losses = [
        fit(tmp_path / str(on), epochs=1, loss=SSIMLoss(), compile=on)[2].history[0]["train_total"]
        for on in (False, True)
    ]
    assert losses[1] == pytest.approx(losses[0], rel=1e-5)


@pytest.mark.slow
def test_a_profile_names_the_parts_and_writes_a_trace(tmp_path, capsys):
    fit(tmp_path, epochs=3, profile=True)
    rows = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert set(PARTS) < set(rows)
    names = {event.get("name") for event in json.loads((tmp_path / "trace.json").read_text())["traceEvents"]}
    assert {"forward", "loss", "backward", "optimizer"} < names


def test_the_gradients_norm_is_logged(tmp_path):
    options = {"optimizer": partial(torch.optim.SGD, lr=1.0), "scheduler": constant}
    _, model, progress = fit(tmp_path, frames=8, epochs=1, accumulate_grad_batches=2, **options)
    first, last = dict(start().named_parameters()), dict(model.named_parameters())
    moved = torch.cat([(last[name] - first[name]).flatten() for name in last]).norm()
    assert progress.step == 1
    assert progress.history[0]["train_grad_norm"] == pytest.approx(float(moved.detach()), rel=1e-3)


def test_batches_of_an_update_are_added_up_without_talking_to_other_processes(tmp_path):
    silent = []

    class Counting(Trainer):
        def train_step(self, batch, *, update):
            entered = []
            original = self.accelerator.no_sync
            self.accelerator.no_sync = lambda model: entered.append(model) or original(model)
            try:
                return super().train_step(batch, update=update)
            finally:
                self.accelerator.no_sync = original
                silent.append((bool(entered), update))

    fit(tmp_path, trainer=make_trainer(Counting, epochs=1, accumulate_grad_batches=2))
    assert silent == [(True, False), (False, True)] * 2


class OneValue(nn.Module):
    """A network whose BatchNorm sees one value per channel and image."""

    def __init__(self):
        super().__init__()
        self.norm, self.last = nn.BatchNorm2d(3), nn.Conv2d(3, 1, 1)

    def forward(self, image):
        return self.last(image + self.norm(image.mean((2, 3), keepdim=True)))


@pytest.mark.parametrize(("frames", "batch_size"), [(13, 1), (5, 2), (1, 4)])
def test_a_batch_of_one_frame_that_batchnorm_cannot_take(tmp_path: Path, frames, batch_size):
    loss = WeightedSum({"l1": WeightedTerm(L1Loss())})
    model = eldenet.DepthNet(OneValue(), eldenet.heads.LinearHead())
    data = TrainingData(SyntheticDepth(frames), SyntheticDepth(2), PROTOCOL)
    with pytest.raises(ValueError, match=rf"of {frames}, .*: give another trainer\.batch_size, more frames"):
        make_trainer(batch_size=batch_size).fit(model, loss, data, tmp_path, ONE_THREAD)


def test_a_batch_of_one_frame_trains_where_it_can(tmp_path):
    _, _, progress = fit(tmp_path, frames=5, batch_size=2, epochs=1)
    assert math.isfinite(progress.history[0]["train_total"])


def test_optimizers_that_have_one_kernel_for_all_weights_take_it():
    weights = [torch.zeros(3, requires_grad=True)]
    assert fused(partial(torch.optim.Adam, lr=1e-3))(weights).defaults["fused"] is True
    assert fused(partial(torch.optim.Adam, lr=1e-3, foreach=True))(weights).defaults["fused"] is None
    assert "fused" not in fused(partial(torch.optim.Rprop, lr=1e-3))(weights).defaults


@pytest.mark.skipif(torch.cuda.is_available(), reason="it has one")
def test_a_cuda_graph_needs_a_gpu_and_whole_updates(tmp_path):
    with pytest.raises(ValueError, match=r"cuda_graph=true is for one GPU in bf16 or fp32"):
        fit(tmp_path, cuda_graph=True)
    with pytest.raises(ValueError, match="needs accumulate_grad_batches=1 and profile=false"):
        make_trainer(cuda_graph=True, profile=True)


def test_a_network_that_lies_on_a_gpu_is_tried_there_on_a_batch_of_one():
    """The meta device stands for a GPU; ``adapt`` trains a network that has predicted there."""
    trainer = make_trainer()
    trainer.train_set = SyntheticDepth(1)
    trainer._refuse_batch_of_one(eldenet.load("eldenet_s").to("meta"))


class FakeGraph:
    """Stands for a CUDA graph: a replay computes on the captured tensors again."""

    replays = 0

    def replay(self):
        FakeGraph.replays += 1
        _, batch, terms = next(one for one in self.graphed.captured.values() if one.graph is self)
        terms["total"].copy_(batch["image"].sum())


def test_a_graphed_step_replays_at_each_shape_that_came_a_few_times(monkeypatch):
    stream = MagicMock()
    for name in ("Stream", "stream", "current_stream", "graph", "graph_pool_handle"):
        monkeypatch.setattr(torch.cuda, name, MagicMock(return_value=stream))
    monkeypatch.setattr(torch.cuda, "CUDAGraph", FakeGraph)
    seen = []

    def step(batch):
        seen.append(optimizer.param_groups[0]["capturable"])
        return {"total": batch["image"].sum()}

    weight = torch.zeros(3, requires_grad=True)
    optimizer = torch.optim.Adam([weight], lr=0.5, fused=True)
    graphed = GraphedStep(step, optimizer)
    FakeGraph.graphed = graphed
    for value in range(WARM_UP + 3):
        for rows in (2, 5):
            terms = graphed({"image": torch.full((rows, 2), float(value)), "name": ["a"]})
            assert terms["total"] == 2 * rows * value
    assert (seen, FakeGraph.replays) == ([*2 * WARM_UP * [False], True, True], 6)
    assert graphed({"image": torch.ones(1, 2), "name": ["a"]})["total"] == 2  # seldom: no graph
    assert (seen[-1], FakeGraph.replays) == (False, 6)
    rates = constant(optimizer, 10, 5)  # a schedule writes into the tensor that the graph reads
    kept = optimizer.param_groups[0]["lr"]
    rates.step()
    assert optimizer.param_groups[0]["lr"] is kept
    with pytest.raises(ValueError, match="needs a fused optimizer"):
        GraphedStep(step, torch.optim.Adam([weight], lr=0.5))

"""Training learns, keeps its best epoch, stops on NaN, and writes what it promises."""

import time
from functools import partial

import pytest
import torch
from support.synthetic import SyntheticDepth
from support.training import PROTOCOL, Stopped, fit, make_trainer

import eldenet
from eldenet.evaluation.evaluator import evaluate, picture_of_samples
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.results.run_log import RunLog
from eldenet.system.resources import Resources, seed_everything
from eldenet.training.checkpoint import load_checkpoint
from eldenet.training.loss_meter import READ_EVERY, LossMeter
from eldenet.training.optim import constant
from eldenet.training.trainer import Trainer, TrainingData, squared_error


def test_training_learns_one_batch_by_heart(tmp_path):
    _, model, progress = fit(tmp_path, frames=4, epochs=60, transform=None, evaluate_every=60)
    first, last = progress.history[0]["train_total"], progress.history[-1]["train_total"]
    assert last < 0.25 * first
    assert evaluate(model, SyntheticDepth(4), PROTOCOL).metrics["delta1"] > 0.6


def test_the_squared_error_of_the_training_is_in_meters_and_of_metric_depth_alone():
    prediction, depth = torch.tensor([[2.0], [5.0], [9.0]]).view(3, 1, 1, 1), torch.ones(3, 1, 1, 1)
    batch = {"depth": depth, "mask": torch.tensor([True, True, False]).view(3, 1, 1, 1)}
    assert squared_error(prediction, batch) == (1 + 16) / 2
    assert squared_error(prediction, batch | {"relative": torch.tensor([False, True, False])}) == 1


def test_the_best_epoch_is_one_epoch_by_one_metric(tmp_path):
    _, _, progress = fit(tmp_path, epochs=4, monitor="abs_rel")
    values = [row["val_abs_rel"] for row in progress.history]
    assert progress.best_value == min(values)
    assert progress.best_epoch == 1 + values.index(min(values))
    best = evaluate(eldenet.load(tmp_path), SyntheticDepth(6), PROTOCOL).metrics["abs_rel"]
    assert best == pytest.approx(min(values), rel=1e-6)


class PoisonedLoss(L1Loss):
    calls = 0

    def forward(self, prediction, target, mask):
        PoisonedLoss.calls += 1
        value = super().forward(prediction, target, mask)
        return value * float("nan") if PoisonedLoss.calls == 7 else value


def test_a_nan_loss_stops_with_its_step_and_keeps_the_last_good_checkpoint(tmp_path):
    PoisonedLoss.calls = 0
    with pytest.raises(FloatingPointError, match=r"'total' is nan at step 6.*last\.pt"):
        fit(tmp_path, epochs=3, checkpoint_every=1, loss=PoisonedLoss())
    state = load_checkpoint(tmp_path)
    assert state["progress"]["step"] == 6
    assert all(torch.isfinite(value).all() for value in state["model"].values())


def test_a_meter_of_an_accelerator_looks_now_and_then_and_loses_nothing():
    eager, patient = ({}, {})
    meters = [LossMeter(eager, eager=True), LossMeter(patient, eager=False)]
    steps = 2 * READ_EVERY + 3  # the second look takes what was sent at the first
    for step in range(steps):
        for meter in meters:
            meter.add(step, {"total": torch.tensor(float(step))})
    assert patient["total"] == sum(range(READ_EVERY))
    assert meters[1].unread == READ_EVERY + 3
    assert eager["total"] == sum(range(steps))
    meters[1].read()  # as before every checkpoint
    assert patient == eager
    meters[1].add(20, {"total": torch.tensor(1.0)})
    meters[1].add(21, {"total": torch.tensor(float("inf"))})
    with pytest.raises(FloatingPointError, match="'total' is inf at step 21"):
        meters[1].read()


def test_weights_that_are_not_finite_replace_no_checkpoint(tmp_path):
    trainer, model, _ = fit(tmp_path, epochs=1)
    before = (tmp_path / "checkpoints" / "last.pt").read_bytes()
    with torch.no_grad():
        next(model.parameters()).fill_(float("nan"))
    with pytest.raises(FloatingPointError, match="weights are not finite at step 4"):
        trainer.state.save(tmp_path / "checkpoints" / "last.pt")
    assert (tmp_path / "checkpoints" / "last.pt").read_bytes() == before


def test_weights_that_the_last_update_breaks_are_a_divergence(tmp_path):
    """Not an odd prediction: a search for a learning rate goes on after the one."""

    class Breaking(Trainer):
        def train_step(self, batch, *, update):
            terms = super().train_step(batch, update=update)
            with torch.no_grad():
                next(self.bare_model.parameters()).fill_(float("nan"))
            return terms

    breaking = make_trainer(Breaking, epochs=1, batch_size=16)
    with pytest.raises(FloatingPointError, match="weights are not finite at step 1"):
        fit(tmp_path, trainer=breaking)


@pytest.mark.parametrize("clip", [None, 1e-4])
def test_the_gradients_norm_is_clipped(tmp_path, clip):
    seed_everything(0)
    start = {name: value.clone() for name, value in eldenet.load("eldenet_s").named_parameters()}
    plain = partial(torch.optim.SGD, lr=1.0)  # so that a step is the gradient
    options = {"optimizer": plain, "scheduler": constant, "max_grad_norm": clip}
    _, model, progress = fit(tmp_path, frames=4, epochs=1, **options)
    assert progress.step == 1
    moved = torch.cat([(value - start[name]).flatten() for name, value in model.named_parameters()])
    assert (moved.norm() < 1.01e-4) == (clip == 1e-4)


@pytest.mark.parametrize("name", ["epochs", "checkpoint_every", "evaluate_every", "max_grad_norm"])
def test_settings_that_make_no_sense_are_refused(name):
    with pytest.raises(ValueError, match=f"{name}=0"):
        make_trainer(**{name: 0})


def test_an_epochs_last_update_averages_the_batches_it_has(tmp_path):
    options = {"epochs": 1, "optimizer": partial(torch.optim.SGD, lr=1e-2), "scheduler": constant}
    whole, cut = (  # an epoch has four batches
        fit(tmp_path / str(batches), accumulate_grad_batches=batches, **options)[1].state_dict()
        for batches in (4, 8)
    )
    assert all(torch.equal(whole[name], cut[name]) for name in whole)


@pytest.mark.parametrize("options", [{}, {"ema_decay": 0.9}])
def test_validation_is_in_fp32_whatever_the_training(tmp_path, options):
    seed_everything(0)
    model, data = eldenet.load("eldenet_s").train(), SyntheticDepth(6)
    loss = WeightedSum({"l1": WeightedTerm(L1Loss())})
    resources = Resources(device="cpu", precision="bf16", threads=1, workers=0, cores=2)
    seen = set()
    model.network.register_forward_hook(lambda part, args, raw: seen.add((part.training, raw.dtype)))
    trainer = make_trainer(epochs=1, monitor="abs_rel", **options)
    progress = trainer.fit(model, loss, TrainingData(SyntheticDepth(8), data, PROTOCOL), tmp_path, resources)
    assert (True, torch.bfloat16) in seen
    saved = evaluate(eldenet.load(tmp_path), data, PROTOCOL).metrics["abs_rel"]
    assert progress.best_value == pytest.approx(saved, rel=1e-6)


def test_tensorboard_keeps_every_epoch(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    class StoppingTrainer(Trainer):
        def _end_epoch(self, epoch):
            super()._end_epoch(epoch)
            raise Stopped

    with pytest.raises(Stopped):
        fit(tmp_path, trainer=make_trainer(StoppingTrainer))
    time.sleep(1.1)  # tensorboard orders its files by the second they were begun in, then by a number as text
    _, model, _ = fit(tmp_path, ckpt_path=tmp_path)
    log = RunLog(tmp_path)  # as the command does, once training is over
    log.picture("predictions", 8, picture_of_samples(model, SyntheticDepth(2), PROTOCOL))
    log.close()
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [point.step for point in events.Scalars("val/delta1")] == [4, 8]

"""A stopped or killed training goes on to the very same weights, or is refused in a clear line."""

import math
import random
import signal
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import pytest
import torch
from support.synthetic import SyntheticDepth
from support.training import ONE_THREAD, Stopped, digest, fit, make_trainer, stopping_at

from eldenet.compose import compose
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.losses.pointwise import L1Loss
from eldenet.system.files import write_json, write_yaml
from eldenet.train import TrainSettings, train
from eldenet.training.checkpoint import Progress, TrainingState, load_checkpoint, save_checkpoint
from eldenet.training.optim import cosine


class NoisyLoss(L1Loss):
    """Draws from torch's generator, as dropout does."""

    def forward(self, prediction, target, mask):
        return super().forward(prediction, target, mask) * (0.5 + torch.rand(()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "loss"),
    [
        ({}, L1Loss),
        ({"ema_decay": 0.9}, NoisyLoss),
        ({"accumulate_grad_batches": 2, "max_grad_norm": 1.0}, L1Loss),
        ({"accumulate_grad_batches": 3, "evaluate_every": 2}, L1Loss),
    ],
)
def test_a_training_stopped_at_any_step_resumes_to_the_same_weights(tmp_path, options, loss):
    fit(tmp_path / "whole", epochs=3, checkpoint_every=1, loss=loss(), **options)

    settings = {"epochs": 3, "checkpoint_every": 1} | options
    in_the_second_epoch = make_trainer(stopping_at(7), **settings)
    with pytest.raises(Stopped):
        fit(tmp_path / "part", trainer=in_the_second_epoch, loss=loss())
    assert load_checkpoint(tmp_path / "part")["progress"]["epoch"] == 1
    fit(tmp_path / "part", trainer=make_trainer(**settings), ckpt_path=tmp_path / "part", loss=loss())
    assert digest(tmp_path / "part") == digest(tmp_path / "whole")
    # into another folder: the best epoch so far comes along
    fit(tmp_path / "other", trainer=make_trainer(**settings), ckpt_path=tmp_path / "part", loss=loss())
    assert digest(tmp_path / "other") == digest(tmp_path / "whole")


TINY = (
    *("data=rooms", "model=eldenet_s", "data.size=[32,40]", "data.input_size=[32,40]"),
    *("data.frames={train: 32, val: 8, test: 8}", "trainer.epochs=3", "trainer.batch_size=4"),
    *("trainer.checkpoint_every=1", "runtime.threads=1", "runtime.workers=2"),
)


@pytest.mark.slow
def test_sigkill_at_random_steps_with_workers_and_augmentation(tmp_path, command_server):
    whole = command_server.run("eldenet.train", (*TINY, "output=whole"), tmp_path)
    assert whole.returncode == 0, whole.stderr
    generator = random.Random(0)
    kills = 0
    for _attempt in range(5):
        killed = command_server.run(
            "eldenet.train",
            (*TINY, "output=killed", "ckpt_path=auto"),
            tmp_path,
            interrupt_at="killed/checkpoints/last.pt" if kills < 2 else None,  # once it has made progress
            number=signal.SIGKILL,
            delay=generator.uniform(0.0, 0.5),
        )
        if killed.returncode == 0:
            break
        assert killed.returncode == -signal.SIGKILL, killed.stderr
        kills += 1
    assert kills >= 1, "the training ended before it could be killed once"
    assert digest(tmp_path / "killed") == digest(tmp_path / "whole")
    ends = [load_checkpoint(tmp_path / name)["model"] for name in ("killed", "whole")]
    assert all(torch.equal(ends[0][key], ends[1][key]) for key in ends[0])


def test_resuming_another_training_is_refused(tmp_path):
    fit(tmp_path, epochs=1)
    for options, name in (
        ({"batch_size": 8}, ""),
        # the checkpoint's own learning rate would win without a word
        ({"optimizer": partial(torch.optim.Adam, lr=1e-5)}, "optimizer"),
        ({"scheduler": partial(cosine, final=0.5)}, "scheduler"),
        ({"ema_decay": 0.9}, "ema_decay"),
        # values of another metric, or of other frames, would be compared with the best so far
        ({"monitor": "abs_rel"}, "monitor"),
        ({"val_frames": 5}, "validation split"),
        ({"protocol": EvalProtocol("other", min_depth=0.1, ground_truth="dense")}, "protocol"),
        # what "auto" is on another machine, and weights that were trained anew at the same place
        ({"resources": replace(ONE_THREAD, precision="bf16")}, "precision"),
        ({"sources": {"weights": "0" * 16}}, "sources"),
    ):
        with pytest.raises(ValueError, match=f"belongs to another training: {name}"):
            fit(tmp_path / "new", epochs=1, ckpt_path=tmp_path, **options)


@pytest.mark.parametrize(
    ("given", "output"),
    [
        ("auto", "begun"),
        ("begun", "begun"),
        ("begun/checkpoints/last.pt", "begun"),
        ("begun", "other"),
        ("begun/checkpoints/last.pt", "other"),
    ],
)
def test_a_run_goes_on_with_its_settings_alone(tmp_path, monkeypatch, given, output):
    monkeypatch.chdir(tmp_path)
    begun = compose(TrainSettings, ["model_name=small", "output=begun", "loss.terms.l1.weight=7"])
    Path("begun/checkpoints").mkdir(parents=True)
    write_yaml(Path("begun/config.yaml"), asdict(begun))
    save_checkpoint(Path("begun/checkpoints/last.pt"), {"progress": {}})
    other = compose(TrainSettings, ["model_name=small", f"output={output}", f"ckpt_path={given}"])
    advice = "give another folder" if output == "begun" else r"or start from its weights=.*begun"
    with pytest.raises(
        ValueError, match=rf"other settings: loss\.terms\.l1\.weight=.* \(there 7\).*{advice}"
    ):
        train(other)


def test_a_finished_run_without_a_best_value_and_an_evaluation(tmp_path, monkeypatch):
    config = compose(TrainSettings, ["model_name=small", f"output={tmp_path}", "ckpt_path=auto"])
    record = {"metrics": {}, "config": asdict(config), "training": None}
    write_json(tmp_path / "run.json", record)
    with pytest.raises(ValueError, match=r"holds an evaluation.*give another folder"):
        train(config)
    write_json(tmp_path / "run.json", record | {"training": {"best_value": math.nan}})
    monkeypatch.setattr("eldenet.evaluation.splits.open_split", lambda *_, **__: SyntheticDepth(2))
    assert math.isnan(train(config))


def test_a_checkpoint_without_its_best_epoch_is_refused(tmp_path):
    fit(tmp_path / "run", epochs=1)
    (tmp_path / "alone").mkdir()
    (tmp_path / "run" / "checkpoints" / "last.pt").rename(tmp_path / "alone" / "last.pt")
    with pytest.raises(FileNotFoundError, match="best epoch so far is 1"):
        fit(tmp_path / "new", epochs=1, ckpt_path=tmp_path / "alone" / "last.pt")


def test_the_devices_generator_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: False)  # a test on a GPU may have come before
    fit(tmp_path / "cpu", epochs=1)
    set_to = []
    monkeypatch.setattr(torch.cuda, "set_rng_state", set_to.append)
    assert load_checkpoint(tmp_path / "cpu")["cuda_rng"] is None

    def state(drawn: int) -> TrainingState:
        monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
        monkeypatch.setattr(torch.cuda, "get_rng_state", lambda: torch.tensor([drawn], dtype=torch.uint8))
        model = torch.nn.Linear(2, 2)
        optimizer = torch.optim.SGD(model.parameters(), lr=0.1)
        scheduler = torch.optim.lr_scheduler.ConstantLR(optimizer)
        identity = {"threads": 1}
        return TrainingState(model, None, optimizer, scheduler, L1Loss(), None, Progress(), identity)

    state(7).save(tmp_path / "last.pt")
    state(3).restore(tmp_path / "last.pt", epochs=1, batches=1)
    assert [value.item() for value in set_to] == [7]


def test_damaged_and_foreign_checkpoints_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no checkpoint at"):
        load_checkpoint(tmp_path / "none.pt")
    save_checkpoint(tmp_path / "foreign.pt", {"weights": torch.zeros(2)})
    with pytest.raises(ValueError, match="not a training checkpoint"):
        load_checkpoint(tmp_path / "foreign.pt")
    whole = (tmp_path / "foreign.pt").read_bytes()
    (tmp_path / "cut.pt").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"cut\.pt is truncated or not a valid"):
        load_checkpoint(tmp_path / "cut.pt")

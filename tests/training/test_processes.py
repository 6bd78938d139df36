"""Several processes: they train to the weights of one with their batches together, and prepare data once."""

import json
import os
import signal
import sys
from functools import partial
from pathlib import Path

import pytest
import torch
from support.ranks import start_ranks
from support.synthetic import SyntheticDepth
from support.training import fit, make_trainer

import eldenet
from eldenet.data.transforms import Augmentation
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.distillation import DistilledTerm, Teacher
from eldenet.losses.pointwise import L1Loss
from eldenet.results.fingerprints import differences
from eldenet.system.resources import Resources, seed_everything
from eldenet.training import trainer as trainer_module
from eldenet.training.checkpoint import load_checkpoint
from eldenet.training.optim import constant
from eldenet.training.trainer import Trainer, TrainingData, synchronize_batchnorm

FRAMES, TOGETHER = 24, 8


class FrozenStatistics(Trainer):
    """Trains with BatchNorm in eval mode: a batch's statistics are what processes do not share."""

    def train_step(self, batch, *, update):
        self.model.eval()
        return super().train_step(batch, update=update)


def with_statistics(name: str, seed: int) -> torch.nn.Module:
    """A new network whose BatchNorm has seen the data: in eval mode its features are neither 0 nor huge."""
    seed_everything(seed)
    model = eldenet.load(name).train()
    images = torch.stack([sample["image"] for sample in map(SyntheticDepth(8).__getitem__, range(8))])
    layers = [layer for layer in model.modules() if isinstance(layer, torch.nn.BatchNorm2d)]
    usual = layers[0].momentum
    for layer in layers:
        layer.momentum = 1.0  # one pass is enough
    with torch.no_grad():
        model(images)
    for layer in layers:
        layer.momentum = usual
    return model


def train(folder: Path, processes: int, *, ckpt_path: Path | None = None) -> Trainer:
    """Two epochs with ``TOGETHER`` images per update, dealt out to the processes; features are distilled."""
    torch.set_num_threads(1)
    teacher, model = Teacher(with_statistics("eldenet", seed=0)), with_statistics("eldenet_s", seed=1)
    distilled = DistilledTerm(L1Loss(), teacher, weight=0.1, feature_weight=1.0, feature_strides=(16,))
    trainer = FrozenStatistics(
        optimizer=partial(torch.optim.SGD, lr=3e-4),
        scheduler=constant,
        epochs=2,
        batch_size=TOGETHER // processes // 2,
        accumulate_grad_batches=2,
    )
    trainer.fit(
        model,
        WeightedSum({"l1": WeightedTerm(L1Loss()), "distilled": distilled}),
        TrainingData(
            SyntheticDepth(FRAMES, transform=Augmentation(affine=0.0)),  # every pixel known: equal shares
            SyntheticDepth(5),
            EvalProtocol("synthetic", min_depth=0.1, ground_truth="dense"),
        ),
        folder,
        Resources(device="cpu", precision="fp32", threads=1, workers=0, cores=2),
        ckpt_path=ckpt_path,
    )
    trainer.accelerator.wait_for_everyone()
    return trainer


def largest_difference(one: Path, two: Path, group: str) -> float:
    """Of a weight; BatchNorm's running statistics apart."""
    first, second = (load_checkpoint(folder)[group] for folder in (one, two))
    assert first.keys() == second.keys()
    first = {name: value for name, value in first.items() if "running_" not in name}
    assert first
    return max(float((first[name].double() - second[name].double()).abs().max()) for name in first)


@pytest.mark.slow
def test_two_processes_train_to_the_weights_of_one(tmp_path, command_server):
    """BatchNorm's own statistics, which processes do not share, are left as they are."""
    for rank in command_server.run_ranks(__file__, [str(tmp_path / "two")], tmp_path):
        assert rank.returncode == 0, rank.stderr[-3000:]
    train(tmp_path / "one", 1)
    for group in ("model", "loss"):
        # rounding alone: two threads, or kernels without oneDNN, move a weight by 7e-5
        assert largest_difference(tmp_path / "one", tmp_path / "two", group) < 2e-4
    start = with_statistics("eldenet_s", seed=1).state_dict()  # it did train
    trained = load_checkpoint(tmp_path / "one")["model"]
    assert max(float((trained[name] - start[name]).abs().max()) for name in start) > 4e-3
    # the validation counted each of the five frames once
    progress = [load_checkpoint(tmp_path / name)["progress"] for name in ("one", "two")]
    for one, two in zip(*(entry["history"] for entry in progress), strict=True):
        assert one["val_rmse"] == pytest.approx(two["val_rmse"], rel=1e-3)
        assert one["train_total"] == pytest.approx(two["train_total"], rel=1e-3)  # the mean of both shares
    # a run of two processes is another one than that of one
    with pytest.raises(ValueError, match=r"belongs to another training: processes=1 \(there 2\)"):
        train(tmp_path / "more", 1, ckpt_path=tmp_path / "two")


@pytest.mark.parametrize("hit", [0, 1])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_ends_where_another_one_is_gone_or_hangs(
    tmp_path: Path, number: signal.Signals, hit: int
) -> None:
    """Without a launcher, which would end it too: as on two machines. Process 0 keeps the group's store."""
    ranks = start_ranks(tmp_path, seconds=5.0, waiting=hit)
    try:
        for rank in ranks:
            assert rank.pipe.poll(60)
            assert rank.pipe.recv() == rank.process.pid
        os.kill(ranks[hit].process.pid, number)
        ranks[1 - hit].process.join(60)
    finally:
        for rank in ranks:
            rank.process.kill()
    assert ranks[1 - hit].process.exitcode == 1
    assert "RuntimeError" in ranks[1 - hit].errors.read_text()


def test_sync_batchnorm_converts_every_layer_on_gpus_alone() -> None:
    model = eldenet.load("eldenet_s")
    before = model.state_dict()
    layers = [name for name, layer in model.named_modules() if isinstance(layer, torch.nn.BatchNorm2d)]
    with pytest.raises(
        ValueError, match=r"^trainer\.sync_batchnorm=true needs GPUs: on CPUs set it to false$"
    ):
        synchronize_batchnorm(model, torch.device("cpu"))
    assert [
        name for name, layer in model.named_modules() if isinstance(layer, torch.nn.BatchNorm2d)
    ] == layers
    synchronize_batchnorm(model, torch.device("cuda"))
    layer_type = torch.nn.SyncBatchNorm
    assert [name for name, layer in model.named_modules() if isinstance(layer, layer_type)] == layers
    assert all(
        torch.equal(value, before[name]) for name, value in model.state_dict().items()
    )  # files stay the same
    assert layers


def test_a_trainer_of_several_processes_asks_for_gpus(tmp_path: Path, monkeypatch) -> None:
    """The setting is for several processes: alone, a batch is all there is."""
    fit(tmp_path / "alone", trainer=make_trainer(sync_batchnorm=True, epochs=1))
    make = trainer_module.make_accelerator

    def two(resources):
        made = make(resources)
        monkeypatch.setattr(type(made), "num_processes", 2)
        return made

    monkeypatch.setattr(trainer_module, "make_accelerator", two)
    with pytest.raises(ValueError, match=r"trainer\.sync_batchnorm=true needs GPUs"):
        fit(tmp_path / "two", trainer=make_trainer(sync_batchnorm=True, epochs=1))


def test_missing_rooms_are_rendered_by_one_process(tmp_path, command_server):
    script = tmp_path / "ranks.py"
    script.write_text(
        "import json, os, sys, time\n"
        "from pathlib import Path\n"
        "from eldenet.system.resources import Resources, main_process_first\n"
        "folder, rank = Path(sys.argv[1]), os.environ['RANK']\n"
        "with main_process_first(Resources('cpu', 'fp32', 1, 0, 1)):\n"
        "    (folder / rank).write_text(json.dumps(sorted(path.name for path in folder.glob('[01]'))))\n"
        "    time.sleep(1.0 if rank == '0' else 0.0)\n"
        "    (folder / f'done-{rank}').touch()\n"
        "    assert (folder / 'done-0').exists()\n"
        "from accelerate import PartialState\n"
        "PartialState().destroy_process_group()\n"
    )
    for rank in command_server.run_ranks(str(script), [str(tmp_path)], tmp_path):
        assert rank.returncode == 0, rank.stderr[-3000:]
    assert json.loads((tmp_path / "0").read_text()) == []
    assert json.loads((tmp_path / "1").read_text()) == ["0"]


def test_settings_that_tell_two_runs_apart():
    ours = {
        "run_dir": "a",
        "seed": 0,
        "data": {"name": "x", "root": "/here", "cache": False, "subset": {"train": None}},
        "augmentation": {"_target_": "A", "flip": 0.5, "new_option": 1},
        "loss": {"_target_": "Sum", "terms": {"l1": {"_target_": "Term", "weight": 1.0}}},
    }
    theirs = json.loads(json.dumps(ours)) | {"run_dir": "b"}
    theirs["data"] |= {"root": "/there", "cache": "ram"}
    del theirs["augmentation"]["new_option"]  # the class had none then
    assert differences(ours, theirs) == []
    theirs["loss"]["terms"]["ssim"] = {"_target_": "Term", "weight": 1.0}
    assert [text.partition("=")[0] for text in differences(ours, theirs)] == ["loss.terms.ssim"]
    assert differences(ours | {"augmentation": None}, ours)
    assert differences(ours | {"augmentation": {}}, ours)
    assert differences(ours | {"seed": 1}, ours) == ["seed=1 (there 0)"]
    adam = {"optimizer": {"_target_": "torch.optim.Adam", "lr": 1e-3}}
    asked = {"optimizer": adam["optimizer"] | {"amsgrad": False}}  # torch's default: so the run was made
    assert differences(asked, adam) == []
    asked["optimizer"]["amsgrad"] = True
    assert differences(asked, adam) == ["optimizer.amsgrad=True (there False)"]


if __name__ == "__main__":  # one of the two processes
    train(Path(sys.argv[1]), 2).accelerator.end_training()

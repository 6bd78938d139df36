"""Training learns, resumes to the very same weights, stops on NaN, and counts every image once."""

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
import torch
from synthetic import SyntheticDepth

import eldenet
from eldenet.checkpoint import load_checkpoint, save_checkpoint
from eldenet.data.transforms import Augmentation
from eldenet.evaluation import ConstantPredictor, evaluate, fit_constant_predictor
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.metrics import EvalProtocol
from eldenet.resources import Resources, seed_everything
from eldenet.schedules import build_optimizer, constant, cosine, epoch_decay, one_cycle
from eldenet.trainer import Trainer

PROTOCOL = EvalProtocol("synthetic", min_depth=0.1, ground_truth="dense")
ONE_THREAD = Resources(device="cpu", precision="fp32", threads=1, workers=0, cores=2)


def make_trainer(**options) -> Trainer:
    defaults = {
        "optimizer": partial(torch.optim.Adam, lr=3e-3),
        "scheduler": partial(cosine),
        "epochs": 2,
        "batch_size": 4,
    }
    return Trainer(**(defaults | options))


def fit(folder: Path, *, trainer: Trainer | None = None, frames: int = 16, ckpt_path=None, **options):
    """Train a tiny network; returns (trainer, model, progress)."""
    seed_everything(0)
    model = eldenet.load("eldenet_s").train()
    loss = WeightedSum({"l1": WeightedTerm(options.pop("loss", L1Loss()))})
    train = SyntheticDepth(frames, transform=options.pop("transform", Augmentation(affine=0.0)))
    trainer = trainer or make_trainer(**options)
    progress = trainer.fit(
        model, train, SyntheticDepth(6), loss, PROTOCOL, folder, ONE_THREAD, ckpt_path=ckpt_path
    )
    return trainer, model, progress


def digest(folder: Path) -> str:
    return hashlib.sha256((folder / "model" / "model.safetensors").read_bytes()).hexdigest()


def test_training_learns_one_batch_by_heart(tmp_path):
    _, model, progress = fit(tmp_path, frames=4, epochs=60, transform=None, evaluate_every=60)
    first, last = progress.history[0]["train_total"], progress.history[-1]["train_total"]
    assert last < 0.25 * first
    assert evaluate(model, SyntheticDepth(4), PROTOCOL).metrics["delta1"] > 0.6


def test_the_run_folder_holds_what_was_promised(tmp_path):
    _, _, progress = fit(tmp_path)
    for name in ("model/config.json", "model/model.safetensors", "history.csv", "validation.png"):
        assert (tmp_path / name).is_file(), name
    for name in ("best.pt", "last.pt"):
        assert load_checkpoint(tmp_path / "checkpoints" / name)["progress"]["step"] > 0
    assert list((tmp_path / "tensorboard").iterdir())
    assert progress.step == 8
    assert json.loads((tmp_path / "model" / "config.json").read_text())["info"]["protocol"] == "synthetic"


def test_the_best_epoch_is_one_epoch_by_one_metric(tmp_path):
    _, _, progress = fit(tmp_path, epochs=4, monitor="abs_rel")
    values = [row["val_abs_rel"] for row in progress.history]
    assert progress.best_value == min(values)
    assert progress.best_epoch == 1 + values.index(min(values))
    best = evaluate(eldenet.load(tmp_path), SyntheticDepth(6), PROTOCOL).metrics["abs_rel"]
    assert best == pytest.approx(min(values), rel=1e-6)


class NoisyLoss(L1Loss):
    """Draws from torch's generator, as dropout does."""

    def forward(self, prediction, target, mask):
        return super().forward(prediction, target, mask) * (0.5 + torch.rand(()))


@pytest.mark.parametrize(
    ("options", "loss"),
    [
        ({}, L1Loss),
        ({"ema_decay": 0.9}, NoisyLoss),
        ({"accumulate": 2, "gradient_clip": 1.0}, L1Loss),
        ({"accumulate": 3, "evaluate_every": 2}, L1Loss),
    ],
)
def test_a_training_stopped_at_any_step_resumes_to_the_same_weights(tmp_path, options, loss):
    fit(tmp_path / "whole", epochs=3, checkpoint_every=1, loss=loss(), **options)

    class Stopped(Exception):
        pass

    class StoppingTrainer(Trainer):
        calls = 0

        def train_step(self, batch, *, update):
            StoppingTrainer.calls += 1
            if StoppingTrainer.calls == 7:  # in the middle of the second epoch
                raise Stopped
            return super().train_step(batch, update=update)

    settings = {
        "optimizer": partial(torch.optim.Adam, lr=3e-3),
        "scheduler": cosine,
        "epochs": 3,
        "batch_size": 4,
        "checkpoint_every": 1,
    } | options
    with pytest.raises(Stopped):
        fit(tmp_path / "part", trainer=StoppingTrainer(**settings), loss=loss())
    assert load_checkpoint(tmp_path / "part")["progress"]["epoch"] == 1
    fit(tmp_path / "part", trainer=make_trainer(**settings), ckpt_path=tmp_path / "part", loss=loss())
    assert digest(tmp_path / "part") == digest(tmp_path / "whole")
    # into another folder: the best epoch so far comes along
    fit(tmp_path / "other", trainer=make_trainer(**settings), ckpt_path=tmp_path / "part", loss=loss())
    assert digest(tmp_path / "other") == digest(tmp_path / "whole")


def command_of(folder: Path, *more: str) -> list[str]:
    return [
        *(sys.executable, "-m", "eldenet.train", "data=rooms", "model=eldenet_s", f"run_dir={folder}"),
        *("data.size=[32,40]", "data.input_size=[32,40]", "data.frames={train: 64, val: 8, test: 8}"),
        *("trainer.epochs=3", "trainer.batch_size=4", "trainer.checkpoint_every=1", "runtime.threads=1"),
        *("runtime.workers=2", *more),
    ]


def test_sigkill_at_random_steps_with_workers_and_augmentation(tmp_path, cache):
    environment = {**os.environ, "ELDENET_CACHE": cache}
    subprocess.run(command_of(tmp_path / "whole"), env=environment, check=True, capture_output=True)
    generator = random.Random(0)
    kills = 0
    for _attempt in range(8):
        process = subprocess.Popen(
            command_of(tmp_path / "killed", "ckpt_path=auto"),
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        last = tmp_path / "killed" / "checkpoints" / "last.pt"
        before = last.stat().st_mtime_ns if last.is_file() else 0
        deadline = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < deadline:  # until it has made some progress
            if last.is_file() and last.stat().st_mtime_ns > before:
                break
            time.sleep(0.02)
        time.sleep(generator.uniform(0.0, 0.5))
        if kills < 3 and process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            kills += 1
        elif process.wait(timeout=120) == 0:
            break
    assert kills >= 1, "the training ended before it could be killed once"
    assert digest(tmp_path / "killed") == digest(tmp_path / "whole")
    ends = [load_checkpoint(tmp_path / name)["model"] for name in ("killed", "whole")]
    assert all(torch.equal(ends[0][key], ends[1][key]) for key in ends[0])


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


def test_resuming_another_training_is_refused(tmp_path):
    fit(tmp_path, epochs=1)
    with pytest.raises(ValueError, match="belongs to another training"):
        fit(tmp_path, epochs=1, batch_size=8, ckpt_path=tmp_path)
    # the checkpoint's own learning rate would win without a word
    with pytest.raises(ValueError, match="optimizer differ"):
        fit(tmp_path, epochs=1, optimizer=partial(torch.optim.Adam, lr=1e-5), ckpt_path=tmp_path)
    with pytest.raises(ValueError, match="scheduler differ"):
        fit(tmp_path, epochs=1, scheduler=partial(cosine, final=0.5), ckpt_path=tmp_path)
    with pytest.raises(ValueError, match="ema_decay differ"):
        fit(tmp_path, epochs=1, ema_decay=0.9, ckpt_path=tmp_path)


def test_a_checkpoint_without_its_best_epoch_is_refused(tmp_path):
    fit(tmp_path / "run", epochs=1)
    (tmp_path / "alone").mkdir()
    (tmp_path / "run" / "checkpoints" / "last.pt").rename(tmp_path / "alone" / "last.pt")
    with pytest.raises(FileNotFoundError, match="best epoch so far is 1"):
        fit(tmp_path / "new", epochs=1, ckpt_path=tmp_path / "alone" / "last.pt")


@pytest.mark.parametrize("name", ["epochs", "checkpoint_every", "evaluate_every", "gradient_clip"])
def test_settings_that_make_no_sense_are_refused(name):
    with pytest.raises(ValueError, match=f"{name}=0"):
        make_trainer(**{name: 0})


def test_an_epochs_last_update_averages_the_batches_it_has(tmp_path):
    def weights(accumulate):
        plain = partial(torch.optim.SGD, lr=1e-2)
        return fit(
            tmp_path / str(accumulate), epochs=1, accumulate=accumulate, optimizer=plain, scheduler=constant
        )[1].state_dict()

    whole, cut = weights(4), weights(8)  # an epoch has four batches
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
    progress = trainer.fit(model, SyntheticDepth(8), data, loss, PROTOCOL, tmp_path, resources)
    assert (True, torch.bfloat16) in seen
    saved = evaluate(eldenet.load(tmp_path), data, PROTOCOL).metrics["abs_rel"]
    assert progress.best_value == pytest.approx(saved, rel=1e-6)


def test_tensorboard_keeps_every_epoch(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from eldenet.evaluation import sample_rows
    from eldenet.runlog import RunLog

    class Stopped(Exception):
        pass

    class StoppingTrainer(Trainer):
        def _end_epoch(self, epoch):
            super()._end_epoch(epoch)
            if epoch == 0:
                raise Stopped

    settings = {"optimizer": partial(torch.optim.Adam, lr=3e-3), "scheduler": cosine, "epochs": 2}
    with pytest.raises(Stopped):
        fit(tmp_path, trainer=StoppingTrainer(**settings, batch_size=4))
    time.sleep(1.1)  # tensorboard orders its files by the second they were begun in, then by a number as text
    _, model, _ = fit(tmp_path, trainer=make_trainer(**settings), ckpt_path=tmp_path)
    log = RunLog(tmp_path)  # as the command does, once training is over
    log.picture("predictions", 8, sample_rows(model, SyntheticDepth(2), PROTOCOL))
    log.close()
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [point.step for point in events.Scalars("val/delta1")] == [4, 8]


def test_damaged_and_foreign_checkpoints_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no checkpoint at"):
        load_checkpoint(tmp_path / "none.pt")
    save_checkpoint(tmp_path / "foreign.pt", {"weights": torch.zeros(2)})
    with pytest.raises(ValueError, match="no training checkpoint"):
        load_checkpoint(tmp_path / "foreign.pt")
    whole = (tmp_path / "foreign.pt").read_bytes()
    (tmp_path / "cut.pt").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"cut\.pt can't be read"):
        load_checkpoint(tmp_path / "cut.pt")

    class Dangerous:
        def __reduce__(self):
            return (os.system, ("echo executed > /dev/null",))

    torch.save({"progress": Dangerous()}, tmp_path / "pickle.pt")
    with pytest.raises(ValueError, match=r"pickle\.pt can't be read"):
        load_checkpoint(tmp_path / "pickle.pt")


def test_the_backbone_learns_at_its_own_rate():
    model, adam = eldenet.load("eldenet_s"), partial(torch.optim.Adam, lr=1e-3)
    optimizer = build_optimizer(adam, model, torch.nn.L1Loss(), backbone_lr=0.1)
    scheduler = one_cycle(optimizer, 100, 10, peak=10.0, warmup=0.1)
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
        (0.1, eldenet.load("guidedepth"), "has no backbone"),
    ):
        with pytest.raises(ValueError, match=message):
            build_optimizer(adam, network, torch.nn.L1Loss(), backbone_lr=wrong)


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
    values = rates(partial(cosine, warmup=0.2, final=0.1))
    assert values[:2] == pytest.approx([1 / 3, 2 / 3])
    assert values[2] == 1.0
    assert values == sorted(values[:3]) + sorted(values[3:], reverse=True)
    assert values[-1] > 0.1
    values = rates(partial(one_cycle, peak=10, warmup=0.2))
    assert values[:3] == pytest.approx([1.0, 5.5, 10.0])
    assert values[2:] == sorted(values[2:], reverse=True)
    assert values[-1] < 1.0


def test_constant_predictor_is_the_mean_of_known_depth():
    class Halves(SyntheticDepth):
        def load_frame(self, index):
            frame = super().load_frame(index)
            depth = frame.depth * 0 + (2.0 if index == 0 else 4.0)
            depth[:, :10] = 0 if index == 1 else 1.0
            return frame._replace(depth=depth)

    mean = fit_constant_predictor(Halves(2)).mean_depth
    assert mean.shape == (1, 1, 32, 48)
    assert mean[0, 0, 0, 0] == 1.0  # unknown in the second frame
    assert mean[0, 0, 0, 20] == 3.0


def test_evaluation_shards_count_every_image_once():
    model, data = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0)), SyntheticDepth(7)
    whole = evaluate(model, data, PROTOCOL, batch_size=3)
    names = [row[0] for row in whole.rows]
    assert names == data.names
    from eldenet.data.loading import evaluation_loader

    shares = [
        [name for batch in evaluation_loader(data, 2, rank=rank, processes=3) for name in batch["name"]]
        for rank in range(3)
    ]
    assert sorted(name for share in shares for name in share) == sorted(data.names)


def test_two_processes_score_as_one(tmp_path):
    script = tmp_path / "two.py"
    script.write_text(
        "import json, sys, torch\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from synthetic import SyntheticDepth\n"
        "from eldenet.evaluation import ConstantPredictor, evaluate\n"
        "from eldenet.metrics import EvalProtocol\n"
        "from accelerate import PartialState\n"
        "state = PartialState(cpu=True)\n"
        "torch.set_num_threads(1)\n"
        "model = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))\n"
        "result = evaluate(model, SyntheticDepth(7), EvalProtocol('synthetic', min_depth=0.1, "
        "ground_truth='dense'), batch_size=2, rank=state.process_index, processes=state.num_processes)\n"
        "if state.is_main_process:\n"
        "    json.dump([result.metrics, result.rows], open(sys.argv[1], 'w'))\n"
        "state.wait_for_everyone()\n"
        "state.destroy_process_group()\n"
    )
    subprocess.run(
        [
            *(sys.executable, "-m", "torch.distributed.run", "--nproc_per_node=2", "--master_port=0"),
            *("--standalone", str(script), str(tmp_path / "two.json")),
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    metrics, rows = json.loads((tmp_path / "two.json").read_text())
    model = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))
    one = evaluate(model, SyntheticDepth(7), PROTOCOL, batch_size=2)
    assert metrics == pytest.approx(one.metrics, rel=1e-12)
    assert [row[0] for row in rows] == [row[0] for row in one.rows]

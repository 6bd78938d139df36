"""Training, prediction, evaluation and benchmark on a CUDA device: ``pytest -m gpu``."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support.predicting import photo
from support.steps import CHOICES, parts
from support.synthetic import SyntheticDepth
from support.training import ONE_THREAD, PROTOCOL, Stopped, fit, make_trainer, stopping_at

import eldenet
from eldenet.benchmark import BenchmarkSettings, benchmark
from eldenet.compose import compose
from eldenet.deploy.predictor import DepthPredictor
from eldenet.evaluation.evaluator import evaluate
from eldenet.losses.ssim import SSIMLoss
from eldenet.system.resources import full_fp32
from eldenet.training.checkpoint import load_checkpoint
from eldenet.training.trainer import Trainer, TrainingData

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
]
BF16 = replace(ONE_THREAD, device="cuda", precision="bf16")
FP32 = replace(BF16, precision="fp32")
FP16 = replace(BF16, precision="fp16")


@pytest.fixture(autouse=True)
def _no_tf32() -> None:
    full_fp32()


def losses(folder: Path, **options) -> list[float]:
    """Train two epochs with SSIM; return each one's mean loss."""
    _, _, progress = fit(folder, loss=SSIMLoss(), **({"resources": FP32} | options))
    return [row["train_total"] for row in progress.history]


@pytest.mark.parametrize("resources", [BF16, FP16, FP32], ids=lambda resources: resources.precision)
def test_it_learns_one_batch_by_heart_in_each_precision(tmp_path: Path, resources) -> None:
    trainer, _, progress = fit(
        tmp_path, frames=4, epochs=60, transform=None, evaluate_every=60, resources=resources
    )
    assert trainer.optimizer.param_groups[0]["fused"]
    assert progress.history[-1]["train_total"] < 0.35 * progress.history[0]["train_total"]
    scaler = load_checkpoint(tmp_path)["scaler"]
    assert (scaler is not None) == (resources.precision == "fp16")


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_no_step_waits_for_the_gpu(choice: list[str], tmp_path: Path) -> None:
    class Strict(Trainer):
        steps = 0

        def train_step(self, batch, *, update):
            Strict.steps += 1
            torch.cuda.set_sync_debug_mode("error" if Strict.steps > 1 else "default")
            try:
                return super().train_step(batch, update=update)
            finally:
                torch.cuda.set_sync_debug_mode("default")

    model, loss = parts(choice)
    trainer = make_trainer(Strict, epochs=1, max_grad_norm=1.0, ema_decay=0.9)
    data = TrainingData(SyntheticDepth(16), SyntheticDepth(2), PROTOCOL)
    trainer.fit(model.train(), loss, data, tmp_path, BF16)
    assert Strict.steps == 4


def test_losses_are_those_of_a_cpu(tmp_path: Path) -> None:
    """In fp32, within 1 %: sums are rounded in another order, and Adam carries that on."""
    assert losses(tmp_path / "gpu") == pytest.approx(losses(tmp_path / "cpu", resources=ONE_THREAD), rel=1e-2)


@pytest.mark.parametrize(
    "options", [{"cuda_graph": True}, {"compile": True}, {"compile": True, "cuda_graph": True}], ids=str
)
def test_a_compiled_or_replayed_training_is_the_same(tmp_path: Path, options: dict[str, bool]) -> None:
    """Within 1 %, as above. Six steps an epoch: the graph is captured in the first one."""
    settings = {"frames": 24, "epochs": 3, "max_grad_norm": 1.0, "ema_decay": 0.9}
    plain, faster = (losses(tmp_path / str(extra), **settings, **extra) for extra in ({}, options))
    assert faster == pytest.approx(plain, rel=1e-2)


@pytest.mark.parametrize("options", [{}, {"aspect_ratios": [1.3, 0.75]}], ids=str)
def test_batches_of_several_shapes_are_replayed(tmp_path: Path, options: dict[str, list[float]]) -> None:
    data = SyntheticDepth(13, input_size=(32, 40))  # three batches of 4 frames and one of 1
    settings = {"data": data, "epochs": 8} | options
    plain, replayed = (losses(tmp_path / str(on), cuda_graph=on, **settings) for on in (False, True))
    assert replayed == pytest.approx(plain, rel=1e-2)


@pytest.mark.parametrize("options", [{}, {"cuda_graph": True}], ids=str)
def test_a_resumed_training_has_the_result_of_a_whole_one(tmp_path: Path, options: dict[str, bool]) -> None:
    """The weights within 1e-3 with ``trainer.deterministic=true``, or the losses within 1 % of a graph."""
    settings = {"epochs": 3, "checkpoint_every": 1, "deterministic": not options} | options
    whole = losses(tmp_path / "whole", **settings)
    with pytest.raises(Stopped):
        fit(
            tmp_path / "part",
            trainer=make_trainer(stopping_at(6), **settings),
            loss=SSIMLoss(),
            resources=FP32,
        )
    assert load_checkpoint(tmp_path / "part")["cuda_rng"] is not None
    resumed = losses(tmp_path / "part", ckpt_path=tmp_path / "part", **settings)
    assert resumed == pytest.approx(whole, rel=1e-2)
    if not options:
        ends = [load_checkpoint(tmp_path / name)["model"] for name in ("whole", "part")]
        for name, value in ends[0].items():
            torch.testing.assert_close(value, ends[1][name], atol=1e-3, rtol=1e-3)


def test_a_profile_times_the_parts_on_the_gpu(tmp_path: Path) -> None:
    trainer, _, _ = fit(tmp_path, epochs=3, profile=True, resources=BF16)
    assert all(seconds > 0 for seconds in trainer.times.seconds.values())
    events = json.loads((tmp_path / "trace.json").read_text())["traceEvents"]
    assert any(event.get("cat") == "kernel" for event in events)


def test_ddp_of_one_process_trains(tmp_path: Path) -> None:
    words = (
        *("data=rooms", "model=eldenet_s", "data.size=[32,40]", "data.input_size=[32,40]"),
        *("data.frames={train: 32, val: 8, test: 8}", "trainer.epochs=1", "trainer.batch_size=4"),
        *("trainer.accumulate_grad_batches=2", "runtime.device=cuda", "output=run"),
    )
    launch = (sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node=1")
    finished = subprocess.run(
        [*launch, "-m", "eldenet.train", *words], cwd=tmp_path, capture_output=True, text=True, timeout=280
    )
    assert finished.returncode == 0, finished.stderr[-3000:]
    assert json.loads((tmp_path / "run/run.json").read_text())["training"]["step"] == 4


def test_predictions_and_metrics_are_those_of_a_cpu() -> None:
    """Depth within 1 mm, but for sharpened edges (at most 0.5 % of the pixels); metrics within 1e-3."""
    model = eldenet.load("eldenet_rooms")
    on_cpu = DepthPredictor(model, steady=False, sharp=True)(photo(240, 320))
    scores = evaluate(model, SyntheticDepth(6), PROTOCOL).metrics
    predictor = DepthPredictor(model.to("cuda"), device="cuda", steady=False, sharp=True)
    difference = np.abs(predictor(photo(240, 320)) - on_cpu)
    assert (difference > 1e-3).mean() < 5e-3
    found = evaluate(model, SyntheticDepth(6), PROTOCOL, device="cuda").metrics
    assert found == {name: pytest.approx(value, rel=1e-3) for name, value in scores.items()}


def test_a_benchmark_names_the_gpu(tmp_path: Path) -> None:
    words = ["models=[eldenet_s]", "device=cuda", "sizes=[[64,64]]", "runtimes=[torch_channels_last]"]
    short = ["rounds=1", "seconds=0.05", "memory=false", f"output={tmp_path}"]
    rows = benchmark(compose(BenchmarkSettings, [*words, *short]))
    assert [row["device"].split()[0] for row in rows] == ["cuda"]
    assert rows[0]["latency_ms_p50"] > 0

"""Distillation: the teacher is frozen, unseen in checkpoints and checked on resuming; no label is needed."""

import json
from functools import partial
from pathlib import Path

import pytest
import torch
from support.synthetic import SyntheticDepth

import eldenet
from eldenet import zoo
from eldenet.config import build_training, compose, instantiate
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.distillation import DistilledTerm, Teacher
from eldenet.losses.pointwise import L1Loss
from eldenet.losses.ssim import SSIMLoss
from eldenet.system.resources import Resources, seed_everything
from eldenet.training.checkpoint import load_checkpoint
from eldenet.training.optim import cosine
from eldenet.training.run import train
from eldenet.training.trainer import Trainer, TrainingData

PROTOCOL = EvalProtocol("synthetic", min_depth=0.1, ground_truth="dense")
ONE_THREAD = Resources(device="cpu", precision="fp32", threads=1, workers=0, cores=2)
SHAPE = (2, 1, 64, 96)


@pytest.fixture
def networks() -> tuple[torch.nn.Module, torch.nn.Module]:
    """Student and a wider teacher."""
    seed_everything(0)
    return eldenet.load("eldenet_s").train(), eldenet.load("eldenet")


def test_outputs_are_compared_where_no_label_is(networks):
    student, network = networks
    teacher = Teacher(network)
    loss = WeightedSum(
        {
            "ssim": WeightedTerm(SSIMLoss()),
            "l1": WeightedTerm(L1Loss()),
            "distilled": DistilledTerm(L1Loss(), teacher, weight=0.5),
        }
    )
    image, nothing = torch.rand(2, 3, 64, 96), torch.zeros(SHAPE, dtype=torch.bool)
    prediction = student(image)
    total, terms = loss(prediction, torch.full(SHAPE, float("nan")), nothing, image)
    with torch.no_grad():
        expected = (prediction - network(image)).abs().mean()
    assert terms["ssim"] == terms["l1"] == 0
    torch.testing.assert_close(terms["distilled"], expected)
    torch.testing.assert_close(total, 0.5 * expected)
    total.backward()
    assert all(torch.isfinite(parameter.grad).all() for parameter in student.parameters())
    # a labelled image beside an unlabelled one counts as it would alone
    depth, half = torch.rand(SHAPE) + 1, nothing.clone()
    half[0] = True
    alone = loss(prediction[:1].detach(), depth[:1], half[:1], image[:1])[1]["l1"]
    torch.testing.assert_close(loss(prediction.detach(), depth, half, image)[1]["l1"], alone)


def test_the_gradient_reaches_the_student_alone(networks):
    student, network = networks
    before = {name: value.clone() for name, value in network.state_dict().items()}
    term = DistilledTerm(L1Loss(), Teacher(network.train()), feature_weight=1.0, feature_strides=(8, 16))
    term.attach(student)
    loss = WeightedSum({"distilled": term})
    loss.train()
    image = torch.rand(2, 3, 64, 96)
    loss(student(image), torch.zeros(SHAPE), torch.zeros(SHAPE, dtype=torch.bool), image)[0].backward()
    assert not network.training
    assert all(parameter.grad is None for parameter in network.parameters())
    after = network.state_dict()  # BatchNorm's statistics too
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert any(parameter.grad.abs().sum() > 0 for parameter in student.network.backbone.parameters())
    assert set(loss.state_dict()) == {
        f"terms.distilled.projections.{stride}.{part}" for stride in (8, 16) for part in ("weight", "bias")
    }
    assert all(parameter.grad.abs().sum() > 0 for parameter in loss.parameters())


def test_features_of_twins_agree(networks):
    student, _ = networks
    twin = eldenet.load("eldenet_s")
    twin.load_state_dict(student.state_dict())
    term = DistilledTerm(L1Loss(), Teacher(twin), feature_weight=1.0)
    term.attach(student.eval())
    image = torch.rand(2, 3, 64, 96)
    assert list(term.parameters()) == []  # equal channels need no projection
    value = term(student(image), torch.zeros(SHAPE), torch.zeros(SHAPE, dtype=torch.bool), image)
    torch.testing.assert_close(value, torch.zeros(()))


def test_the_teacher_may_see_another_size(networks):
    student, network = networks
    seen = []
    network.register_forward_pre_hook(lambda part, inputs: seen.append(tuple(inputs[0].shape[-2:])))
    term = DistilledTerm(L1Loss(), Teacher(network, input_size=[96, 128]), feature_weight=0.1)
    term.attach(student)
    image = torch.rand(2, 3, 64, 96)
    value = term(student(image), torch.zeros(SHAPE), torch.zeros(SHAPE, dtype=torch.bool), image)
    assert seen == [(96, 128)]
    assert torch.isfinite(value)


def test_a_teacher_says_at_which_size_it_sees(networks):
    network = networks[1]
    unknown = (
        "teacher big: sees the student's pictures as they are, was trained at a size that it does not state"
    )
    assert Teacher(network, source="big").describe(None) == unknown
    network.info = {"input_size": [64, 96]}
    assert Teacher(network, source="big", input_size=[96, 128]).describe([32, 40]) == (
        "teacher big: sees 96 x 128 pixels, was trained at 64 x 96"
    )


def test_what_cannot_be_distilled_is_refused(networks):
    student, network = networks
    with pytest.raises(ValueError, match=r"feature_strides=\[64\].*features of \[2, 4, 8, 16, 32\]"):
        DistilledTerm(L1Loss(), Teacher(network), feature_weight=1.0, feature_strides=(64,)).attach(student)
    with pytest.raises(ValueError, match=r"teacher has no network\.backbone"):
        DistilledTerm(L1Loss(), Teacher(torch.nn.Conv2d(3, 1, 1)), feature_weight=1.0).attach(student)
    with pytest.raises(ValueError, match="feature_weight=-1"):
        DistilledTerm(L1Loss(), Teacher(network), feature_weight=-1)
    with pytest.raises(ValueError, match="needs the images"):
        DistilledTerm(L1Loss(), Teacher(network))(*[torch.ones(SHAPE)] * 2, torch.ones(SHAPE).bool())
    with pytest.raises(ValueError, match="give teacher="):
        instantiate(compose("train", ["loss=ssim_l1_distill"]).loss)
    with pytest.raises(ValueError, match="without trained weights"):
        zoo.build_teacher("eldenet")


def test_a_teacher_that_nobody_asks_is_refused(tmp_path):
    """Its name in run.json would say that the network was taught."""
    config = compose(
        "train", ["teacher=runs/big", "model_name=a", f"run_dir={tmp_path}", "runtime.threads=1"]
    )
    with pytest.raises(ValueError, match="teacher=runs/big: no term of this loss"):
        train(build_training(config, tmp_path))


def fit(folder: Path, network: torch.nn.Module, *, epochs: int = 2, stop: int | None = None, ckpt_path=None):
    """Train a student against ``network``, outputs and features."""

    class Stopped(Exception):
        pass

    class Stopping(Trainer):
        calls = 0

        def train_step(self, batch, *, update):
            Stopping.calls += 1
            if Stopping.calls == stop:
                raise Stopped
            return super().train_step(batch, update=update)

    seed_everything(0)
    student = eldenet.load("eldenet_s").train()
    distilled = DistilledTerm(L1Loss(), Teacher(network, source="there"), feature_weight=0.5)
    loss = WeightedSum({"l1": WeightedTerm(L1Loss()), "distilled": distilled})
    trainer = Stopping(
        optimizer=partial(torch.optim.Adam, lr=3e-3),
        scheduler=cosine,
        epochs=epochs,
        batch_size=4,
        checkpoint_every=1,
    )
    try:
        trainer.fit(
            student,
            loss,
            TrainingData(SyntheticDepth(12), SyntheticDepth(4), PROTOCOL),
            folder,
            ONE_THREAD,
            ckpt_path=ckpt_path,
        )
    except Stopped:
        assert stop is not None
    return student


def test_a_distillation_resumes_to_the_same_weights_and_knows_its_teacher(tmp_path, networks):
    network = networks[1]
    fit(tmp_path / "whole", network)
    fit(tmp_path / "part", network, stop=5)
    fit(tmp_path / "part", network, ckpt_path=tmp_path / "part")
    whole, part = (load_checkpoint(tmp_path / name) for name in ("whole", "part"))
    for group in ("model", "loss"):
        assert whole[group]
        assert all(torch.equal(whole[group][name], part[group][name]) for name in whole[group])
    student = eldenet.load("eldenet_s")
    assert set(whole["model"]) == set(student.state_dict())  # no teacher in it
    assert set(eldenet.load(tmp_path / "whole").state_dict()) == set(student.state_dict())
    with torch.no_grad():
        next(network.parameters()).add_(1e-3)
    with pytest.raises(ValueError, match="teacher differ"):
        fit(tmp_path / "part", network, ckpt_path=tmp_path / "part")


def test_a_student_learns_from_its_teacher_without_labels(networks):
    student, network = networks
    seed_everything(0)
    teacher = Teacher(network)
    loss = WeightedSum({"distilled": DistilledTerm(L1Loss(), teacher)})
    image = SyntheticDepth(2)
    image = torch.stack([image[index]["image"] for index in range(2)])
    shape = (2, 1, *image.shape[-2:])
    nothing = torch.zeros(shape, dtype=torch.bool)
    optimizer = torch.optim.Adam(student.parameters(), lr=1e-3)
    values = []
    for _ in range(40):
        total, _ = loss(student(image), torch.zeros(shape), nothing, image)
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        values.append(float(total.detach()))
    assert values[-1] < 0.5 * values[0]


TINY = (
    *("data.size=[32,40]", "data.input_size=[32,40]", "data.frames={train: 8, val: 4, test: 4}"),
    *("trainer.epochs=1", "trainer.batch_size=4", "model=eldenet_s"),
)


def test_the_command_distils_from_any_run(run_command, tmp_path, networks):
    networks[1].save_pretrained(tmp_path / "big", info={"input_size": [64, 96]})
    finished = run_command(
        *("train", *TINY, "loss=ssim_l1_distill", "teacher=big", "run_dir=student"),
        "loss.terms.distilled.feature_weight=0.1",
    )
    assert finished.returncode == 0, finished.stderr
    assert "teacher big: sees 32 x 40 pixels, was trained at 64 x 96\n" in finished.stdout
    run = json.loads((tmp_path / "student" / "run.json").read_text())
    teacher = run["teacher"]["distilled"]
    assert teacher["source"] == "big"
    assert teacher["weights"] == Teacher(eldenet.load(tmp_path / "big")).identity["weights"]
    assert run["training"]["history"][0]["train_distilled"] > 0

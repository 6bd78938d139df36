"""Distillation: the teacher is frozen, absent from checkpoints, checked on resuming; it needs no labels."""

import json
from pathlib import Path

import pytest
import torch
from support.networks import canonical_net, small_net
from support.synthetic import SyntheticDepth
from support.training import ONE_THREAD, Stopped, fit, make_trainer, stopping_at

import eldenet
from eldenet import zoo
from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.evaluation.splits import Splits
from eldenet.losses.base import LossInputs, WeightedSum, WeightedTerm
from eldenet.losses.distillation import DistilledTerm, Teacher
from eldenet.losses.pointwise import L1Loss
from eldenet.losses.ssim import SSIMLoss
from eldenet.system.resources import seed_everything
from eldenet.train import TrainSettings, train
from eldenet.training import notes
from eldenet.training.checkpoint import load_checkpoint

SHAPE = (2, 1, 64, 96)
NOTHING_KNOWN = torch.zeros(SHAPE, dtype=torch.bool)


@pytest.fixture
def networks() -> tuple[torch.nn.Module, torch.nn.Module]:
    """Student and a wider teacher."""
    seed_everything(0)
    return eldenet.load("eldenet_s").train(), eldenet.load("eldenet")


def test_the_outputs_are_compared_without_labels(networks):
    student, network = networks
    teacher = Teacher(network)
    loss = WeightedSum(
        {
            "ssim": WeightedTerm(SSIMLoss()),
            "l1": WeightedTerm(L1Loss()),
            "distilled": DistilledTerm(L1Loss(), teacher, weight=0.5),
        }
    )
    image = torch.rand(2, 3, 64, 96)
    prediction = student(image)
    total, terms = loss(LossInputs(prediction, torch.full(SHAPE, float("nan")), NOTHING_KNOWN, image))
    with torch.no_grad():
        expected = (prediction - network(image)).abs().mean()
    assert terms["ssim"] == terms["l1"] == 0
    torch.testing.assert_close(terms["distilled"], expected)
    torch.testing.assert_close(total, 0.5 * expected)
    total.backward()
    assert all(torch.isfinite(parameter.grad).all() for parameter in student.parameters())
    # a labeled image counts the same beside an unlabeled one as alone
    depth, half = torch.rand(SHAPE) + 1, NOTHING_KNOWN.clone()
    half[0] = True
    alone = loss(LossInputs(prediction[:1].detach(), depth[:1], half[:1], image[:1]))[1]["l1"]
    both = loss(LossInputs(prediction.detach(), depth, half, image))[1]["l1"]
    torch.testing.assert_close(both, alone)


def test_gradients_reach_the_student_only(networks):
    student, network = networks
    before = {name: value.clone() for name, value in network.state_dict().items()}
    term = DistilledTerm(L1Loss(), Teacher(network.train()), feature_weight=1.0, feature_strides=(8, 16))
    term.setup(student)
    loss = WeightedSum({"distilled": term})
    loss.train()
    image = torch.rand(2, 3, 64, 96)
    loss(LossInputs(student(image), torch.zeros(SHAPE), NOTHING_KNOWN, image))[0].backward()
    assert not network.training
    assert all(parameter.grad is None for parameter in network.parameters())
    after = network.state_dict()  # BatchNorm's statistics too
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert any(parameter.grad.abs().sum() > 0 for parameter in student.network.backbone.parameters())
    assert set(loss.state_dict()) == {
        f"terms.distilled.projections.{stride}.{part}" for stride in (8, 16) for part in ("weight", "bias")
    }
    assert all(parameter.grad.abs().sum() > 0 for parameter in loss.parameters())


def test_equal_networks_have_no_feature_loss(networks):
    student, _ = networks
    twin = eldenet.load("eldenet_s")
    twin.load_state_dict(student.state_dict())
    term = DistilledTerm(L1Loss(), Teacher(twin), feature_weight=1.0)
    term.setup(student.eval())
    image = torch.rand(2, 3, 64, 96)
    assert list(term.parameters()) == []  # equal channels need no projection
    value = term(LossInputs(student(image), torch.zeros(SHAPE), NOTHING_KNOWN, image))
    torch.testing.assert_close(value, torch.zeros(()))


def test_a_picture_of_the_canonical_camera_has_its_meters_at_any_size():
    """Its focal length is 0.8 widths: at twice the width 102.4 px instead of 51.2."""
    network = canonical_net(48, 64)
    small, large = torch.rand(2, 3, 48, 64), torch.rand(2, 3, 96, 128)
    torch.testing.assert_close(Teacher(network)(small), network(small))
    torch.testing.assert_close(Teacher(network)(large), network(large, 102.4))
    some = torch.tensor([0.0, 90.0])
    torch.testing.assert_close(Teacher(network)(large, some), network(large, torch.tensor([102.4, 90.0])))


def test_a_teacher_may_see_what_it_was_trained_at(tmp_path):
    folder = canonical_net(48, 64).save_pretrained(tmp_path / "big")
    assert zoo.build_teacher(str(folder), input_size="model").input_size == (48, 64)
    crops = {"input_size": [48, 64], "whole_frame_size": [96, 128]}
    whole = small_net().save_pretrained(tmp_path / "crops", info=crops)
    assert zoo.build_teacher(str(whole), input_size="model").input_size == (96, 128)
    silent = small_net().save_pretrained(tmp_path / "silent")
    for source, given in ((folder, "own"), (silent, "model")):
        with pytest.raises(
            ValueError, match=rf"teacher\.input_size={given}: give \[height, width\] in pixels"
        ):
            zoo.build_teacher(str(source), input_size=given)


def test_the_teacher_can_see_images_of_another_size(networks):
    student, network = networks
    seen = []
    network.register_forward_pre_hook(lambda part, inputs: seen.append(tuple(inputs[0].shape[-2:])))
    term = DistilledTerm(L1Loss(), Teacher(network, input_size=[96, 128]), feature_weight=0.1)
    term.setup(student)
    image = torch.rand(2, 3, 64, 96)
    value = term(LossInputs(student(image), torch.zeros(SHAPE), NOTHING_KNOWN, image))
    assert seen == [(96, 128)]
    assert torch.isfinite(value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda student, teacher: DistilledTerm(
                L1Loss(), teacher, feature_weight=1.0, feature_strides=(64,)
            ).setup(student),
            r"feature_strides=\[64\].*features of \[2, 4, 8, 16, 32\]",
        ),
        (
            lambda student, _: DistilledTerm(
                L1Loss(), Teacher(torch.nn.Conv2d(3, 1, 1)), feature_weight=1.0
            ).setup(student),
            r"teacher has no network\.backbone",
        ),
        (
            lambda *_: instantiate(compose(TrainSettings, ["loss=ssim_l1_distill"]).loss),
            r"for a loss as teacher=\.\.\.",
        ),
        (
            lambda *_: instantiate(
                compose(TrainSettings, ["data=mix_photographs"]).data["sources"]["photographs"]["data"]
            ),
            r"for photographs as data\.sources\.photographs\.data\.teacher\.source=\.\.\.",
        ),
        (lambda *_: zoo.build_teacher("eldenet"), "without trained weights"),
    ],
)
def test_a_teacher_or_features_that_are_missing_are_named(make, message: str, networks):
    student, network = networks
    with pytest.raises(ValueError, match=message):
        make(student, Teacher(network))


def test_a_teacher_without_a_distilled_term_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where "runs/big" may be a Hub id
    config = compose(
        TrainSettings, ["teacher=runs/big", "model_name=a", f"output={tmp_path}", "runtime.threads=1"]
    )
    with pytest.raises(ValueError, match="teacher=runs/big: no term of this loss"):
        train(config)


def distill(folder: Path, network: torch.nn.Module, *, stop: int = 0, ckpt_path: Path | None = None) -> None:
    """Train a student against ``network``, with outputs and features."""
    terms = {"distilled": DistilledTerm(L1Loss(), Teacher(network, source="there"), feature_weight=0.5)}
    trainer = make_trainer(stopping_at(stop), checkpoint_every=1)
    fit(folder, trainer=trainer, frames=12, val_frames=4, terms=terms, ckpt_path=ckpt_path)


@pytest.mark.slow
def test_a_resumed_distillation_gives_the_same_weights_and_checks_its_teacher(tmp_path, networks):
    network = networks[1]
    distill(tmp_path / "whole", network)
    with pytest.raises(Stopped):
        distill(tmp_path / "part", network, stop=5)
    distill(tmp_path / "part", network, ckpt_path=tmp_path / "part")
    whole, part = (load_checkpoint(tmp_path / name) for name in ("whole", "part"))
    for group in ("model", "loss"):
        assert whole[group]
        assert all(torch.equal(whole[group][name], part[group][name]) for name in whole[group])
    student = eldenet.load("eldenet_s")
    assert set(whole["model"]) == set(student.state_dict())  # no teacher in it
    assert set(eldenet.load(tmp_path / "whole").state_dict()) == set(student.state_dict())
    with torch.no_grad():
        next(network.parameters()).add_(1e-3)
    with pytest.raises(ValueError, match=r"belongs to another training: teacher\.distilled\.weights"):
        distill(tmp_path / "part", network, ckpt_path=tmp_path / "part")


TINY = (
    *("data.size=[32,40]", "data.input_size=[32,40]", "data.frames={train: 8, val: 4, test: 4}"),
    *("trainer.epochs=1", "trainer.batch_size=4", "runtime.workers=0", "model=eldenet_s"),
)


@pytest.mark.slow
def test_the_train_command_distills_from_a_saved_model(run_command, tmp_path, networks):
    networks[1].save_pretrained(tmp_path / "big", info={"input_size": [64, 96]})
    finished = run_command(
        *("train", *TINY, "loss=ssim_l1_distill", "teacher=big", "output=student"),
        "loss.terms.distilled.feature_weight=0.1",
    )
    assert finished.returncode == 0, finished.stderr
    assert "teacher big: sees 32 x 40 pixels, was trained at 64 x 96\n" in finished.stdout
    run = json.loads((tmp_path / "student" / "run.json").read_text())
    teacher = run["teacher"]["distilled"]
    assert teacher["source"] == "big"
    assert teacher["weights"] == Teacher(eldenet.load(tmp_path / "big")).signature["weights"]
    assert run["training"]["history"][0]["train_distilled"] > 0
    assert "has no canonical camera" not in finished.stdout  # neither has the student


def test_a_teacher_of_one_lens_is_named_beside_a_student_of_any(tmp_path):
    def said(network: torch.nn.Module, student: torch.nn.Module) -> str:
        loss = WeightedSum({"distilled": DistilledTerm(L1Loss(), Teacher(network, source="big"))})
        frames = SyntheticDepth(2)
        splits, data = Splits(frames, frames, frames), {"name": "made", "input_size": [32, 48]}
        return "\n".join(notes.before(splits, loss, student, data, ONE_THREAD, tmp_path))

    any_lens = canonical_net(32, 48)
    assert "note: teacher big has no canonical camera" in said(small_net(), any_lens)
    for network, student in ((any_lens, any_lens), (any_lens, small_net()), (small_net(), small_net())):
        assert "canonical camera" not in said(network, student)

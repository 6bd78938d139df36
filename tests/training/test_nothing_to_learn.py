"""A training on nothing, or of nothing, is an error or is said; NaN is never the best value."""

import math
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from support import layouts
from support.synthetic import SyntheticDepth
from support.training import PROTOCOL, fit

from eldenet.compose import compose
from eldenet.evaluation import splits
from eldenet.evaluation.evaluator import evaluate
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.distillation import DistilledTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.train import TrainSettings, train
from eldenet.training.notes import after, collapse
from eldenet.training.trainer import Trainer


class PartlyUnknown(SyntheticDepth):
    """The depth of the first ``unknown`` frames is not known."""

    def __init__(self, frames: int, unknown: int, **options) -> None:
        super().__init__(frames, **options)
        self.unknown = unknown

    def load_frame(self, index: int):
        frame = super().load_frame(index)
        return frame if index >= self.unknown else frame._replace(depth=np.zeros_like(frame.depth))


def test_batches_without_a_known_pixel_are_counted(tmp_path: Path, capsys) -> None:
    _, _, progress = fit(tmp_path, data=PartlyUnknown(4, 2), batch_size=1, epochs=1)
    assert "note: 2 of 4 batches of this epoch have no known pixel" in capsys.readouterr().out
    assert [name for name in progress.history[0] if name.startswith("train")] == [
        "train_total",
        "train_mse",
        "train_l1",
        "train_grad_norm",
    ]


def test_an_epoch_without_a_known_pixel_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no pixel of the epoch's training frames.*check-data"):
        fit(tmp_path, data=PartlyUnknown(4, 4), epochs=1)
    assert not (tmp_path / "model").exists()


def test_unlabeled_frames_teach_where_a_teacher_sees_them(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(WeightedTerm, "needs_depth", DistilledTerm.needs_depth)
    fit(tmp_path, data=PartlyUnknown(4, 4), epochs=1)


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_a_split_without_a_known_pixel_is_refused_before_the_training(monkeypatch, split: str) -> None:
    def open_split(data, name: str, protocol, **_):
        return PartlyUnknown(3, 3 if name == split else 2)

    monkeypatch.setattr(splits, "open_split", open_split)
    with pytest.raises(ValueError, match=r"no pixel of 3 frames such as synthetic/0 has a known depth"):
        splits.open_splits({}, PROTOCOL)
    if split == "train":
        splits.open_splits({}, PROTOCOL, labeled=False)


def test_nothing_can_be_scored_where_nothing_is_known(model) -> None:
    with pytest.raises(ValueError, match=r"no pixel of 2 frames.*protocol synthetic counts \(0\.1 to"):
        evaluate(model, PartlyUnknown(2, 2), PROTOCOL)


def test_nan_is_never_the_best(tmp_path: Path, monkeypatch) -> None:
    values = iter([math.nan, 0.2, math.nan, 0.1])
    validate = Trainer._validate

    def with_nan(trainer):
        return validate(trainer) | {"delta1": next(values)}

    monkeypatch.setattr(Trainer, "_validate", with_nan)
    _, _, progress = fit(tmp_path, frames=4, epochs=4)
    assert (progress.best_epoch, progress.best_value) == (2, 0.2)
    values = iter([math.nan])
    with pytest.raises(ValueError, match=r"monitor=delta1 was NaN in every validation.*choose another"):
        fit(tmp_path / "none", frames=4, epochs=1)


def test_weights_that_are_all_0_are_refused() -> None:
    terms = {name: WeightedTerm(L1Loss(), weight=0.0) for name in ("ssim", "l1")}
    with pytest.raises(ValueError, match=r"all weights of the loss are 0 \(ssim, l1\)"):
        WeightedSum(terms)
    WeightedSum(terms | {"l1": WeightedTerm(L1Loss(), weight=0.5)})


def test_a_network_worse_than_a_constant_map_is_said() -> None:
    constant = {"delta1": 0.4, "abs_rel": 0.5}
    worse = {"metrics": {"delta1": 0.0, "abs_rel": 1.0}, "constant_predictor": constant}
    assert "worse than a constant depth map (delta1 0.000" in collapse(worse)
    (line,) = after(MagicMock(), MagicMock(epochs=1, evaluate_every=1), worse)
    assert line.startswith(collapse(worse))
    assert "lower optimizer.lr" in line
    assert collapse({"metrics": {"delta1": 0.3, "abs_rel": 0.4}, "constant_predictor": constant}) == ""
    assert collapse({"metrics": worse["metrics"], "constant_predictor": None}) == ""


def test_a_rate_that_is_far_too_high_is_said_in_one_line(tmp_path: Path, capsys) -> None:
    layouts.folder(tmp_path / "data", count=10)
    words = ["data=folder", f"data.root={tmp_path / 'data'}", "model=eldenet_s", "data.input_size=[32,64]"]
    words += ["optimizer.lr=1e3", "trainer.epochs=2", "model_name=small", "runtime.workers=0"]
    folder = tmp_path / "run"
    s = compose(TrainSettings, [*words, "runtime.threads=1", f"output={folder}"])
    try:
        train(s)
        said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("warning")]
    except (FloatingPointError, ValueError) as error:  # in some precisions the weights overflow
        said = str(error).splitlines()
    assert len(said) == 1
    assert "lower optimizer.lr" in said[0]

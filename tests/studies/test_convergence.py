"""Curves of a study's stored runs: at which level rows are compared, and which curves there are."""

from pathlib import Path

import pytest
from support.scripts import load_scripts
from support.stored_study import figures, history, store, write_plan

from eldenet.compose import compose
from eldenet.studies.plan import Study
from eldenet.train import TrainSettings

(script,) = load_scripts("", "convergence")
convergence, curves, validation_loss = script.convergence, script.curves, script.validation_loss


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return write_plan(tmp_path)


def test_rows_are_compared_at_a_level_that_every_run_reaches(study: Study) -> None:
    """A bad start makes 90 % of a descent early; the worst last value is one level for all."""
    falls = {
        ("small", 0): [9.0, 2.0, 1.5, 1.2, 1.1],
        ("large", 0): [2.0, 1.8, 1.2, 1.0, 0.9],
        ("large", 1): [2.0, 1.2, 1.1, 1.0, 1.0],
        ("other", 0): [5.0, 5.0, 5.0, 5.0, 5.0],  # another block has another level
    }
    for (name, seed), mse in falls.items():
        store(study, name, seed, figures(0, seed), training={"history": history(mse)})
    found = convergence(study)
    titles, rows = found.by_row()
    cells = {(row[0], row[1]): dict(zip(titles, row, strict=True)) for row in rows}
    small, large = cells["small", "MSE"], cells["large", "MSE"]
    assert (small["level"], large["level"], cells["other", "MSE"]["level"]) == ("1.100", "1.100", "5.000")
    assert small["90% of its own descent [epoch]"] == "3"
    assert (small["at level [epoch]"], small["at 1.15 x level [epoch]"]) == ("5", "4")
    assert large["at level [epoch]"] == "3.5 ± 0.7"  # 4 and 3
    assert large["at 1.15 x level [epoch]"] == "2.5 ± 0.7"
    assert (large["seeds"], large["epochs"]) == ("2", "5")
    assert large["fluctuation"] == "0.1477 ± 0.0032"  # one whole window: 0.18 / 1.2 and 0.16 / 1.1
    titles, rows = found.by_run()
    assert [row[0] for row in rows if row[1] == "MSE"] == [f"{n}/seed{s}" for n, s in falls]


def test_training_losses_of_two_kinds_have_no_common_level(study: Study, tmp_path: Path) -> None:
    study = write_plan(tmp_path, "model=eldenet]", "model=eldenet, loss=berhu]")
    for name in ("small", "large"):
        store(study, name, 0, figures(0, 0), training={"history": history([3.0, 2.0, 1.0])})
    titles, rows = convergence(study).by_row()
    levels = {tuple(row[:2]): row[titles.index("level")] for row in rows}
    assert levels["small", "training loss"] == levels["large", "training loss"] == "-"
    assert levels["small", "MSE"] == levels["large", "MSE"] == "1.000"


def test_a_curve_that_sparse_depth_does_not_have_is_left_out(study: Study) -> None:
    epochs = [row | {"val_ssim": None} for row in history([3.0, 2.0, 1.0])]  # as run.json has NaN
    store(study, "small", 0, figures(0, 0), training={"history": epochs})
    assert set(convergence(study).curves["small/seed0"]) == {"train_loss", "val_mse"}


def test_a_taught_run_is_compared_by_its_loss_on_the_labels() -> None:
    """A run with a teacher has a higher total; its curve is that of the labels, in every epoch."""
    config = compose(TrainSettings, ["model_name=a", "output=b", "loss=ssim_l1_distill", "teacher=big"])
    epochs = [{"epoch": 1, "train_total": 3.0, "train_distilled": 2.0}]
    epochs += [{"epoch": 2, "train_total": 1.5, "train_distilled": 0.75, "val_mse": 1.0}]
    run = {"config": {"loss": config.loss}, "training": {"history": epochs}}
    found = curves(run)
    assert found["train_loss"] == ([1, 2], [1.0, 0.75])
    assert found["val_mse"] == ([2], [1.0])


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["loss.terms.l1.weight=0.5"], 0.3),
        (["loss=l1"], 0.4),
        (["loss=berhu"], None),
        (["loss.terms.l1.space=log"], None),
        (["loss.terms.l1.loss._target_=eldenet.losses.pointwise.BerHuLoss"], None),
    ],
)
def test_the_validation_loss_is_that_of_the_training_if_metrics_give_it(overrides, expected):
    config = compose(TrainSettings, ["model_name=a", "output=b", *overrides])
    run = {"config": {"loss": config.loss}}
    assert validation_loss(run, {"val_ssim": 0.8, "val_mae": 0.4}) == pytest.approx(expected)

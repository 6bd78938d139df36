"""Curves of a study's stored runs: at which level rows are compared, and which curves there are."""

from pathlib import Path

import pytest
from support.scripts import load_scripts
from support.stored_study import figures, history, store, write_plan

from eldenet.compose import compose
from eldenet.studies.plan import Study
from eldenet.train import TrainSettings

(script,) = load_scripts("", "convergence")
convergence, curves = script.convergence, script.curves


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


def test_a_taught_run_is_compared_by_its_loss_on_the_labels() -> None:
    """A run with a teacher has a higher total; its curve is that of the labels, in every epoch."""
    config = compose(TrainSettings, ["model_name=a", "output=b", "loss=ssim_l1_distill", "teacher=big"])
    epochs = [{"epoch": 1, "train_total": 3.0, "train_distilled": 2.0}]
    epochs += [{"epoch": 2, "train_total": 1.5, "train_distilled": 0.75, "val_mse": 1.0}]
    run = {"config": {"loss": config.loss}, "training": {"history": epochs}}
    found = curves(run)
    assert found["train_loss"] == ([1, 2], [1.0, 0.75])
    assert found["val_mse"] == ([2], [1.0])

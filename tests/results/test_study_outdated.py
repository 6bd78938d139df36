"""Stored runs that are not what the plan asks for today: left out of the tables, or named."""

import json
from pathlib import Path
from typing import Any

import pytest
from support.stored_study import PLAN, figures, history, notes, store, table, write_plan

from eldenet import config as cfg
from eldenet.results.fingerprints import fingerprint, run_differences
from eldenet.results.studies.convergence import convergence
from eldenet.results.studies.matching import compose_run
from eldenet.results.studies.plan import Study, read_study


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return write_plan(tmp_path)


def test_rows_of_an_older_plan_show_no_figures(study: Study, tmp_path: Path) -> None:
    store(study, "small", 0, figures(0, 0))
    store(study, "large", 0, figures(0, 1))
    (tmp_path / "sweep.yaml").write_text(PLAN.replace("model=eldenet]", "model=eldenet, loss=berhu]"))
    rows = table(read_study(tmp_path))
    assert rows["large"]["seeds"].startswith("outdated: loss")
    assert rows["large"]["δ1 ↑"] == "-"
    assert rows["small"]["seeds"] == "1 of 3"
    (tmp_path / "sweep.yaml").write_text(PLAN.replace("epochs=3", "epochs=4"))
    rows = table(read_study(tmp_path))
    assert rows["small"]["seeds"] == "outdated: trainer.epochs=4 (there 3)"


def test_rows_of_other_weights_show_no_figures(study: Study, tmp_path: Path) -> None:
    """Whether there are weights, and what those of the package hold; a path alone may move."""
    store(study, "large", 0, figures(0, 1))
    plan = PLAN.replace("model=eldenet]", "model=eldenet, weights=eldenet_rooms]")
    (tmp_path / "sweep.yaml").write_text(plan)
    assert table(read_study(tmp_path))["large"]["seeds"] == "outdated: weights=eldenet_rooms (there None)"
    content = fingerprint("eldenet_rooms")
    for stored, status in (
        (content, "1 of 3"),
        ("0" * 16, f"outdated: weights=eldenet_rooms (content {content}"),
    ):
        folder = store(read_study(tmp_path), "large", 0, figures(0, 1))
        run = json.loads((folder / "run.json").read_text())
        run["config"]["weights"], run["sources"] = "eldenet_rooms", {"weights": stored}
        (folder / "run.json").write_text(json.dumps(run))
        assert table(read_study(tmp_path))["large"]["seeds"].startswith(status)
    (tmp_path / "sweep.yaml").write_text(
        PLAN.replace("model=eldenet]", 'model=eldenet, "weights={runs}/small/seed0"]')
    )
    assert table(read_study(tmp_path))["large"]["seeds"] == "1 of 3"


def distilled(**teacher: object) -> dict[str, Any]:
    """A config that learns from a teacher, and that of a run that was given one."""
    term = {"teacher": {"_target_": "eldenet.losses.distillation.Teacher", "source": None} | teacher}
    return {"teacher": teacher.get("source"), "loss": {"terms": {"distilled": term}}}


def test_what_is_taken_over_counts_with_its_options() -> None:
    """``pretrained: true`` is a start, and a teacher's options change what it teaches."""
    scratch = {"model": {"backbone": {"pretrained": False}}}
    imagenet = {"model": {"backbone": {"pretrained": True}}}
    assert run_differences(scratch, {"config": scratch}) == []
    assert run_differences(imagenet, {"config": imagenet}) == []
    for ours, there in ((imagenet, scratch), (scratch, imagenet)):
        (found,) = run_differences(ours, {"config": there})
        assert found.startswith("model.backbone.pretrained=")
    ours, there = distilled(source="a", input_size=[240, 320]), distilled(source="a", input_size=None)
    (found,) = run_differences(ours, {"config": there})
    assert found == "loss.terms.distilled.teacher.input_size=[240, 320] (there None)"


def test_a_given_teacher_is_not_missed_where_the_loss_takes_it_on() -> None:
    given = frozenset(("teacher",))
    ours, there = distilled(), distilled(source="runs/large")
    assert run_differences(ours, {"config": there}, elsewhere=given, by_path=False) == []
    (found, _) = run_differences(ours, {"config": there}, by_path=False)
    assert found == "teacher=None (there runs/large)"


def test_curves_of_an_older_plan_are_left_out(study: Study, tmp_path: Path) -> None:
    for name in ("small", "large"):
        store(study, name, 0, figures(0, 0), training={"history": history([3.0, 2.0, 1.0])})
    assert set(convergence(study).curves) == {"small/seed0", "large/seed0"}
    (tmp_path / "sweep.yaml").write_text(PLAN.replace("model=eldenet]", "model=eldenet, loss=berhu]"))
    assert set(convergence(read_study(tmp_path)).curves) == {"small/seed0"}


def test_a_rule_that_a_run_does_not_know_was_not_applied(study: Study) -> None:
    """Runs of before and after a new key of the protocol stand in one block."""
    store(study, "small", 0, figures(0, 0))
    folder = store(study, "large", 0, figures(0, 1))
    run = json.loads((folder / "run.json").read_text())
    assert run["protocol"].pop("inverse_scale") is None
    (folder / "run.json").write_text(json.dumps(run))
    assert table(study)["large"]["seeds"] == "1 of 3"


def choose(study: Study, name: str, delta1: dict[str, float | None]) -> None:
    """A stored choice of a learning rate as the study's trials leave it."""
    (row,) = study.chosen(name)
    overrides = [*study.overrides, *row.overrides, *study.rate_overrides]
    config = compose_run(overrides, Path("f"), Path("r"), name=name, seed=0)
    best = max(delta1, key=lambda rate: delta1[rate] or 0)
    content = {"learning_rate": float(best), "delta1": delta1, "sources": {}}
    content["rule"] = {"candidates": list(study.learning_rates), "config": cfg.plain(config)}
    (study.folder / "stored" / name / "learning_rate.json").write_text(json.dumps(content))


SEARCHED = PLAN.replace("learning_rate: 1.0e-3", "learning_rates: [3.0e-4, 1.0e-3]")


def test_runs_at_another_rate_than_the_chosen_one_are_outdated(study: Study, tmp_path: Path) -> None:
    store(study, "small", 0, figures(0, 0))
    (tmp_path / "sweep.yaml").write_text(SEARCHED)
    study = read_study(tmp_path)
    assert table(study)["small"]["seeds"] == "1 of 3"  # nothing has chosen yet
    choose(study, "small", {"0.0003": 0.4, "0.001": 0.5, "0.003": None})
    assert table(study)["small"]["seeds"] == "1 of 3"
    assert not any("edge" in note for note in notes(study))
    choose(study, "small", {"0.0003": 0.4, "0.001": 0.5})
    assert any(note.endswith("beyond: small (0.001; tried: 0.0003 to 0.001)") for note in notes(study))
    choose(study, "small", {"0.0003": 0.5, "0.001": 0.4})
    assert table(study)["small"]["seeds"] == "outdated: optimizer.lr=0.0003 (there 0.001)"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[3.0e-4, 1.0e-3]", "[1.0e-3, 3.0e-3]", "small (candidates=[0.001, 0.003] (there [0.0003, 0.001]))"),
        ("rows:", "rate_overrides: [trainer.epochs=2]\nrows:", "small (trainer.epochs=2 (there 3))"),
        ("rows:", "rate_overrides: [trainer.epochs=3]\nrows:", None),
    ],
)
def test_a_search_of_an_older_plan_is_named(
    study: Study, tmp_path: Path, old: str, new: str, words: str | None
) -> None:
    """The runs are what they say they are, but their rate was not found as those of the other rows."""
    for seed, name in enumerate(("small", "large")):
        store(study, name, 0, figures(0, seed))
    (tmp_path / "sweep.yaml").write_text(SEARCHED)
    choose(read_study(tmp_path), "small", {"0.0003": 0.4, "0.001": 0.5, "0.003": 0.3})
    assert not any("trials" in note for note in notes(read_study(tmp_path)))
    (tmp_path / "sweep.yaml").write_text(SEARCHED.replace(old, new))
    study = read_study(tmp_path)
    choose(study, "large", {"0.0003": 0.4, "0.001": 0.5, "0.003": 0.3})
    found = [note for note in notes(study) if "trials" in note]
    assert [note.partition("rerun=true: ")[2] for note in found] == ([words] if words else [])
    assert table(study)["small"]["seeds"] == "1 of 3"


def test_half_a_copy_is_no_stored_run(study: Study) -> None:
    folder = store(study, "small", 0, figures(0, 0))
    (folder / "per_image.csv").unlink()
    assert table(study)["small"]["seeds"] == "not run"

"""Stored runs that were not made with the settings of the plan: left out of the tables, or named."""

from pathlib import Path
from typing import Any

import pytest
from support.stored_study import change_run, figures, notes, settings_of, store, table, write_plan

from eldenet.results.fingerprints import differences, fingerprint, fingerprints, run_differences
from eldenet.results.packed_runs import add_record
from eldenet.studies.plan import Study, read_study


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return write_plan(tmp_path)


def test_runs_with_settings_of_an_older_plan_are_not_shown(study: Study, tmp_path: Path) -> None:
    for name in ("small", "large"):
        store(study, name, 0, figures(0, 0))
    changed = write_plan(tmp_path, "model=eldenet]", "model=eldenet, loss=berhu]")
    rows = table(changed)
    assert rows["large"]["seeds"].startswith("outdated: loss")
    assert rows["large"]["δ1 ↑"] == "-"
    assert rows["small"]["seeds"] == "1 of 3"
    changed = write_plan(tmp_path, "epochs=3", "epochs=4")
    assert table(changed)["small"]["seeds"] == "outdated: trainer.epochs=4 (there 3)"
    assert notes(changed) == ["the stored runs are outdated, see above"]


def test_runs_from_other_weights_are_not_shown(study: Study, tmp_path: Path) -> None:
    """Weights are compared by presence and packaged ones by content; others may have moved."""
    store(study, "large", 0, figures(0, 1))
    changed = write_plan(tmp_path, "model=eldenet]", "model=eldenet, weights=eldenet_rooms]")
    assert table(changed)["large"]["seeds"] == "outdated: weights=eldenet_rooms (there None)"
    content = fingerprint("eldenet_rooms")
    for stored, status in (
        (content, "1 of 3"),
        ("0" * 16, f"outdated: weights=eldenet_rooms (content {content}"),
    ):
        config = store(changed, "large", 0, figures(0, 1))["config"] | {"weights": "eldenet_rooms"}
        change_run(changed, "large/seed0", config=config, sources={"weights": stored})
        assert table(changed)["large"]["seeds"].startswith(status)
    moved = write_plan(tmp_path, "model=eldenet]", 'model=eldenet, "weights={runs}/small/seed0"]')
    assert table(moved)["large"]["seeds"] == "1 of 3"


def test_where_a_file_lies_makes_no_difference_but_its_name_does() -> None:
    def settings(path: str) -> dict[str, Any]:
        return {"data": {"labels": path, "overrides": [f"model.network.file={path}"]}}

    assert differences(settings("/one/meter.pth"), settings("$TWO/weights/meter.pth")) == []
    assert len(differences(settings("one/meter.pth"), settings("one/other.pth"))) == 2


def distilled(**teacher: object) -> dict[str, Any]:
    """A config with a loss that learns from a teacher."""
    term = {"teacher": {"_target_": "eldenet.losses.distillation.Teacher", "source": None} | teacher}
    return {"teacher": teacher.get("source"), "loss": {"terms": {"distilled": term}}}


def test_weights_and_teachers_are_compared_with_their_options() -> None:
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


def test_a_teachers_onnx_file_is_compared_by_content(tmp_path: Path) -> None:
    file = tmp_path / "teacher.onnx"
    file.write_bytes(b"one network")
    config = {"data": {"sources": {"photographs": {"data": {"teacher": {"path": str(file)}}}}}}
    record = {"config": config, "sources": fingerprints(config)}
    assert run_differences(config, record) == []
    file.write_bytes(b"another network")
    (found,) = run_differences(config, record)
    assert found.startswith("data.sources.photographs.data.teacher.path=")


def test_a_given_teacher_is_not_compared_where_the_loss_refers_to_it() -> None:
    ours, there = distilled(), distilled(source="runs/large")
    assert run_differences(ours, {"config": there}, given=frozenset(("teacher",))) == []
    (found, _) = run_differences(ours, {"config": there}, given=frozenset())
    assert found == "teacher=None (there runs/large)"


def test_a_protocol_rule_that_a_run_does_not_have_was_not_applied(study: Study) -> None:
    store(study, "small", 0, figures(0, 0))
    protocol = store(study, "large", 0, figures(0, 1))["protocol"]
    assert protocol.pop("inverse_scale") is None
    change_run(study, "large/seed0", protocol=protocol)
    assert table(study)["large"]["seeds"] == "1 of 3"


def choose(study: Study, name: str, delta1: dict[str, float | None]) -> None:
    """Store the choice of a learning rate as the study's trials do."""
    (row,) = study.chosen(name)
    best = max(delta1, key=lambda rate: delta1[rate] or 0)
    rule = {"candidates": list(study.learning_rates)}
    rule["config"] = settings_of(study.overrides_of(row, trial=True), name)
    content = {"learning_rate": float(best), "delta1": delta1, "sources": {}, "rule": rule}
    add_record(study.folder, f"{name}/learning_rate", content)


SEARCH = "learning_rates: [3.0e-4, 1.0e-3]"


def test_runs_at_another_rate_than_the_chosen_one_are_not_shown(study: Study, tmp_path: Path) -> None:
    store(study, "small", 0, figures(0, 0))
    study = write_plan(tmp_path, "learning_rate: 1.0e-3", SEARCH)
    assert table(study)["small"]["seeds"] == "1 of 3"  # there is no choice yet
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
def test_a_note_names_rows_whose_rate_another_search_chose(
    study: Study, tmp_path: Path, old: str, new: str, words: str | None
) -> None:
    for seed, name in enumerate(("small", "large")):
        store(study, name, 0, figures(0, seed))
    study = write_plan(tmp_path, "learning_rate: 1.0e-3", SEARCH)
    choose(study, "small", {"0.0003": 0.4, "0.001": 0.5, "0.003": 0.3})
    assert not any("trials" in note for note in notes(study))
    plan = tmp_path / "sweep.yaml"
    plan.write_text(plan.read_text().replace(old, new))
    study = read_study(tmp_path)
    choose(study, "large", {"0.0003": 0.4, "0.001": 0.5, "0.003": 0.3})
    found = [note for note in notes(study) if "trials" in note]
    assert [note.partition("rerun=true: ")[2] for note in found] == ([words] if words else [])
    assert table(study)["small"]["seeds"] == "1 of 3"

"""The learning rate of a row: one rule for every network; a choice by another rule is refused."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from eldenet.results.fingerprints import fingerprints
from eldenet.results.packed_runs import RUNS, read_records
from eldenet.studies import runner
from eldenet.studies.plan import Study, read_study
from eldenet.studies.runner import Outcome
from eldenet.train import TrainSettings

PLAN = """
overrides: [data=rooms]
learning_rates: [3.0e-4, 1.0e-3, 3.0e-3]
rate_overrides: [trainer.epochs=1]
rows:
  small: {overrides: [model=eldenet_s]}
  taught: {overrides: [model=eldenet_s, loss=ssim_l1_distill], given: {teacher: teacher}}
"""
GOOD = {3e-4: 0.4, 1e-3: 0.5, 3e-3: 0.3}
Curve = dict[float, float | None]


@pytest.fixture
def study(tmp_path: Path) -> Study:
    (tmp_path / "sweep.yaml").write_text(PLAN)
    return read_study(tmp_path)


class Trials:
    """Trainings whose delta1 is a function of the learning rate; ``tried`` are (rate, epochs)."""

    def __init__(self, curve: Curve) -> None:
        self.curve = curve
        self.tried: list[tuple[float, int]] = []

    def train(self, s: TrainSettings) -> None:
        settings, folder = asdict(s), Path(s.output)
        rate, score = settings["optimizer"]["lr"], self.curve[settings["optimizer"]["lr"]]
        if folder.name.startswith("lr"):
            self.tried.append((rate, settings["trainer"]["epochs"]))
        if score is None:
            raise FloatingPointError("diverged")
        folder.mkdir(parents=True, exist_ok=True)
        record = {"metrics": {"delta1": score, "images": 100}, "protocol": {"name": "p"}}
        record |= {"train_split_hash": "a", "split_hash": "b", "config": settings}
        record["sources"] = fingerprints(settings)
        (folder / "run.json").write_text(json.dumps(record))
        (folder / "per_image.csv").write_text("name\n")

    def run(
        self, study: Study, runs: Path, name: str = "small", rerun: bool = False, **given: object
    ) -> Outcome:
        row = study.chosen(name)[0]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(runner, "train", self.train)
            patch.setattr(runner, "check_finished", lambda folder, record, settings: None)
            return runner.run_row(study, row, runs, rerun=rerun, given=given, say=lambda text: None)[0]


def stored(folder: Path, name: str) -> dict[str, Any]:
    return read_records(folder / RUNS)[name]


def chosen(folder: Path, name: str = "small") -> float:
    return stored(folder, f"{name}/learning_rate")["learning_rate"]


@pytest.mark.parametrize(
    ("curve", "tried", "best"),
    [
        (GOOD, [3e-4, 1e-3, 3e-3], 1e-3),
        ({3e-4: 0.6, 1e-3: 0.5, 3e-3: 0.3, 1e-4: 0.5}, [3e-4, 1e-3, 3e-3, 1e-4], 3e-4),
        ({3e-4: 0.6, 1e-3: 0.5, 3e-3: 0.3, 1e-4: 0.7, 3e-5: 0.2}, [3e-4, 1e-3, 3e-3, 1e-4, 3e-5], 1e-4),
        ({3e-4: 0.1, 1e-3: 0.2, 3e-3: 0.3, 1e-2: 0.4, 3e-2: 0.5}, [3e-4, 1e-3, 3e-3, 1e-2, 3e-2], 3e-2),
        ({3e-4: 0.4, 1e-3: None, 3e-3: None, 1e-4: 0.3}, [3e-4, 1e-3, 3e-3, 1e-4], 3e-4),
    ],
)
def test_the_best_candidate_is_chosen_once(study, tmp_path, curve: Curve, tried, best: float) -> None:
    trials = Trials(curve)
    assert trials.run(study, tmp_path / "runs").status == "done"
    assert trials.tried == [(rate, 1) for rate in tried]
    assert chosen(tmp_path) == best
    kept = stored(tmp_path, "small/learning_rate")
    assert {float(rate): score for rate, score in kept["delta1"].items()} == curve
    assert stored(tmp_path, "small/seed0")["metrics"]["delta1"] == curve[best]
    trials.run(study, tmp_path / "elsewhere")
    assert len(trials.tried) == len(tried)


def test_trials_that_all_diverge_are_an_error(study, tmp_path) -> None:
    outcome = Trials(dict.fromkeys(GOOD)).run(study, tmp_path / "runs")
    assert "diverged: give lower ones" in outcome.reason


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("[3.0e-4, 1.0e-3, 3.0e-3]", "[1.0e-4, 1.0e-3]", "candidates"),
        ("trainer.epochs=1", "trainer.epochs=2", "trainer.epochs=2"),
        ("data=rooms", "data=rooms, augmentation=none", "augmentation.flip"),
    ],
)
def test_a_choice_by_another_rule_is_refused(study, tmp_path, old: str, new: str, word: str) -> None:
    trials = Trials(GOOD)
    trials.run(study, tmp_path / "runs")
    (tmp_path / "sweep.yaml").write_text(PLAN.replace(old, new))
    reason = trials.run(read_study(tmp_path), tmp_path / "runs").reason
    assert "chosen by another rule (" in reason
    assert word in reason


def test_given_weights_count_by_their_content(study, tmp_path) -> None:
    for name, content in (("a", b"1"), ("b", b"1"), ("c", b"2")):
        (tmp_path / name).write_bytes(content)

    def run(trials: Trials, name: str, runs: str = "runs", **options: bool) -> str:
        return trials.run(study, tmp_path / runs, "taught", teacher=tmp_path / name, **options).reason

    trials = Trials(GOOD)
    assert run(trials, "a") == run(trials, "b") == ""
    refused = run(trials, "c")
    assert "chosen by another rule" in refused
    assert "teacher" in refused
    assert "rerun=true" in refused
    assert run(trials, "b", rerun=True) == ""
    assert len(trials.tried) == 3  # a valid choice is not made again
    other = Trials({3e-4: 0.6, 1e-3: 0.5, 3e-3: 0.3, 1e-4: 0.2})
    assert run(other, "c", "other", rerun=True) == run(other, "c", "other") == ""
    assert chosen(tmp_path, "taught") == 3e-4


@pytest.mark.parametrize("place", ["{runs}/small/seed0", "{runs}/small/seed{seed}"])
def test_trials_wait_for_the_row_that_they_start_from(study, tmp_path, place: str) -> None:
    """A run that is still training has weights already, but not those that will be compared."""
    trials = Trials(GOOD)
    (tmp_path / "sweep.yaml").write_text(PLAN + f'  next: {{overrides: ["weights={place}"]}}\n')
    study = read_study(tmp_path)
    begun = tmp_path / "runs" / study.name / "small/seed0"
    (begun / "model").mkdir(parents=True)
    (begun / "model/model.safetensors").write_bytes(b"half")
    assert "next needs the weights of" in trials.run(study, tmp_path / "runs", "next").reason
    assert not trials.tried
    (begun / "run.json").write_text("{}")
    assert trials.run(study, tmp_path / "runs", "next").status == "done"

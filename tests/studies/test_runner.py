"""Studies from the plan to the tables: run, killed, resumed, run again."""

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.tiny_study import cells, run, run_all, short

from eldenet.benchmark import BenchmarkSettings, benchmark
from eldenet.compose import compose
from eldenet.deploy.benchmarking import measure as measuring
from eldenet.results.packed_runs import RUNS, add_record, read_records
from eldenet.studies.matching import run_overrides
from eldenet.studies.plan import read_study, training_settings
from eldenet.studies.report import write_study_report
from eldenet.study import StudySettings
from eldenet.study import study as run_study
from eldenet.system.files import sole_writer
from eldenet.train import TrainSettings, train


def add_to_plan(study: Path, text: str = "", old: str = "", new: str = "", one_seed: bool = False) -> None:
    """Append to ``sweep.yaml`` and replace in it."""
    plan = (study / "sweep.yaml").read_text()
    (study / "sweep.yaml").write_text((short(plan) if one_seed else plan).replace(old, new) + text)


@pytest.mark.slow
def test_a_study_is_trained_once_and_reported(tiny, tmp_path):
    first, said = run_all(tiny, tmp_path / "runs")
    assert first == {
        "eldenet_s/seed0": "done",
        "eldenet_s/seed1": "done",
        "wrong/seed0": "failed",
        "eldenet/seed0": "done",
        "elsewhere/seed0": "data not given",
        "pretrained/seed0": "weights not given",
    }
    assert any("monitor='accuracy'" in line for line in said)
    assert "accuracy" in (tmp_path / "runs/tiny/wrong/seed0/failed.txt").read_text()
    # the learning rate is chosen on a held-out part of the training split
    stored = read_records(tiny / RUNS)
    chosen = stored["eldenet_s/learning_rate"]
    scores = chosen["delta1"]
    assert chosen["learning_rate"] == float(max(scores, key=scores.get))
    assert chosen["held_out_images"] == 4
    record = stored["eldenet_s/seed1"]
    assert record["config"]["optimizer"]["lr"] == chosen["learning_rate"]
    assert (record["seed"], record["metrics"]["images"]) == (1, 6)
    assert record["split_hash"] != chosen["held_out_split_hash"]
    # nothing is trained twice, neither with the run folders nor with the stored results alone
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").rglob("*.safetensors")}
    expected = {name: "finished before" if word == "done" else word for name, word in first.items()}
    assert run_all(tiny, tmp_path / "runs")[0] == expected
    assert run_all(tiny, tmp_path / "other_runs")[0] == expected
    assert not list((tmp_path / "other_runs").rglob("*.safetensors"))
    assert before == {path: path.stat().st_mtime_ns for path in before}
    report_is_right(tiny)
    # other settings under the same name are another run
    add_to_plan(tiny, old="epochs=1", new="epochs=2")
    changed, said = run_all(tiny, tmp_path / "runs")
    assert changed["eldenet/seed0"] == "failed"
    assert any("trainer.epochs=2 (there 1)" in line for line in said)


def test_a_wrong_setting_of_a_later_row_shows_before_the_first_row_trains(tiny, tmp_path):
    add_to_plan(tiny, "  typed: {overrides: [model=eldenet_s, trainer.epohcs=2], learning_rate: 1.0e-3}\n")
    words = [f"study={tiny}", f"output={tmp_path / 'runs'}"]
    with pytest.raises(
        ValueError, match=r"row wrong: monitor='accuracy'.*; row typed: there is no setting trainer\.epohcs"
    ):
        run_study(compose(StudySettings, words))
    assert not (tmp_path / "runs").exists()


def report_is_right(folder: Path) -> None:
    write_study_report(folder)
    rows = cells(folder)
    stored = read_records(folder / RUNS)
    values = [stored[f"eldenet_s/seed{seed}"]["metrics"]["rmse"] for seed in (0, 1)]
    ours = rows["scratch/eldenet_s"]
    assert ours["RMSE [m] ↓"] == f"{np.mean(values):.3f}"
    assert ours["RMSE std"] == f"{np.std(values, ddof=1):.3f}"
    assert {name: row["seeds"] for name, row in rows.items() if "constant" not in name} == {
        "scratch/eldenet_s": "2",
        "scratch/wrong": "not run",
        "scratch/eldenet": "1",
        "scratch/elsewhere": "data not given",
        "rooms/pretrained": "weights not given",
        "scratch/unknown": "no code identified",
    }
    assert rows["scratch/eldenet"]["published delta1"] == "0.9"
    assert rows["scratch/eldenet"]["published source"] == "a paper"
    assert rows["scratch/unknown"]["published source"] == "no code identified"
    assert float(rows["scratch/eldenet"]["low"]) < float(rows["scratch/eldenet"]["high"])
    assert ours["delta1 - eldenet_s's [95 %]"] == ""  # the reference itself
    text = (folder / "results.md").read_text()
    for part in ("protocol rooms", "### scratch: published elsewhere"):
        assert part in text
    assert "### rooms: published" not in text
    for name in ("results.tex", "pareto.png"):
        assert (folder / name).stat().st_size > 200


@pytest.mark.slow
def test_a_row_of_another_study_is_run_once(tiny, tmp_path):
    add_to_plan(tiny, one_seed=True)
    other = tmp_path / "other"
    other.mkdir()
    (other / "sweep.yaml").write_text("rows: {eldenet: {from: tiny, block: another}}")
    ours, theirs = read_study(other), read_study(tiny)
    (taken,), (row,) = ours.rows, theirs.chosen("eldenet")
    assert (taken.block, taken.overrides) == ("another", row.overrides)
    assert [one.status for one in run(ours, "eldenet", tmp_path / "runs")] == ["done"]
    assert [one.status for one in run(theirs, "eldenet", tmp_path / "runs")] == ["finished before"]
    write_study_report(other)
    assert cells(other)["another/eldenet"]["seeds"] == "1"
    assert not (other / RUNS).exists()


def test_a_study_is_found_from_inside_its_folder(tiny, tmp_path, monkeypatch):
    """``study=.`` is that folder by its name: the same runs, the same rows of its neighbors."""
    other = tmp_path / "other"
    (other / "deeper").mkdir(parents=True)
    (other / "sweep.yaml").write_text("rows: {eldenet: {from: tiny}}")
    monkeypatch.chdir(other)
    study = read_study(".")
    (row,) = study.rows
    assert (study.name, row.owner.name) == ("other", "tiny")
    assert study.owner_of(row).folder.resolve() == tiny
    write_study_report(".")
    assert cells(other)["scratch/eldenet"]["seeds"] == "not run"
    text = (other / "results.md").read_text()
    assert text.startswith("# other\n")
    assert "study=other`" in text
    monkeypatch.chdir(other / "deeper")
    assert read_study("..").name == "other"


@pytest.mark.slow
def test_each_different_network_of_a_study_is_measured_once(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(measuring, "PEAK_SIDE", 64)  # a small product for the processor's peak
    (tiny / "sweep.yaml").write_text(re.sub(r"  elsewhere:.*\n", "", (tiny / "sweep.yaml").read_text()))
    rows = "  same: {overrides: [model=eldenet_s, loss=l1_sparse], learning_rate: 1.0e-3}\n"
    rows += "  plain: {overrides: [model=eldenet_s, model.backbone.shortcuts=false]}\n"
    rows += '  larger: {overrides: [model=eldenet_s, "data.input_size=[64,80]"]}\nlatency: benchmark.csv\n'
    add_to_plan(tiny, rows, one_seed=True)
    run(read_study(tiny), "same", tmp_path / "runs")

    def measure(*words: str, output: str = "out") -> list[dict]:
        options = [f"study={tiny}", "rounds=1", "seconds=0.01", "memory=false"]
        return benchmark(compose(BenchmarkSettings, [*options, *words, f"output={tmp_path / output}"]))

    rows = measure("runtimes=[torch]")
    networks = [("eldenet_s", 32), ("eldenet", 32), ("plain", 32), ("larger", 64)]
    assert [(line["model"], line["height"]) for line in rows] == networks
    with (tiny / "benchmark.csv").open(newline="") as lines:
        measured = {line["row"]: line for line in csv.DictReader(lines)}
    assert measured["same"]["latency_ms_p50"] == measured["eldenet_s"]["latency_ms_p50"]
    assert (measured["larger"]["height"], measured["larger"]["width"]) == ("64", "80")
    assert measured["larger"]["latency_ms_p50"] != measured["eldenet_s"]["latency_ms_p50"]
    assert json.loads(measured["plain"]["network"])["backbone"]["shortcuts"] is False
    assert float(measured["same"]["latency_ms_p50"]) == rows[0]["latency_ms_p50"]
    write_study_report(tiny)
    assert cells(tiny)["scratch/same"]["latency [ms] (torch) ↓"] == f"{rows[0]['latency_ms_p50']:.2f}"
    assert "input 32 x 40 or 64 x 80, each row at its own" in (tiny / "results.md").read_text()
    again = measure("runtimes=[torch]")
    assert [line["date"] for line in again] == [line["date"] for line in rows]  # not measured again
    with pytest.raises(ValueError, match="give one value each for runtimes"):
        measure()
    before = (tiny / "benchmark.csv").read_bytes()
    with pytest.raises(ValueError, match=r"no latency of tiny was measured.* was not changed"):
        measure("runtimes=[torch]", "precisions=[fp16]", output="none")
    assert (tiny / "benchmark.csv").read_bytes() == before
    (tiny / "benchmark.csv").write_bytes(before.splitlines(keepends=True)[0])
    with pytest.raises(ValueError, match="has no line: eldenet benchmark"):
        write_study_report(tiny)
    add_to_plan(tiny, old='"data.input_size=[64,80]"', new="data.input_size=null")
    with pytest.raises(ValueError, match=r"row larger: data\.input_size is null"):
        measure("runtimes=[torch]")
    add_to_plan(tiny, old="latency: bench", new="latency: ../other/bench")
    with pytest.raises(ValueError, match=r"shows the latencies of another study.*: measure that one"):
        measure("runtimes=[torch]")


@pytest.mark.slow
def test_a_killed_run_resumes(tiny, tmp_path):
    """A run folder without run.json holds a checkpoint to resume from."""
    study = read_study(tiny)
    assert run(study, "eldenet", tmp_path / "runs")[0].status == "done"
    folder = tmp_path / "runs/tiny/eldenet/seed0"
    weights = (folder / "model/model.safetensors").stat().st_mtime_ns
    (folder / "run.json").unlink()
    (tiny / RUNS).unlink()
    assert run(study, "eldenet", tmp_path / "runs")[0].status == "done"
    assert (folder / "model/model.safetensors").stat().st_mtime_ns == weights  # not trained again
    assert len(read_records(tiny / RUNS)["eldenet/seed0"]["per_image"]["name"]) == 6
    # a finished run is left as it is; with other settings it is refused
    shared = [*study.overrides_of(study.chosen("eldenet")[0]), "optimizer.lr=1.0e-3"]
    before = (folder / "run.json").read_bytes()
    train(compose(TrainSettings, run_overrides(shared, folder, tmp_path, name="eldenet", seed=0)))
    assert (folder / "run.json").read_bytes() == before
    for other, word in (("optimizer.lr=0.5", "optimizer.lr"), ("data.frames.train=12", "data.frames.train")):
        changed = run_overrides([*shared, other], folder, tmp_path, name="eldenet", seed=0)
        with pytest.raises(ValueError, match=rf"holds a finished run with other settings: {word}"):
            train(compose(TrainSettings, changed))
    (folder / "run.json").unlink()  # as if it had been killed before its end
    changed = run_overrides([*shared, "loss=l1_sparse"], folder, tmp_path, name="eldenet", seed=0)
    with pytest.raises(ValueError, match=r"run begun with other settings: loss"):
        train(compose(TrainSettings, changed))


def test_a_message_names_the_setting_that_a_row_needs(tiny, tmp_path):
    """A name that configs/study.yaml does not have needs Hydra's plus."""
    add_to_plan(tiny, "  mine: {given: {mine: data.root}}\n")
    study, said = read_study(tiny), []
    given = compose(StudySettings, [f"study={tiny}"]).given
    for name in ("elsewhere", "mine"):
        run(study, name, tmp_path / "runs", said.append, given=given)
    assert [line.partition("(")[2] for line in said] == ["given.kitti=...)", "+given.mine=...)"]
    for word in ("given.kitti=/data", "+given.mine=/data"):
        assert "/data" in compose(StudySettings, [f"study={tiny}", word]).given.values()


def test_a_row_is_run_by_one_process_at_a_time(tiny, tmp_path):
    study, folder = read_study(tiny), tmp_path / "runs/tiny/eldenet"
    with sole_writer(folder):
        outcomes = run(study, "eldenet", tmp_path / "runs")
    assert [outcome.status for outcome in outcomes] == ["running elsewhere"]
    assert not (tiny / RUNS).exists()
    with sole_writer(folder):
        pass


@pytest.mark.slow
def test_a_row_that_starts_from_another_needs_its_weights(tiny, tmp_path):
    start = '"weights={runs}/eldenet_s/seed0"'
    row = f"  next: {{overrides: [model=eldenet_s, {start}], learning_rate: 1.0e-3}}\n"
    add_to_plan(tiny, row, one_seed=True)
    study = read_study(tiny)

    def status(name: str, runs: str, **options: bool) -> str:
        outcome = run(study, name, tmp_path / runs, **options)[0]
        assert outcome.status != "failed" or "rerun=true" in outcome.reason
        return f"{outcome.status} {outcome.reason}".strip()

    assert "needs the weights of" in status("next", "runs")
    assert [status(name, "runs") for name in ("eldenet_s", "next")] == ["done", "done"]
    record = read_records(tiny / RUNS)["next/seed0"]
    assert len(record["sources"]["weights"]) == 16
    # elsewhere both are finished, though no weights lie there; rerun trains the first for its weights
    assert [status(name, "elsewhere") for name in ("eldenet_s", "next")] == ["finished before"] * 2
    assert status("eldenet_s", "elsewhere", rerun=True) == "done"
    model = Path("seed0/model")
    weights = tmp_path / "elsewhere/tiny/eldenet_s" / model
    assert (weights / "model.safetensors").is_file()
    assert status("next", "elsewhere") == "finished before"  # the same weights: the same seed and steps
    shutil.copytree(tmp_path / "runs/tiny/next" / model, weights, dirs_exist_ok=True)
    assert "weights=" in status("next", "elsewhere")
    assert status("next", "elsewhere", rerun=True) == "done"  # from these weights, and stored instead
    assert status("next", "elsewhere") == "finished before"
    again = read_records(tiny / RUNS)["next/seed0"]
    assert again["sources"] != record["sources"]


def test_without_its_frames_a_stored_run_is_compared_by_settings(tmp_path, monkeypatch):
    """A fresh clone has the results, not the data."""
    monkeypatch.delenv("ELDENET_DATA", raising=False)
    plan = "rows: {small: {overrides: [data=nyu_labelled, model=eldenet_s]}}"
    (tmp_path / "sweep.yaml").write_text(plan)
    study, said = read_study(tmp_path), []
    settings = training_settings(
        run_overrides(study.rows[0].overrides, tmp_path, tmp_path, name="small", seed=0)
    )
    add_record(tmp_path, "small/seed0", {"metrics": {}, "config": settings})
    (outcome,) = run(study, "small", tmp_path / "runs", said.append)
    assert outcome.status == "finished before"
    assert "not here to be compared" in said[-1]
    (tmp_path / "sweep.yaml").write_text(plan.replace("model=eldenet_s", "model=eldenet_s, trainer.epochs=3"))
    (outcome,) = run(read_study(tmp_path), "small", tmp_path / "runs")
    assert outcome.status == "failed"
    assert "trainer.epochs=3" in outcome.reason
    assert "rerun=true" in outcome.reason

"""Studies: planned, run, killed, rerun and reported."""

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.tiny_study import cells, run_all, short

from eldenet import config as cfg
from eldenet.config import build_training
from eldenet.deploy.benchmarking.run import benchmark
from eldenet.results.studies.matching import compose_run
from eldenet.results.studies.plan import read_study
from eldenet.results.studies.report import write_study_report
from eldenet.results.studies.runner import run_row, sole
from eldenet.training.run import train


def test_a_study_from_nothing_to_its_tables(tiny, tmp_path):
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
    assert "accuracy" in (tmp_path / "runs" / "tiny" / "wrong" / "seed0" / "failed.txt").read_text()
    # the learning rate: by the held-out part of the training split, and recorded
    chosen = json.loads((tiny / "stored" / "eldenet_s" / "learning_rate.json").read_text())
    scores = chosen["delta1"]
    assert chosen["learning_rate"] == float(max(scores, key=scores.get))
    assert chosen["held_out_images"] == 4
    run = json.loads((tiny / "stored" / "eldenet_s" / "seed1" / "run.json").read_text())
    assert run["config"]["optimizer"]["lr"] == chosen["learning_rate"]
    assert (run["seed"], run["metrics"]["images"]) == (1, 6)
    assert run["split_hash"] != chosen["held_out_split_hash"]
    # again: nothing is trained twice, from the run folders or from what was stored
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").rglob("*.safetensors")}
    again, _ = run_all(tiny, tmp_path / "runs")
    assert again == {
        name: "finished before" if status == "done" else status for name, status in first.items()
    }
    elsewhere, _ = run_all(tiny, tmp_path / "other_runs")
    assert elsewhere == again
    assert not list((tmp_path / "other_runs").rglob("*.safetensors"))
    assert before == {path: path.stat().st_mtime_ns for path in before}
    report_is_right(tiny)
    # other settings under the same name are no finished run
    (tiny / "sweep.yaml").write_text((tiny / "sweep.yaml").read_text().replace("epochs=1", "epochs=2"))
    changed, said = run_all(tiny, tmp_path / "runs")
    assert changed["eldenet/seed0"] == "failed"
    assert any("trainer.epochs=2 (there 1)" in line for line in said)


def report_is_right(folder: Path) -> None:
    write_study_report(folder)
    rows = cells(folder)
    runs = [json.loads((folder / f"stored/eldenet_s/seed{seed}/run.json").read_text()) for seed in (0, 1)]
    values = [run["metrics"]["rmse"] for run in runs]
    ours = rows["scratch/eldenet_s"]
    assert ours["RMSE [m] ↓"] == f"{np.mean(values):.3f} ± {np.std(values, ddof=1):.3f}"
    assert ours["seeds"] == "2"
    assert rows["scratch/wrong"]["seeds"] == "not run"
    assert rows["scratch/elsewhere"]["seeds"] == "data not given"
    assert rows["rooms/pretrained"]["seeds"] == "weights not given"
    assert rows["scratch/unknown"]["seeds"] == "no code identified"
    assert rows["scratch/eldenet"]["published delta1"] == "0.9"
    assert rows["scratch/eldenet"]["published source"] == "a paper"
    assert rows["scratch/unknown"]["published source"] == "no code identified"
    assert rows["scratch/eldenet"]["delta1 - eldenet_s's [95 %]"].count(",") == 1
    assert ours["delta1 - eldenet_s's [95 %]"] == "-"
    text = (folder / "results.md").read_text()
    assert "protocol rooms" in text
    assert "### scratch: published elsewhere" in text
    assert "### rooms: published" not in text
    assert "## convergence" in text
    for name in ("results.tex", "pareto.png", "convergence.png"):
        assert (folder / name).stat().st_size > 200
    assert (
        (folder / "convergence.csv").read_text().splitlines()[1].startswith("eldenet_s/seed0,training loss,")
    )


def test_a_row_of_another_study_is_run_once(tiny, tmp_path):
    (tiny / "sweep.yaml").write_text(short((tiny / "sweep.yaml").read_text()))
    other = tmp_path / "other"
    other.mkdir()
    (other / "sweep.yaml").write_text("rows: {eldenet: {from: tiny, block: another}}")
    ours, theirs = read_study(other), read_study(tiny)
    (taken,), (row,) = ours.rows, theirs.chosen("eldenet")
    assert (taken.block, taken.overrides) == ("another", row.overrides)
    assert [one.status for one in run_row(ours, taken, tmp_path / "runs")] == ["done"]
    assert [one.status for one in run_row(theirs, row, tmp_path / "runs")] == ["finished before"]
    write_study_report(other)
    assert cells(other)["another/eldenet"]["seeds"] == "1"
    assert not (other / "stored").exists()
    (other / "sweep.yaml").write_text("rows: {eldenet: {from: tiny, seeds: [1]}}")
    with pytest.raises(ValueError, match="row eldenet, taken from another study: unknown entries"):
        read_study(other)
    (other / "sweep.yaml").write_text("rows: {unknown: {from: tiny}}")
    with pytest.raises(ValueError, match="has the rows eldenet_s, wrong"):
        read_study(other)


def test_a_study_from_inside_its_folder(tiny, tmp_path, monkeypatch):
    """``study=.`` is that folder by its name: the same runs, the same rows of its neighbors."""
    other = tmp_path / "other"
    other.mkdir()
    (other / "sweep.yaml").write_text("rows: {eldenet: {from: tiny}}")
    monkeypatch.chdir(other)
    study = read_study(".")
    (row,) = study.rows
    assert (study.name, row.owner.name) == ("other", "tiny")
    assert study.stored(row, 0).resolve() == tiny / "stored" / "eldenet" / "seed0"
    write_study_report(".")
    assert cells(other)["scratch/eldenet"]["seeds"] == "not run"
    text = (other / "results.md").read_text()
    assert text.startswith("# other\n")
    assert "study=other`" in text
    (tmp_path / "other/deeper").mkdir()
    monkeypatch.chdir(tmp_path / "other/deeper")
    assert read_study("..").name == "other"
    (other / "sweep.yaml").write_text("rows: {eldenet: {from: other}}")
    with pytest.raises(ValueError, match="in a circle: other -> other"):
        read_study("..")


def test_latencies_of_a_study(tiny, tmp_path):
    """Each different network is measured once; the table and the plot show it for every row with it."""
    plan = re.sub(r"  elsewhere:.*\n", "", (tiny / "sweep.yaml").read_text())
    plan += "  same: {overrides: [model=eldenet_s, loss=l1_sparse], learning_rate: 1.0e-3}\n"
    plan += "  plain: {overrides: [model=eldenet_s, model.backbone.shortcuts=false]}\n"
    plan += '  larger: {overrides: [model=eldenet_s, "data.input_size=[64,80]"]}\n'
    (tiny / "sweep.yaml").write_text(short(plan) + "latency: benchmark.csv\n")
    row = read_study(tiny).chosen("same")[0]
    run_row(read_study(tiny), row, tmp_path / "runs")
    options = [
        f"study={tiny}",
        "runtimes=[torch]",
        "rounds=1",
        "seconds=0.01",
        "memory=false",
    ]
    rows = benchmark(cfg.build_benchmark(cfg.compose("benchmark", [*options, f"output={tmp_path / 'out'}"])))
    assert [(line["model"], line["height"]) for line in rows] == [
        ("eldenet_s", 32),
        ("eldenet", 32),
        ("plain", 32),
        ("larger", 64),  # eldenet_s at its own input
    ]
    with (tiny / "benchmark.csv").open(newline="") as lines:
        measured = {line["row"]: line for line in csv.DictReader(lines)}
    assert measured["same"]["latency_ms_p50"] == measured["eldenet_s"]["latency_ms_p50"]
    assert (measured["larger"]["height"], measured["larger"]["width"]) == ("64", "80")
    assert measured["larger"]["latency_ms_p50"] != measured["eldenet_s"]["latency_ms_p50"]
    assert json.loads(measured["plain"]["network"])["backbone"]["shortcuts"] is False
    assert float(measured["same"]["latency_ms_p50"]) == rows[0]["latency_ms_p50"]
    write_study_report(tiny)
    assert cells(tiny)["scratch/same"]["latency [ms] (torch) ↓"] == f"{rows[0]['latency_ms_p50']:.2f}"
    again = benchmark(cfg.build_benchmark(cfg.compose("benchmark", [*options, f"output={tmp_path / 'out'}"])))
    assert [line["date"] for line in again] == [line["date"] for line in rows]  # recognized, not measured
    assert len((tmp_path / "out" / "rows.jsonl").read_text().splitlines()) == len(rows)
    assert "input 32 x 40 or 64 x 80, each row at its own" in (tiny / "results.md").read_text()
    with pytest.raises(ValueError, match="give one value of runtimes"):
        benchmark(cfg.build_benchmark(cfg.compose("benchmark", [f"study={tiny}"])))
    before = (tiny / "benchmark.csv").read_bytes()
    with pytest.raises(ValueError, match=r"no network of tiny has a latency.* stays as it is"):
        benchmark(
            cfg.build_benchmark(
                cfg.compose("benchmark", [*options, f"output={tmp_path / 'none'}", "precisions=[fp16]"])
            )
        )
    assert (tiny / "benchmark.csv").read_bytes() == before
    (tiny / "benchmark.csv").write_text("row,latency_ms_p50\n")
    with pytest.raises(ValueError, match="has no line: python -m eldenet"):
        write_study_report(tiny)
    plan = (tiny / "sweep.yaml").read_text()
    (tiny / "sweep.yaml").write_text(plan.replace("latency: bench", "latency: ../other/bench"))
    with pytest.raises(ValueError, match=r"shows the latencies of another study.*: measure that one"):
        benchmark(cfg.build_benchmark(cfg.compose("benchmark", options)))
    whole = plan.replace('"data.input_size=[64,80]"', "data.input_size=null")
    (tiny / "sweep.yaml").write_text(whole)
    with pytest.raises(ValueError, match=r"row larger: data\.input_size is null"):
        benchmark(cfg.build_benchmark(cfg.compose("benchmark", options)))


def test_a_killed_row_goes_on(tiny, tmp_path):
    """What lies in a run folder without run.json is a checkpoint to go on from."""
    study = read_study(tiny)
    (row,) = study.chosen("eldenet")
    assert run_row(study, row, tmp_path / "runs", say=lambda text: None)[0].status == "done"
    folder = tmp_path / "runs" / "tiny" / "eldenet" / "seed0"
    weights = (folder / "model" / "model.safetensors").stat().st_mtime_ns
    (folder / "run.json").unlink()
    shutil.rmtree(tiny / "stored")
    assert run_row(study, row, tmp_path / "runs", say=lambda text: None)[0].status == "done"
    assert (folder / "model" / "model.safetensors").stat().st_mtime_ns == weights  # not trained anew
    assert (tiny / "stored" / "eldenet" / "seed0" / "per_image.csv").is_file()
    # a finished training asked to go on is left as it is; with other settings it is refused
    shared = [*study.overrides, *row.overrides, f"optimizer.lr={row.learning_rate}"]
    again = compose_run(shared, folder, tmp_path, name="eldenet", seed=0)
    before = (folder / "run.json").read_bytes()
    assert train(build_training(again, folder)) == json.loads(before)["training"]["best_value"]
    assert (folder / "run.json").read_bytes() == before
    for other, word in (("optimizer.lr=0.5", "optimizer.lr"), ("data.frames.train=12", "data.frames.train")):
        changed = compose_run([*shared, other], folder, tmp_path, name="eldenet", seed=0)
        with pytest.raises(ValueError, match=rf"holds a finished run of other settings: {word}"):
            train(build_training(changed, folder))


def test_a_run_begun_with_other_settings_does_not_go_on(tiny, tmp_path):
    study = read_study(tiny)
    (row,) = study.chosen("eldenet")
    shared = [*study.overrides, *row.overrides, "trainer.epochs=2", f"optimizer.lr={row.learning_rate}"]
    folder = tmp_path / "runs" / "tiny" / "eldenet" / "seed0"
    train(build_training(compose_run(shared, folder, tmp_path, name="eldenet", seed=0), folder))
    (folder / "run.json").unlink()  # killed before its end, as far as the folder tells
    changed = compose_run([*shared, "loss=l1_sparse"], folder, tmp_path, name="eldenet", seed=0)
    with pytest.raises(ValueError, match=r"run begun with other settings: loss"):
        train(build_training(changed, folder))


def test_what_a_row_asks_for_is_said_as_hydra_takes_it(tiny, tmp_path):
    """A name that configs/study.yaml does not have needs Hydra's plus."""
    plan = (tiny / "sweep.yaml").read_text()
    (tiny / "sweep.yaml").write_text(plan + "  mine: {given: {mine: data.root}}\n")
    study, said = read_study(tiny), []
    given = cfg.plain(cfg.compose("study", [f"study={tiny}"]).given)
    for row in study.chosen(["elsewhere", "mine"]):
        run_row(study, row, tmp_path / "runs", given=given, say=said.append)
    assert [line.partition("(")[2] for line in said] == ["given.kitti=...)", "+given.mine=...)"]
    for word in ("given.kitti=/data", "+given.mine=/data"):
        assert "/data" in cfg.plain(cfg.compose("study", [f"study={tiny}", word]).given).values()


def test_one_process_a_row(tiny, tmp_path):
    study = read_study(tiny)
    (row,) = study.chosen("eldenet")
    with sole(tmp_path / "runs" / "tiny" / "eldenet") as free:
        assert free
        outcomes = run_row(study, row, tmp_path / "runs", say=lambda text: None)
    assert [outcome.status for outcome in outcomes] == ["running elsewhere"]
    assert not (tiny / "stored").exists()
    with sole(tmp_path / "runs" / "tiny" / "eldenet") as free:
        assert free


def test_rows_that_start_from_others(tiny, tmp_path):
    """Weights are not stored: a row that needs another one's says so, and what to do."""
    plan = (tiny / "sweep.yaml").read_text()
    plan += (
        '  next: {overrides: [model=eldenet_s, "weights={runs}/eldenet_s/seed0"], learning_rate: 1.0e-3}\n'
    )
    (tiny / "sweep.yaml").write_text(short(plan))
    study = read_study(tiny)
    (first,), (second,) = study.chosen("eldenet_s"), study.chosen("next")

    def run(row, runs, **options):
        return run_row(study, row, tmp_path / runs, say=lambda text: None, **options)[0]

    outcome = run(second, "runs")
    assert outcome.status == "failed"
    assert "needs the weights of" in outcome.reason
    assert "rerun=true" in outcome.reason
    assert [run(row, "runs").status for row in (first, second)] == ["done", "done"]
    record = json.loads((tiny / "stored/next/seed0/run.json").read_text())
    assert len(record["sources"]["weights"]) == 16
    # elsewhere both are finished, though no weights lie there; a new training of the first leaves its own
    assert [run(row, "elsewhere").status for row in (first, second)] == ["finished before"] * 2
    assert run(first, "elsewhere", rerun=True).status == "done"
    assert (tmp_path / "elsewhere/tiny/eldenet_s/seed0/model/model.safetensors").is_file()
    assert run(second, "elsewhere").status == "finished before"  # the same weights: the same seed and steps
    other = tmp_path / "elsewhere/tiny/eldenet_s/seed0/model/model.safetensors"
    shutil.copyfile(tmp_path / "runs/tiny/next/seed0/model/model.safetensors", other)
    outcome = run(second, "elsewhere")
    assert outcome.status == "failed"
    assert "weights=" in outcome.reason
    assert "rerun=true" in outcome.reason
    assert run(second, "elsewhere", rerun=True).status == "done"  # from these weights, and stored instead
    assert run(second, "elsewhere").status == "finished before"
    again = json.loads((tiny / "stored/next/seed0/run.json").read_text())
    assert again["sources"] != record["sources"]


def test_without_its_frames_a_stored_run_is_finished(tmp_path, monkeypatch):
    """A fresh clone has the results, not the data: the settings tell."""
    monkeypatch.delenv("ELDENET_DATA", raising=False)
    plan = "rows: {small: {overrides: [data=nyu_labelled, model=eldenet_s]}}"
    (tmp_path / "sweep.yaml").write_text(plan)
    study, said = read_study(tmp_path), []
    (row,) = study.rows
    config = compose_run(row.overrides, tmp_path, tmp_path, name="small", seed=0)
    folder = study.stored(row, 0)
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps({"metrics": {}, "config": cfg.plain(config)}))
    (folder / "per_image.csv").write_text("name\n")
    (outcome,) = run_row(study, row, tmp_path / "runs", say=said.append)
    assert outcome.status == "finished before"
    assert "not here to be compared" in said[-1]
    (tmp_path / "sweep.yaml").write_text(plan.replace("model=eldenet_s", "model=eldenet_s, trainer.epochs=3"))
    study = read_study(tmp_path)
    (outcome,) = run_row(study, study.rows[0], tmp_path / "runs", say=said.append)
    assert outcome.status == "failed"
    assert "trainer.epochs=3" in outcome.reason
    assert "rerun=true" in outcome.reason

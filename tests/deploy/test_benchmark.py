"""The efficiency table: columns, ratios, failures, and resuming."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

import eldenet
from eldenet.benchmark import DEFAULT_REFERENCE, BenchmarkSettings, benchmark, load_models
from eldenet.compose import compose
from eldenet.deploy.benchmarking import measure
from eldenet.deploy.benchmarking.measure import COLUMNS, Case
from eldenet.deploy.benchmarking.rows import append_rows, read_rows
from eldenet.deploy.benchmarking.tables import draw, notes_of, read_accuracies
from eldenet.deploy.fold import fold
from eldenet.evaluation.cost import count_macs, count_params
from eldenet.system.timing import time_interleaved

pytest.importorskip("onnxruntime")

NAMES = (
    "model,height,width,batch,runtime,precision,threads,device,params,gmacs,gflops,latency_ms_p50,"
    "latency_ms_p95,fps,throughput_img_s,peak_memory_mb,file_mb,gflops_per_s,share_of_peak,ratio_latency"
)
TINY = (
    *("models=[eldenet_s]", "sizes=[[32,48]]", "batches=[2]", "runtimes=[torch,onnxruntime]"),
    *("precisions=[fp32,bf16]", "reference=eldenet_s", "rounds=2", "seconds=0.001", "memory=false"),
)


def run(output: Path, *overrides: str) -> list[dict[str, Any]]:
    return benchmark(compose(BenchmarkSettings, [*TINY, f"output='{output}'", *overrides]))


@pytest.fixture(autouse=True, scope="module")
def small_peak() -> Iterator[None]:
    """Measure the processor's peak by a small product."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "PEAK_SIDE", 64)
        yield


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("benchmark")
    run(folder)
    return folder


def rows_of(output: Path) -> list[dict[str, Any]]:
    return list(read_rows(output).values())


def test_the_columns_keep_their_names_and_order(output: Path) -> None:
    assert ",".join(COLUMNS) == NAMES
    with (output / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert ",".join(rows[0]) == NAMES
    assert [(row["runtime"], row["precision"]) for row in rows] == [
        *(("torch", "fp32"), ("torch", "bf16"), ("onnxruntime", "fp32"), ("onnxruntime", "bf16"))
    ]


def test_figures_agree_with_each_other(output: Path) -> None:
    model = eldenet.load("eldenet_s")
    run_gmacs = count_macs(fold(model), (32, 48)) / 1e9  # folded up-convolutions have 36 taps for 25
    for row in rows_of(output):
        assert row["params"] == count_params(model)
        assert row["gmacs"] == count_macs(model, (32, 48)) / 1e9
        assert row["gflops"] == 2 * row["gmacs"]
        if row["failed"]:
            continue
        assert 0 < row["latency_ms_p50"] <= row["latency_ms_p95"]
        assert row["fps"] == pytest.approx(1e3 / row["latency_ms_p50"])
        assert row["throughput_img_s"] == pytest.approx(2 * row["fps"])
        assert row["gflops_per_s"] == pytest.approx(2 * run_gmacs * row["throughput_img_s"])
        assert row["share_of_peak"] == pytest.approx(row["gflops_per_s"] / row["peak_gflops_per_s"])
        assert row["file_mb"] > 0.5
        assert (row["ratio_latency"] == 1) == (row["precision"] == "fp32")
        assert row["versions"]["torch"]
        assert row["processor"]


def test_a_failed_row_keeps_its_reason(output: Path) -> None:
    (failed,) = (row for row in rows_of(output) if row["failed"])
    assert (failed["runtime"], failed["precision"]) == ("onnxruntime", "bf16")
    assert failed["latency_ms_p50"] is None
    for name in ("results.md", "results.tex"):
        text = (output / name).read_text()
        assert "not measured: eldenet_s, onnxruntime, bf16" in text.replace("\\_", "_")
    assert "bf16 runs under OpenVINO" in (output / "results.md").read_text()


@pytest.mark.slow
def test_a_killed_benchmark_resumes(output: Path, capsys: pytest.CaptureFixture) -> None:
    before = (output / "rows.jsonl").read_text()
    first = [row["date"] for row in rows_of(output) if row["runtime"] == "torch"]
    run(output)
    assert (output / "rows.jsonl").read_text() == before
    assert capsys.readouterr().out.count("measured before") == 2
    # after a kill in the last group the whole group is measured again
    lines = before.splitlines(keepends=True)
    (output / "rows.jsonl").write_text("".join(lines[:-1]) + lines[-1][:40])
    rows = run(output)
    assert len(rows) == 4
    assert capsys.readouterr().out.count("measured before") == 1
    assert [row["date"] for row in rows if row["runtime"] == "torch"] == first
    again = run(output, "overwrite=true", "runtimes=[torch]", "precisions=[fp32]")
    assert len(again) == 1
    assert again[0]["date"] >= max(first)


def named(folder: Path, scale: float) -> Path:
    """A trained network called "mine"."""
    model = eldenet.load("eldenet_s")
    with torch.no_grad():
        for weights in model.parameters():
            weights.fill_(scale)
    return model.save_pretrained(folder, info={"model_name": "mine"})


@pytest.mark.slow
def test_another_network_of_the_same_name_is_measured(tmp_path: Path) -> None:
    first, second = named(tmp_path / "a", 0.01), named(tmp_path / "b", 0.02)
    words = ("runtimes=[onnxruntime]", "precisions=[fp32]", "reference=mine")
    (row,) = run(tmp_path / "table", f"models=['{first}']", *words)
    (other,) = run(tmp_path / "table", f"models=['{second}']", *words)
    (again,) = run(tmp_path / "table", f"models=['{first}']", *words)
    assert row["fingerprint"] != other["fingerprint"]
    assert again == row
    assert len(list((tmp_path / "table/exports").glob("mine-*.onnx"))) == 2


@pytest.mark.slow
def test_rows_of_other_settings_do_not_count(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    words = ("runtimes=[torch]", "precisions=[fp32]")
    (first,) = run(tmp_path, *words)
    (quick,) = run(tmp_path, *words, "rounds=1")
    assert (first["rounds"], quick["rounds"]) == (2, 1)
    assert run(tmp_path, *words) == [first]
    # a missing row is measured in turns with its group; the row that was there stays
    rows = run(tmp_path, "runtimes=[torch]", "precisions=[fp32,bf16]")
    assert rows[0] == first
    assert rows[1]["precision"] == "bf16"
    assert rows[1]["ratio_latency"] > 0
    capsys.readouterr()
    assert BenchmarkSettings().reference == DEFAULT_REFERENCE
    (row,) = run(tmp_path, *words, f"reference={DEFAULT_REFERENCE}")
    assert row["ratio_latency"] is None
    assert "is not among the models: no ratio_latency" in capsys.readouterr().out


def test_a_row_without_memory_is_measured_again_where_memory_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measure, "memory_of", lambda *_: 7.0)
    words = ("runtimes=[torch]", "precisions=[fp32]")
    run(tmp_path, *words)
    (row,) = run(tmp_path, *words, "memory=true")
    assert row["peak_memory_mb"] == 7.0
    assert run(tmp_path, *words) == [row]


@pytest.mark.slow
def test_a_ratio_is_to_the_reference_of_its_table(tmp_path: Path) -> None:
    first, second = named(tmp_path / "a", 0.01), named(tmp_path / "b", 0.02)
    words = ("runtimes=[torch]", "precisions=[fp32]", "reference=mine")
    table = tmp_path / "table"
    reference, alone = (row["fingerprint"] for row in run(table, f"models=['{first}',eldenet_s]", *words))
    for source in (first, second):
        rows = run(table, f"models=['{source}',eldenet_s]", *words)
        assert [row["ratio_to"] for row in rows] == [rows[0]["fingerprint"]] * 2
    assert rows[0]["fingerprint"] != reference
    assert rows[1]["fingerprint"] == alone
    # a table without the reference, then one with it
    words = ("runtimes=[torch]", "precisions=[fp32]", f"reference={DEFAULT_REFERENCE}")
    (row,) = run(table, "models=[eldenet_s]", *words)
    assert row["ratio_latency"] is None
    assert not any("ratio_latency" in note for note in notes_of([row]))
    assert all(row["ratio_latency"] for row in run(table, f"models=[eldenet_s,{DEFAULT_REFERENCE}]", *words))
    # of other precisions alone, then with the reference's
    assert run(table, "precisions=[bf16]", "runtimes=[torch]")[0]["ratio_latency"] is None
    assert all(row["ratio_latency"] for row in run(table, "precisions=[bf16,fp32]", "runtimes=[torch]"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"processor": "a board's"}, "(processor a board's, now "),
        ({"versions": {"torch": "1.0"}}, "torch 1.0, now "),
        ({"accelerator": "another card"}, None),  # the rows are a processor's
    ],
)
def test_rows_of_another_machine_are_measured_again(
    tmp_path: Path, capsys: pytest.CaptureFixture, changes: dict[str, Any], words: str | None
) -> None:
    ours = ("runtimes=[torch]", "precisions=[fp32]")
    (first,) = run(tmp_path, *ours)
    stored = {**first, **changes, "latency_ms_p50": 1e6}
    (tmp_path / "rows.jsonl").write_text(json.dumps(stored) + "\n")
    capsys.readouterr()
    (row,) = run(tmp_path, *ours)
    said = capsys.readouterr().out
    if words is None:
        assert row == stored
        assert "another machine" not in said
        return
    assert "1 rows come from another machine" in said
    assert words in said
    assert row["latency_ms_p50"] < 1e6
    assert [row[name] for name in changes] == [first[name] for name in changes]
    assert run(tmp_path, *ours) == [row]  # what was measured here counts


@pytest.mark.slow
def test_a_benchmark_whose_rows_all_fail_fails(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no row was measured; the first: .* does not support bf16"):
        run(tmp_path, "runtimes=[onnxruntime]", "precisions=[bf16]")
    assert "not measured" in (tmp_path / "results.md").read_text()


def stored(folder: Path, name: str, **changes: Any) -> Path:
    """A run's record, as far as it is read."""
    run = {"model": "eldenet_s", "seed": 0, "data": "rooms", "split": "test", "split_hash": "abc"}
    run |= {"metrics": {"delta1": 0.8}, "protocol": {"name": "rooms"}, "cost": {"height": 96, "width": 128}}
    (folder / name).mkdir(parents=True)
    (folder / name / "run.json").write_text(json.dumps(run | changes))
    return folder / name


def test_the_picture_shows_models_with_an_accuracy(output: Path, tmp_path: Path) -> None:
    assert (output / "results.png").stat().st_size > 5000
    assert draw(rows_of(output), ({"eldenet_s": 0.8}, "delta1"), tmp_path / "accuracy.png")
    assert not draw(rows_of(output), ({"another": 0.8}, "delta1"), tmp_path / "none.png")


def test_times_of_a_busy_machine_are_noted(output: Path) -> None:
    rows = [row | {"waiting": waiting} for row, waiting in zip(rows_of(output), (1.0, 3.0), strict=False)]
    assert all(row["waiting"] > 0 for row in rows_of(output) if not row["failed"])
    assert any("other jobs used the machine while 1 of 2 rows" in note for note in notes_of(rows))
    assert not any("other jobs" in note for note in notes_of(rows[:1]))


def test_accuracies_are_means_over_seeds_under_one_protocol(tmp_path: Path) -> None:
    stored(tmp_path, "a")
    stored(tmp_path, "b", seed=1, metrics={"delta1": 0.6})
    stored(tmp_path, "c", model="mine", metrics={"delta1": 0.9})
    stored(tmp_path, "d", model="not_measured", split_hash="other")
    names = ["eldenet_s", "mine"]
    found, title = read_accuracies([str(tmp_path)], "delta1", names)
    assert found == pytest.approx({"eldenet_s": 0.7, "mine": 0.9})
    assert title == "δ1 ↑, rooms, rooms/test, at 96x128"
    assert read_accuracies([], "delta1", names) is None
    with pytest.raises(
        ValueError, match="runs are of eldenet_s, mine, not_measured, but the models are other"
    ):
        read_accuracies([str(tmp_path)], "delta1", ["other"])
    with pytest.raises(ValueError, match=r"accuracies=.*split_hash differs"):
        read_accuracies([str(tmp_path)], "delta1", [*names, "not_measured"])
    stored(tmp_path, "e", seed=2, protocol={"name": "rooms", "scale": "median"})
    with pytest.raises(ValueError, match=r"accuracies=.*protocol differs"):
        run(tmp_path / "out", f"accuracies=['{tmp_path}']")
    assert not (tmp_path / "out" / "rows.jsonl").exists()  # before anything was measured
    with pytest.raises(ValueError, match=r"run\.json has no cost\.height"):
        read_accuracies([str(stored(tmp_path, "f", cost={}))], "delta1", names)


def test_a_sweep_is_no_accuracy_of_one_network(tmp_path: Path) -> None:
    for rate in ("1e-3", "1e-4"):
        config = {"optimizer": {"lr": float(rate)}}
        stored(tmp_path, rate, config=config, overrides=[f"optimizer.lr={rate}"])
    with pytest.raises(ValueError, match=r"accuracies=.*differ in more than their seed .*lr=1e-3, .*lr=1e-4"):
        read_accuracies([str(tmp_path)], "delta1", ["eldenet_s"])
    assert read_accuracies([str(tmp_path / "1e-3")], "delta1", ["eldenet_s"]) is not None


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["runtimes=[tvm]"], "torch_channels_last"),
        (["precisions=[fp8]"], "fp32, bf16"),
        (["models=[nothing]"], "unknown model 'nothing'"),
        (["models=[]"], "models is empty"),
        (["models=[eldenet_s,eldenet_s]"], "two models are called 'eldenet_s'.*another model_name="),
        (["accuracy=delta"], "accuracy='delta'"),
        (["reference=eldenet_x"], "reference=eldenet_x is not among the models: choose one of eldenet_s"),
        (["rounds=0"], "rounds=0"),
        (["sizes=[]"], "sizes=.*: give at least one"),
        (["sizes=[[0,32]]"], r"sizes=\[0, 32\]: give \[height, width\] in pixels, 1 to"),
    ],
)
def test_wrong_settings_are_refused(tmp_path: Path, overrides: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        run(tmp_path / "none", *overrides)
    assert not (tmp_path / "none").exists()


def test_packaged_weights_keep_their_names() -> None:
    s = compose(BenchmarkSettings, ["models=[eldenet_rooms,eldenet_indoor]"])
    assert list(load_models(s).models) == ["eldenet_rooms", "eldenet_indoor"]


def test_rows_are_added_after_a_line_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "rows.jsonl").write_bytes(b'{"model": "\xff')
    append_rows(tmp_path, [{"model": "eldenet"}])
    assert (tmp_path / "rows.jsonl").read_bytes().endswith(b'\xff\n{"model": "eldenet"}\n')


def test_timed_calls_take_turns() -> None:
    order: list[str] = []
    times = time_interleaved(
        {name: lambda name=name: order.append(name) for name in "ab"}, rounds=3, seconds=0.0, warm_up=1
    )
    assert "".join(order) == ("a" * 4 + "b" * 4) * 3
    assert [len(each) for each in times.values()] == [9, 9]
    waited: list[int] = []
    time_interleaved({"a": lambda: None}, rounds=1, seconds=0.0, synchronize=lambda: waited.append(1))
    assert len(waited) == 4  # before the first and after each


@pytest.mark.slow
def test_the_command_measures_memory_from_another_folder(run_command, tmp_path: Path) -> None:
    done = run_command(
        *("benchmark", *TINY[:3], "runtimes=[torch]", "rounds=1", "seconds=0.001"),
        *("reference=eldenet_s", "output=table"),
    )
    assert done.returncode == 0, done.stderr
    assert "written to table: results.md, .csv, .tex, .png, rows.jsonl" in done.stdout
    (row,) = read_rows(tmp_path / "table").values()
    assert 0.5 < row["peak_memory_mb"] < 2000
    assert tuple(row["key"]) == Case("eldenet_s", 32, 48, 2, "torch", "fp32", 1, "cpu").key

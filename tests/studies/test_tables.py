"""Tables of a study from its stored runs: means, verdicts, gaps, latencies."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.stored_study import change_run, figures, notes, store, table, write_plan

from eldenet.results import paired_intervals
from eldenet.results.packed_runs import RUNS, read_records, write_records
from eldenet.studies.plan import Study
from eldenet.studies.report import write_study_report
from eldenet.studies.tables import build_blocks
from eldenet.system.files import write_rows

DIFFERENCE = "delta1 - small's [95 %]"


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return write_plan(tmp_path)


@pytest.mark.parametrize(("offset", "verdict"), [(0.05, "better"), (-0.05, "worse"), (0.0, "")])
def test_verdicts_need_three_seeds_of_both(study: Study, offset: float, verdict: str) -> None:
    for seed in range(3):
        store(study, "small", seed, figures(0.0, seed))
        store(study, "large", seed, figures(offset, 10 + seed))
    cell = table(study)["large"][DIFFERENCE]
    assert float(cell.split()[0]) == pytest.approx(offset, abs=0.01)
    assert cell.endswith(f"] {verdict}" if verdict else "]")
    records = read_records(study.folder / RUNS)
    write_records(study.folder / RUNS, {name: records[name] for name in records if name != "small/seed2"})
    rows = table(study)
    assert rows["large"][DIFFERENCE].endswith("] (scenes alone)")
    assert (rows["small"]["seeds"], rows["large"]["seeds"]) == ("2 of 3", "3")


def test_the_difference_averages_the_seeds(study: Study) -> None:
    for seed in range(3):
        store(study, "small", seed, np.full(40, 0.5))
        store(study, "large", seed, np.full(40, 0.5 + 0.1 * seed))
    rows = table(study)
    # the images are alike: drawn seeds alone move it, from three times the worst to three times the best
    assert rows["large"][DIFFERENCE] == "+0.100 [+0.000, +0.200]"
    assert rows["large"]["δ1 ↑"] == "0.600 ± 0.100"
    (block,) = [one for one in build_blocks(study) if one.name == "scratch"]
    assert {name: value for name, _, value in block.points} == pytest.approx({"small": 0.5, "large": 0.6})
    assert {cost for _, cost, _ in block.points} == {1.0}  # GMACs: a run's own latency is not shown
    assert "latency [ms] ↓" not in rows["large"]


def test_the_plot_shows_the_differences_of_the_table(study: Study) -> None:
    for seed in range(3):
        store(study, "small", seed, np.linspace(0.4, 0.6, 40))
        store(study, "large", seed, np.linspace(0.6, 0.8, 40))
    (block,) = [one for one in build_blocks(study) if one.name == "scratch"]
    found = block.differences["large"]
    assert (block.reference, found.verdict, found.seeds) == ("small", "better", True)
    assert found.mean == pytest.approx(0.2)
    assert found.text == table(study)["large"][DIFFERENCE]
    write_plan(study.folder, "rows:", "plots: [differences]\nrows:")
    write_study_report(study.folder)
    assert (study.folder / "differences.png").stat().st_size > 1000
    assert "(differences.png)" in (study.folder / "results.md").read_text()
    assert not (study.folder / "pareto.png").exists()


def test_a_lucky_seed_makes_no_verdict(study: Study) -> None:
    """Every image is better on average, but one training of three alone brings that."""
    for seed in range(3):
        store(study, "small", seed, figures(0.0, seed))
        store(study, "large", seed, figures(0.06 if seed == 0 else 0.0, 10 + seed))
    cell = table(study)["large"][DIFFERENCE]
    assert float(cell.split()[0]) == pytest.approx(0.02, abs=0.01)
    assert cell.endswith("]")
    ours, theirs = (
        paired_intervals.per_image({str(seed): study.stored(row, seed) for seed in range(3)}, "delta1")
        for row in study.chosen(["large", "small"])[::-1]
    )
    assert paired_intervals.paired_interval(ours, theirs, draw_seeds=False)[1] > 0


def test_runs_that_do_not_compare_are_refused(study: Study) -> None:
    store(study, "small", 0, figures(0, 0))
    run = store(study, "large", 0, figures(0, 1), split_hash="other")
    with pytest.raises(ValueError, match="split_hash differs"):
        build_blocks(study)
    change_run(study, "large/seed0", split_hash="abc", protocol=run["protocol"] | {"max_depth": 5.0})
    with pytest.raises(ValueError, match="protocol differs"):
        build_blocks(study)
    store(study, "large", 0, figures(0, 1)[:30])  # other images under the same hash
    with pytest.raises(ValueError, match="different images"):
        build_blocks(study)
    store(study, "large", 0, figures(0, 1))
    store(study, "other", 0, figures(0, 1), split_hash="other")  # another block is another table
    assert table(study, "rooms")["other"]["seeds"] == "1 of 3"


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"train_split_hash": "less"}, "train_split_hash"),
        ({"resources": {"precision": "fp32"}}, "precision"),
        ({"model": "another"}, "have the names"),
    ],
)
def test_runs_of_a_row_differ_in_their_seed_only(study: Study, changes: dict[str, Any], word: str) -> None:
    store(study, "small", 0, figures(0, 0))
    store(study, "small", 1, figures(0, 1), **changes)
    store(study, "large", 0, figures(0, 1))
    rows = table(study)
    assert word in rows["small"]["seeds"]
    assert "rerun=true" in rows["small"]["seeds"]
    assert (rows["small"]["δ1 ↑"], rows["large"]["seeds"]) == ("-", "1 of 3")  # the others have their table


def test_the_table_can_show_the_last_epoch(study: Study, tmp_path: Path) -> None:
    """Where an epoch was chosen on the table's frames, the last one is shown, and no single images."""
    with pytest.raises(ValueError, match="epoch: last has no metrics of single images"):
        write_plan(tmp_path, "rows:", "epoch: last\nrows:")
    study = write_plan(tmp_path, "reference: [small]", "epoch: last")
    epochs = [{"epoch": epoch, "val_delta1": 0.3 * epoch, "val_rmse": 1.0 / epoch} for epoch in (1, 2, 3)]
    for seed, kept in enumerate((2, 3)):
        values = np.full(40, 0.3 * kept)
        store(study, "small", seed, values, training={"history": epochs, "best_epoch": kept})
    with pytest.raises(ValueError, match=r"small, seed 1 was validated on frames other .*\(rmse of the kept"):
        build_blocks(study)
    for seed, kept in enumerate((2, 3)):
        changes = {"metrics": {"delta1": 0.3 * kept, "rmse": 1.0 / kept, "images": 40}}
        changes |= {"training": {"history": epochs, "best_epoch": kept}}
        store(study, "small", seed, np.full(40, 0.3 * kept), **changes)
    cells = table(study)["small"]
    assert (cells["δ1 ↑"], cells["RMSE [m] ↓"]) == ("0.900 ± 0.000", "0.333 ± 0.000")
    assert not any("95 %" in title for title in cells)
    assert any(note.startswith("metrics of the last epoch") for note in notes(study))
    del epochs[2]["val_delta1"]
    store(study, "small", 0, np.full(40, 0.6), training={"history": epochs, "best_epoch": 2})
    with pytest.raises(ValueError, match="not validated after its last epoch"):
        build_blocks(study)


def test_latencies_of_another_network_are_refused(study: Study, tmp_path: Path) -> None:
    config = store(study, "small", 0, figures(0, 0))["config"]["model"]
    study = write_plan(tmp_path, "rows:", "latency: benchmark.csv\nrows:")
    with pytest.raises(FileNotFoundError, match="names it as latency"):
        build_blocks(study)
    line = {
        **{"row": "small", "latency_ms_p50": 3.25, "runtime": "onnxruntime", "precision": "fp32"},
        **{"threads": 1, "device": "cpu", "batch": 1, "height": 96, "width": 128, "params": 100},
        **{"gmacs": 1.0, "processor": "some", "date": "2026-01-01", "command": "benchmark.py"},
    }
    file = tmp_path / "benchmark.csv"
    line["network"] = json.dumps(config)
    write_rows(file, list(line), [list(line.values())])
    assert table(study)["small"]["latency [ms] (onnxruntime) ↓"] == "3.25"
    write_study_report(tmp_path)
    text = (tmp_path / "results.md").read_text()
    assert "latency: median of interleaved rounds, onnxruntime, fp32, 1 threads, cpu (some)" in text
    assert "costs: torch" not in text
    # the latency of another network, or at another input
    plain = json.loads(json.dumps(config))
    plain["backbone"]["shortcuts"] = not config["backbone"]["shortcuts"]
    for change, words in (
        ({"params": 99}, r"params=99 \(there 100\)"),
        ({"gmacs": 1.1}, r"gmacs=1.1 \(there 1\)"),
        ({"height": 120}, r"height=120 \(there 96\)"),
        ({"network": json.dumps(plain)}, r"model\.backbone\.shortcuts=False \(there True\)"),
    ):
        other = line | change
        write_rows(file, list(other), [list(other.values())])
        with pytest.raises(ValueError, match=rf"latency of small was measured on another network.*{words}"):
            build_blocks(study)

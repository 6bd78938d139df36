"""What the tables of a study say of its stored runs: means, verdicts, gaps, outdated rows, latencies."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldenet import config as cfg
from eldenet.metrics import METRICS
from eldenet.sources import fingerprint
from eldenet.studies import statistics
from eldenet.studies.blocks import build_blocks
from eldenet.studies.composing import compose_run
from eldenet.studies.convergence import convergence
from eldenet.studies.plan import Study, read_study
from eldenet.studies.report import write_study_report

PLAN = """
overrides: [data=rooms, "data.frames={train: 16, val: 4, test: 6}", trainer.epochs=3]
learning_rate: 1.0e-3
seeds: [0, 1, 2]
reference: [small]
columns: [rmse, delta1]
rows:
  small: {overrides: [model=eldenet_s]}
  large: {overrides: [model=eldenet]}
  other: {overrides: [model=fastdepth], block: rooms}
"""
IMAGES = [f"room/{index}" for index in range(40)]
DIFFERENCE = "delta1 - small's [95 %]"


@pytest.fixture
def study(tmp_path: Path) -> Study:
    (tmp_path / "sweep.yaml").write_text(PLAN)
    return read_study(tmp_path)


def store(study: Study, name: str, seed: int, delta1: np.ndarray, **changes: Any) -> Path:
    """A stored run as a training leaves it, with these figures of its images."""
    (row,) = study.chosen(name)
    overrides = [*study.overrides, *row.overrides, "optimizer.lr=1.0e-3"]
    config = compose_run(overrides, Path("f"), Path("r"), name=name, seed=seed)
    run = {
        "model": name,
        "seed": seed,
        **{"data": "rooms", "split": "test", "split_hash": "abc", "train_split_hash": "def"},
        "protocol": cfg.plain(config.data.protocol) | {"crop_fractions": None},
        "metrics": dict.fromkeys(METRICS, 0.5) | {"delta1": float(delta1.mean()), "images": len(delta1)},
        "constant_predictor": None,
        "cost": {"params": 100, "gmacs": 1.0, "gflops": 2.0, "latency_ms_p50": 7.0, "throughput_img_s": 9.0}
        | {"runtime": "torch", "precision": "fp32", "threads": 1, "device": "cpu"}
        | {"height": 96, "width": 128, "batch": 8},
        "hardware": {"processor": "some", "accelerator": None},
        "versions": {"torch": "2"},
        "resources": {"precision": "bf16"},
        "date": "2026-01-01T00:00:00",
        "sources": {},
        "config": cfg.plain(config),
    } | changes
    folder = study.stored(row, seed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(json.dumps(run))
    with (folder / "per_image.csv").open("w", newline="") as lines:
        writer = csv.writer(lines)
        writer.writerow(["name", "delta1"])
        writer.writerows(zip(IMAGES, delta1, strict=False))
    return folder


def table(study: Study, block: str = "scratch") -> dict[str, dict[str, str]]:
    """Row -> title -> cell."""
    (found,) = [one for one in build_blocks(study) if one.name == block]
    return {row[0]: dict(zip(found.titles, row, strict=True)) for row in found.rows}


def notes(study: Study) -> list[str]:
    return build_blocks(study)[0].notes


def figures(offset: float, seed: int) -> np.ndarray:
    return 0.5 + offset + 0.02 * np.random.default_rng(seed).standard_normal(len(IMAGES))


def history(mse: Sequence[float]) -> list[dict[str, float]]:
    """Of a training with this validation MSE after each epoch."""
    return [
        {"epoch": epoch, "train_total": value, "val_mse": value, "val_ssim": 0.9, "val_mae": value}
        for epoch, value in enumerate(mse, 1)
    ]


@pytest.mark.parametrize(("offset", "verdict"), [(0.05, "better"), (-0.05, "worse"), (0.0, "")])
def test_verdicts_need_three_seeds_of_both(study: Study, offset: float, verdict: str) -> None:
    for seed in range(3):
        store(study, "small", seed, figures(0.0, seed))
        store(study, "large", seed, figures(offset, 10 + seed))
    cell = table(study)["large"][DIFFERENCE]
    assert float(cell.split()[0]) == pytest.approx(offset, abs=0.01)
    assert cell.endswith(f"] {verdict}" if verdict else "]")
    (study.stored(study.chosen("small")[0], 2) / "run.json").unlink()
    rows = table(study)
    assert rows["large"][DIFFERENCE].endswith("] (images alone)")
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


def test_differences_are_drawn_as_the_table_says_them(study: Study) -> None:
    for seed in range(3):
        store(study, "small", seed, np.linspace(0.4, 0.6, 40))
        store(study, "large", seed, np.linspace(0.6, 0.8, 40))
    (block,) = [one for one in build_blocks(study) if one.name == "scratch"]
    found = block.differences["large"]
    assert (block.reference, found.verdict, found.seeds) == ("small", "better", True)
    assert found.mean == pytest.approx(0.2)
    assert found.text == table(study)["large"][DIFFERENCE]
    plan = study.folder / "sweep.yaml"
    plan.write_text(plan.read_text() + "plots: [differences]\n")
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
        statistics.per_image([study.stored(row, seed) / "per_image.csv" for seed in range(3)], "delta1")
        for row in study.chosen(["large", "small"])[::-1]
    )
    assert statistics.paired_interval(ours, theirs, draw_seeds=False)[1] > 0


def test_what_does_not_compare_is_refused(study: Study) -> None:
    store(study, "small", 0, figures(0, 0))
    folder = store(study, "large", 0, figures(0, 1), split_hash="other")
    with pytest.raises(ValueError, match="split_hash differs"):
        build_blocks(study)
    run = json.loads((folder / "run.json").read_text()) | {"split_hash": "abc"}
    run["protocol"]["max_depth"] = 5.0
    (folder / "run.json").write_text(json.dumps(run))
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
def test_seeds_of_a_row_differ_in_nothing_else(study: Study, changes: dict[str, Any], word: str) -> None:
    store(study, "small", 0, figures(0, 0))
    store(study, "small", 1, figures(0, 1), **changes)
    with pytest.raises(ValueError, match=word):
        build_blocks(study)


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


def test_curves_of_an_older_plan_are_left_out(study: Study, tmp_path: Path) -> None:
    for name in ("small", "large"):
        store(study, name, 0, figures(0, 0), training={"history": history([3.0, 2.0, 1.0])})
    assert set(convergence(study).curves) == {"small/seed0", "large/seed0"}
    (tmp_path / "sweep.yaml").write_text(PLAN.replace("model=eldenet]", "model=eldenet, loss=berhu]"))
    assert set(convergence(read_study(tmp_path)).curves) == {"small/seed0"}


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
    (tmp_path / "sweep.yaml").write_text(PLAN.replace("model=eldenet]", "model=eldenet, loss=berhu]"))
    study = read_study(tmp_path)
    for name in ("small", "large"):
        store(study, name, 0, figures(0, 0), training={"history": history([3.0, 2.0, 1.0])})
    titles, rows = convergence(study).by_row()
    levels = {tuple(row[:2]): row[titles.index("level")] for row in rows}
    assert levels["small", "training loss"] == levels["large", "training loss"] == "-"
    assert levels["small", "MSE"] == levels["large", "MSE"] == "1.000"


def test_a_curve_that_sparse_depth_does_not_have_is_left_out(study: Study) -> None:
    epochs = [row | {"val_ssim": None} for row in history([3.0, 2.0, 1.0])]  # as run.json has NaN
    store(study, "small", 0, figures(0, 0), training={"history": epochs})
    assert set(convergence(study).curves["small/seed0"]) == {"epoch", "train_loss", "val_mse"}


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


def test_the_last_epoch_in_the_table(study: Study, tmp_path: Path) -> None:
    """Where an epoch was chosen on the table's frames, the last one is shown, and no single images."""
    (tmp_path / "sweep.yaml").write_text(PLAN + "epoch: last\n")
    with pytest.raises(ValueError, match="epoch: last has no figures of images"):
        read_study(tmp_path)
    (tmp_path / "sweep.yaml").write_text(PLAN.replace("reference: [small]", "epoch: last"))
    study = read_study(tmp_path)
    epochs = [{"epoch": epoch, "val_delta1": 0.3 * epoch, "val_rmse": 1.0 / epoch} for epoch in (1, 2, 3)]
    for seed, kept in enumerate((2, 3)):
        values = np.full(40, 0.3 * kept)
        store(study, "small", seed, values, training={"history": epochs, "best_epoch": kept})
    with pytest.raises(ValueError, match=r"small, seed 1 was validated on other frames .*\(rmse of the kept"):
        build_blocks(study)
    for seed, kept in enumerate((2, 3)):
        store(
            study,
            "small",
            seed,
            np.full(40, 0.3 * kept),
            metrics={"delta1": 0.3 * kept, "rmse": 1.0 / kept, "images": 40},
            training={"history": epochs, "best_epoch": kept},
        )
    cells = table(study)["small"]
    assert (cells["δ1 ↑"], cells["RMSE [m] ↓"]) == ("0.900 ± 0.000", "0.333 ± 0.000")
    assert not any("95 %" in title for title in cells)
    assert any(note.startswith("figures of the last epoch") for note in notes(study))
    del epochs[2]["val_delta1"]
    store(study, "small", 0, np.full(40, 0.6), training={"history": epochs, "best_epoch": 2})
    with pytest.raises(ValueError, match="not validated after its last epoch"):
        build_blocks(study)


def test_half_a_copy_is_no_stored_run(study: Study) -> None:
    folder = store(study, "small", 0, figures(0, 0))
    (folder / "per_image.csv").unlink()
    assert table(study)["small"]["seeds"] == "not run"


def test_benchmarked_latencies_say_what_they_are_of(study: Study, tmp_path: Path) -> None:
    store(study, "small", 0, figures(0, 0))
    (tmp_path / "sweep.yaml").write_text(PLAN + "latency: benchmark.csv\n")
    study = read_study(tmp_path)
    with pytest.raises(FileNotFoundError, match="names it as its latency"):
        build_blocks(study)
    header = "row,latency_ms_p50,runtime,precision,threads,device,batch,height,width,params,gmacs"
    facts = "onnxruntime,fp32,1,cpu,1,96,128,{params},0.1,some,2026-01-01,benchmark.py"
    file = tmp_path / "benchmark.csv"
    file.write_text(f"{header},processor,date,command\nsmall,3.25,{facts.format(params=100)}\n")
    assert table(study)["small"]["latency [ms] (onnxruntime) ↓"] == "3.25"
    write_study_report(tmp_path)
    text = (tmp_path / "results.md").read_text()
    assert "latency: median of interleaved rounds, onnxruntime, fp32, 1 threads, cpu (some)" in text
    assert "costs: torch" not in text
    file.write_text(f"{header},processor,date,command\nsmall,3.25,{facts.format(params=99)}\n")
    with pytest.raises(ValueError, match="99 parameters, its runs have 100"):
        build_blocks(study)

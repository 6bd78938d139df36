"""The commands as a user types them: from another folder, with a typo, resumed, swept, reported."""

import csv
import json
from pathlib import Path

import pytest

TINY = (
    "data.size=[32,40]",
    "data.input_size=[32,40]",
    "data.frames={train: 16, val: 8, test: 8}",
    "trainer.epochs=1",
    "trainer.batch_size=8",
    "model=eldenet_s",
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory, cache) -> Path:
    """A run folder, made by the command itself."""
    import os
    import subprocess
    import sys

    folder = tmp_path_factory.mktemp("elsewhere")
    finished = subprocess.run(
        [sys.executable, "-m", "eldenet.train", *TINY, "run_dir=run"],
        cwd=folder,
        env={**os.environ, "ELDENET_CACHE": cache},
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )
    assert finished.returncode == 0, finished.stderr
    for text in ("epoch", "AbsRel", "constant", "params", "protocol rooms", "run.json"):
        assert text in finished.stdout, finished.stdout
    return folder / "run"


def test_train_leaves_everything_that_was_promised(trained):
    for name in ("run.json", "per_image.csv", "predictions.png", "config.yaml", "history.csv"):
        assert (trained / name).is_file(), name
    run = json.loads((trained / "run.json").read_text())
    assert run["model"] == "eldenet_s"
    assert run["protocol"]["name"] == "rooms"
    assert run["metrics"]["images"] == 8
    assert run["config"]["trainer"]["epochs"] == 1
    assert run["resources"]["threads"] + run["resources"]["workers"] <= run["resources"]["cores"]
    for group, key in (
        ("metrics", "delta1"),
        ("constant_predictor", "abs_rel"),
        ("cost", "gmacs"),
        ("cost", "latency_ms_p50"),
        ("versions", "torch"),
        ("hardware", "processor"),
        ("training", "best_epoch"),
    ):
        assert run[group][key] is not None, (group, key)
    assert len(run["split_hash"]) == 16
    assert {"date", "command", "seed", "git"} <= run.keys()


def test_per_image_rows_average_to_the_metrics(trained):
    with (trained / "per_image.csv").open() as file:
        rows = list(csv.DictReader(file))
    run = json.loads((trained / "run.json").read_text())
    for name in ("abs_rel", "rmse", "delta1"):
        mean = sum(float(row[name]) for row in rows) / len(rows)
        assert mean == pytest.approx(run["metrics"][name], rel=1e-6)


def test_evaluate_gives_the_same_numbers_and_report_a_table(trained, run_command):
    finished = run_command(
        "evaluate", f"checkpoint={trained}", *TINY[:3], "run_dir=evaluation", cwd=trained.parent
    )
    assert finished.returncode == 0, finished.stderr
    first = json.loads((trained / "run.json").read_text())
    second = json.loads((trained.parent / "evaluation" / "run.json").read_text())
    assert second["metrics"] == pytest.approx(first["metrics"])
    assert second["model"] == "eldenet_s"
    finished = run_command(
        "report", f"runs=[{trained}]", "output=tables/first", "costs=false", cwd=trained.parent
    )
    assert finished.returncode == 0, finished.stderr
    assert "eldenet_s" in (trained.parent / "tables" / "first.md").read_text()
    assert {path.suffix for path in (trained.parent / "tables").iterdir()} == {".md", ".csv", ".tex"}


@pytest.mark.parametrize(
    ("command", "arguments", "message"),
    [
        ("train", ["trainer.epohcs=3"], "epohcs"),
        ("train", ["model=eldenett"], "eldenett"),
        ("train", ["experiment=rooms_full"], "+experiment"),
        ("train", [*TINY, "trainer.monitor=accuracy"], "monitor='accuracy'"),
        ("train", [*TINY, "runtime.device=cuda"], "device=cuda"),
        ("train", [*TINY, "ckpt_path=none.pt"], "no checkpoint at none.pt"),
        ("train", [*TINY, "protocol=nyu_bts"], "protocol nyu_bts scores raw ground truth"),
        ("train", ["data=nyu_mat", "data.root=/nowhere"], "/nowhere"),
        ("evaluate", ["checkpoint=nowhere"], "unknown model 'nowhere'"),
        ("report", ["runs=[nowhere]"], "no such file or folder: nowhere"),
    ],
)
def test_a_mistake_is_one_clear_line(run_command, command, arguments, message):
    finished = run_command(command, *arguments, CUDA_VISIBLE_DEVICES="")
    assert finished.returncode == 1
    assert message in finished.stderr + finished.stdout
    assert "Traceback" not in finished.stderr + finished.stdout


def test_cfg_job_shows_the_config_from_any_folder(run_command):
    finished = run_command("train", "--cfg", "job")
    assert finished.returncode == 0
    assert "eldenet.backbones.pplcnet.PPLCNet" in finished.stdout

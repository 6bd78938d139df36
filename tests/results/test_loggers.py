"""Curves and pictures in each logger, with the real library and nothing sent anywhere."""

import errno
import sys
from pathlib import Path

import numpy as np
import pytest

from eldenet.results.loggers import LOGGERS
from eldenet.results.run_log import RunLog
from eldenet.system.errors import DiskError

PICTURE = np.full((8, 12, 3), 90, np.uint8)


def log_twice(folder: Path, name: str) -> None:
    """A run that was stopped after its first epoch, and resumed."""
    for step in (10, 20):
        log = RunLog(folder, loggers=(name,))
        log.picture("validation", step, PICTURE)
        log.scalars(step, {"val/delta1": step / 100})
        log.close()


def test_tensorboard_gets_curves_and_pictures(tmp_path):
    log_twice(tmp_path / "run", "tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "run/tensorboard")).Reload()
    assert [point.value for point in events.Scalars("val/delta1")] == pytest.approx([0.1, 0.2])
    assert events.Tags()["images"] == ["validation"]


def test_mlflow_gets_one_run_with_curves_and_pictures(tmp_path, monkeypatch):
    mlflow = pytest.importorskip("mlflow")
    place = (tmp_path / "mlruns").as_uri()
    monkeypatch.setenv("MLFLOW_TRACKING_URI", place)
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    log_twice(tmp_path / "run", "mlflow")
    client = mlflow.MlflowClient(tracking_uri=place)
    number = client.get_experiment_by_name("eldenet").experiment_id
    (run,) = client.search_runs([number])
    assert run.info.run_name == "run"
    history = client.get_metric_history(run.info.run_id, "val/delta1")
    assert [(point.step, point.value) for point in history] == [(10, 0.1), (20, 0.2)]
    assert [file.path for file in client.list_artifacts(run.info.run_id)] == ["validation.png"]


def test_wandb_keeps_an_offline_run(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    log_twice(tmp_path / "run", "wandb")
    own = (tmp_path / "run/wandb_id.txt").read_text()
    assert list((tmp_path / "run/wandb").glob(f"offline-run-*-{own}"))


def test_trackio_keeps_a_local_run(tmp_path, monkeypatch):
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))
    pytest.importorskip("trackio")
    log_twice(tmp_path / "run", "trackio")
    assert list((tmp_path / "trackio").rglob("*.db"))


def test_a_full_disk_names_the_logger(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "")

    monkeypatch.setitem(LOGGERS, "mlflow", full)
    with pytest.raises(DiskError, match="the log of mlflow was not written"):
        RunLog(tmp_path, loggers=("mlflow",)).scalars(0, {"loss": 1.0})


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(ImportError, match="logger=wandb needs wandb: pip install -e"):
        LOGGERS["wandb"](tmp_path, None)


@pytest.mark.slow
def test_an_unknown_logger_is_refused(run_command):
    finished = run_command("train", "logger=[tensorbord]", "runtime.workers=0")
    assert finished.returncode == 1
    assert "tensorboard" in finished.stderr

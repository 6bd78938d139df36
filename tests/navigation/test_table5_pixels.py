"""The study of driving by pixels: its table is what its rows say, and rows belong to their networks."""

import importlib.util
import shutil
from pathlib import Path

import pytest
from support.detector_files import FILES, save

from eldenet.system.files import read_text

FOLDER = Path(__file__).resolve().parents[2] / "experiments" / "table5_robustness"
_SPEC = importlib.util.spec_from_file_location("pixels", FOLDER / "pixels.py")
study = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(study)
FEW = ["--worlds", "2", "--sensors", "true ranges", "--conditions", "20 obstacles"]


def table(folder):
    return [line for line in (folder / "pixels.md").read_text().splitlines() if line.startswith("| ")]


def test_the_stored_table_shows_the_stored_episodes(tmp_path):
    rows = study.read(FOLDER / "pixels.csv.gz")
    study.write(tmp_path, rows)
    assert read_text(tmp_path / "pixels.csv.gz") == read_text(FOLDER / "pixels.csv.gz")
    assert table(tmp_path) == table(FOLDER)
    for condition in study.CONDITIONS:  # pairs are of the same arenas
        worlds = [[row.world for row in rows[key]] for key in rows if key[0] == condition]
        shortest = min(map(len, worlds), default=0)
        assert all(names[:shortest] == worlds[0][:shortest] for names in worlds)


def test_a_stored_row_is_not_measured_again(tmp_path, monkeypatch):
    study.main(FEW, tmp_path)
    first = read_text(tmp_path / "pixels.csv.gz")
    assert first.count("test-20-") == 2
    monkeypatch.delattr(study, "run_episodes")
    study.main(FEW, tmp_path)
    assert read_text(tmp_path / "pixels.csv.gz") == first


def test_a_row_names_its_detector_and_another_file_is_another_row(tmp_path):
    trained = study.SENSORS[3]
    one, other = (save(tmp_path / f"{name}.onnx", *FILES[name]) for name in ("yolov9", "nms"))
    assert study.version(trained, one) != study.version(trained, other)
    assert study.make_sensor(trained, one).detector.path == one
    assert study.make_sensor("objects, ideal detector", one).detector is None
    with pytest.raises(ValueError, match="--detector"):
        study.version(trained, None)


def test_rows_of_another_depth_network_are_not_read(tmp_path, monkeypatch):
    shutil.copy(FOLDER / "pixels.csv.gz", tmp_path)
    monkeypatch.setattr(study, "DEPTH", "eldenet_rooms")
    kinds = {kind for _, kind, _ in study.read(tmp_path / "pixels.csv.gz")}
    assert kinds == set(study.SENSORS) - set(study.BY_NETWORK)

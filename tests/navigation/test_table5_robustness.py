"""The table of wrong readings is what its stored rows say, and its settings are those of the sensor."""

import importlib.util
from pathlib import Path

from eldenet.navigation.sensors import Ranges
from eldenet.system.files import read_text

FOLDER = Path(__file__).resolve().parents[2] / "experiments" / "table5_robustness"
SPEC = importlib.util.spec_from_file_location("table5_robustness", FOLDER / "run.py")
study = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(study)


def test_the_stored_table_shows_the_stored_episodes(tmp_path):
    rows = study.read(FOLDER / "results.csv.gz")
    study.write(tmp_path, rows)
    assert read_text(tmp_path / "results.csv.gz") == read_text(FOLDER / "results.csv.gz")
    shown = [line for line in (FOLDER / "results.md").read_text().splitlines() if line.startswith("| ")]
    made = [line for line in (tmp_path / "results.md").read_text().splitlines() if line.startswith("| ")]
    assert shown == made


def test_rows_are_paired_and_of_forty_arenas_at_least():
    rows = study.read(FOLDER / "results.csv.gz")
    for (method, faults, filtered), episodes in rows.items():
        beside = rows.get((method, faults, not filtered))
        assert len(episodes) >= 40
        if beside is not None:
            assert all(one.world == other.world for one, other in zip(episodes, beside, strict=False))


def test_rows_of_another_version_are_measured_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "FILTER_VERSION", 99)
    assert {filtered for _, _, filtered in study.read(FOLDER / "results.csv.gz")} == {False}
    assert all(Ranges(**faults) for faults in study.FAULTS.values())

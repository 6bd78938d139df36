"""Studies beside table 5: tables are what their stored episodes say, and rows belong to what made them."""

import shutil
from pathlib import Path

import pytest
from support.composing import composed
from support.detector_files import FILES, save
from support.scripts import EXPERIMENTS, load_scripts

from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import Episode
from eldenet.navigation.sensors import Ranges
from eldenet.system.files import read_text

FOLDER = EXPERIMENTS / "table5_robustness"
conditions, pixels, faults = load_scripts("table5_robustness", "conditions", "pixels", "run")
(race,) = load_scripts("table6_time", "carrots")
STUDIES = {"conditions": conditions, "pixels": pixels, "results": faults}


def table(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if line.startswith("| ")]


@pytest.mark.parametrize("name", STUDIES)
def test_a_stored_table_shows_its_stored_episodes(name, tmp_path):
    study = STUDIES[name]
    study.write(tmp_path, study.read(FOLDER / f"{name}.csv.xz"))
    assert read_text(tmp_path / f"{name}.csv.xz") == read_text(FOLDER / f"{name}.csv.xz")
    assert table(tmp_path / f"{name}.md") == table(FOLDER / f"{name}.md")


@pytest.mark.parametrize("name", STUDIES)
def test_rows_of_one_kind_are_of_the_same_arenas(name):
    kinds: dict[str, list[list[str]]] = {}
    for row in STUDIES[name].read(FOLDER / f"{name}.csv.xz").values():
        worlds = [episode.world for episode in row]
        kinds.setdefault(worlds[0], []).append(worlds)
    assert {first.rpartition("-")[2] for first in kinds} <= {"0", str(conditions.FRESH)}
    for rows in kinds.values():
        shortest = min(map(len, rows))
        assert shortest >= 40
        assert all(worlds[:shortest] == rows[0][:shortest] for worlds in rows)


def test_every_condition_is_a_setting():
    for condition in conditions.CONDITIONS.values():
        Ranges(**condition.sensor)
        EpisodeSettings("wheels", **condition.robot)
    assert all(Ranges(**settings) for settings in faults.FAULTS.values())


def test_rows_of_another_version_or_network_are_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(faults, "FILTER_VERSION", 99)
    assert {filtered for _, _, filtered in faults.read(FOLDER / "results.csv.xz")} == {False}
    shutil.copy(FOLDER / "pixels.csv.xz", tmp_path)
    monkeypatch.setattr(pixels, "DEPTH", "eldenet_rooms")
    kinds = {kind for _, kind, _ in pixels.read(tmp_path / "pixels.csv.xz")}
    assert kinds == set(pixels.SENSORS) - set(pixels.BY_NETWORK)


def test_a_stored_row_is_not_measured_again(tmp_path, monkeypatch):
    few = ["--worlds", "2", "--sensors", "true ranges", "--conditions", "20 obstacles"]
    pixels.main(few, tmp_path)
    first = read_text(tmp_path / "pixels.csv.xz")
    assert first.count("test-20-") == 2
    monkeypatch.delattr(pixels, "run_episodes")
    pixels.main(few, tmp_path)
    assert read_text(tmp_path / "pixels.csv.xz") == first


def test_a_row_names_its_detector_and_another_file_is_another_row(tmp_path):
    trained = pixels.SENSORS[3]
    one, other = (save(tmp_path / f"{name}.onnx", *FILES[name]) for name in ("yolov9", "nms"))
    assert pixels.version(trained, one) != pixels.version(trained, other)
    assert pixels.make_sensor(trained, one).detector.path == one
    assert pixels.make_sensor("objects, ideal detector", one).detector is None


def test_the_carrot_is_the_fastest_of_those_that_succeed_as_often():
    def episodes(seconds, failures):
        outcomes = ["timeout"] * failures + ["success"] * (100 - failures)
        return [Episode(f"val-80-{k}", 80, o, seconds, 1.0, 1.0) for k, o in enumerate(outcomes)]

    settings = {1.0: (20.0, 0), 1.3: (18.0, 0), 1.6: (16.0, 1), 2.0: (14.0, 2)}
    rows = {("astar_dwa", carrot): episodes(*of) for carrot, of in settings.items()}
    assert race.tuned(rows, "astar_dwa") == 1.6


@pytest.mark.parametrize("method", race.CARROTS)
def test_planners_drive_with_the_carrot_that_the_rule_chose(method):
    rows = race.read(EXPERIMENTS / "table6_time" / "carrots.csv.xz")
    assert race.PLANNERS[method]().carrot == race.tuned(rows, method)
    if method in ("astar_dwa", "astar_online_dwa", "dwa"):
        assert composed("navigate", [f"policy={method}"]).policy.carrot == race.tuned(rows, method)

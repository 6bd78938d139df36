"""The study of rooms, traps, delay and other robots: its table is what its rows say, its settings exist."""

import importlib.util
from pathlib import Path

import pytest

from eldenet.compose import compose_config
from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import Episode
from eldenet.navigation.sensors import Ranges
from eldenet.system.files import read_text

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"


def load(name: str):
    spec = importlib.util.spec_from_file_location(Path(name).stem, EXPERIMENTS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


study, race = load("table5_robustness/conditions"), load("table6_time/carrots")


def test_the_stored_table_shows_the_stored_episodes(tmp_path):
    folder = EXPERIMENTS / "table5_robustness"
    study.write(tmp_path, study.read(folder / "conditions.csv.gz"))
    assert read_text(tmp_path / "conditions.csv.gz") == read_text(folder / "conditions.csv.gz")
    shown = [line for line in (folder / "conditions.md").read_text().splitlines() if line.startswith("| ")]
    made = [line for line in (tmp_path / "conditions.md").read_text().splitlines() if line.startswith("| ")]
    assert shown == made


def test_rows_of_a_condition_are_of_the_same_arenas():
    rows = study.read(EXPERIMENTS / "table5_robustness" / "conditions.csv.gz")
    for condition in study.CONDITIONS:
        worlds = [[row.world for row in rows[key]] for key in rows if key[1] == condition]
        shortest = min(map(len, worlds), default=0)
        assert all(names[:shortest] == worlds[0][:shortest] for names in worlds)


def test_every_condition_is_a_setting():
    for condition in study.CONDITIONS.values():
        Ranges(**condition.sensor)
        EpisodeSettings("wheels", **condition.robot)


def test_the_carrot_is_the_fastest_of_those_that_succeed_as_often():
    def episodes(seconds, failures):
        outcomes = ["timeout"] * failures + ["success"] * (100 - failures)
        return [Episode(f"val-80-{k}", 80, o, seconds, 1.0, 1.0) for k, o in enumerate(outcomes)]

    settings = {1.0: (20.0, 0), 1.3: (18.0, 0), 1.6: (16.0, 1), 2.0: (14.0, 2)}
    rows = {("astar_dwa", carrot): episodes(*of) for carrot, of in settings.items()}
    assert race.tuned(rows, "astar_dwa") == 1.6


@pytest.mark.parametrize("method", race.CARROTS)
def test_planners_drive_with_the_carrot_that_the_rule_chose(method):
    rows = race.read(EXPERIMENTS / "table6_time" / "carrots.csv.gz")
    assert race.PLANNERS[method]().carrot == race.tuned(rows, method)
    if method in ("astar_dwa", "astar_online_dwa", "dwa"):
        assert compose_config("navigate", [f"policy={method}"]).policy.carrot == race.tuned(rows, method)

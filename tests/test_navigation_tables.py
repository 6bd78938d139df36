"""Tables 5 and 6: rows are kept, and made anew when anything that they depend on has changed."""

import importlib
import json
import shutil
import sys
from argparse import Namespace
from pathlib import Path

import pytest

from eldenet.navigation.policy import DEFAULT_WEIGHTS
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.arenas import arenas_hash

FOLDER = Path(__file__).parents[1] / "experiments" / "table5_success"


@pytest.fixture
def rows(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in ("rows", "panels"):
        sys.modules.pop(name, None)
    yield importlib.import_module("rows")
    for name in ("rows", "panels"):
        sys.modules.pop(name, None)


def given(tmp_path: Path, **options) -> Namespace:
    settings = {
        "worlds": 2, "seeds": 1, "methods": "straight", "sensors": "ranges", "physics": "kinematic",
        "courses": "5,20+10", "depth": None, "errors": None, "packaged": True, "runs": tmp_path / "runs",
        "rows": tmp_path / "rows",
    }  # fmt: skip
    return Namespace(**(settings | options))


def test_rows_are_read_until_something_changes(rows, tmp_path, monkeypatch, capsys):
    options = given(tmp_path)
    first = [rows.measure(row, options) for row in rows.all_rows(options)]
    assert [row.course for row in rows.all_rows(options)] == ["5", "20+10"]
    assert capsys.readouterr().out.count("of 2") == 2
    assert [rows.measure(row, options) for row in rows.all_rows(options)] == first
    assert capsys.readouterr().out == ""
    package = tmp_path / "eldenet"
    shutil.copytree(rows.PACKAGE, package, ignore=shutil.ignore_patterns("weights", "__pycache__"))
    monkeypatch.setattr(rows, "PACKAGE", package)
    for name, counts in (
        ("navigation/pictures.py", False),
        ("navigation/planners/dwa.py", True),
        ("navigation/crossings.py", True),
        ("simulation/arena_world.py", True),
        ("simulation/furniture.py", False),
        ("robot.py", True),
    ):
        file = package / name
        file.write_text(file.read_text() + "# changed\n")
        (row, _) = rows.all_rows(options)
        rows.measure(row, options)
        assert ("of 2" in capsys.readouterr().out) == counts, name


def test_a_camera_s_row_depends_on_its_network_and_the_renderer(rows, tmp_path, monkeypatch):
    (tmp_path / "net" / "model").mkdir(parents=True)
    weights = tmp_path / "net" / "model" / "model.safetensors"
    weights.write_bytes(b"1")
    options = given(tmp_path, depth=str(tmp_path / "net"), sensors="camera@0.1,ranges", courses="5")
    dim, plain = rows.all_rows(options)
    before = [rows.key_of(row, options, None, []) for row in (dim, plain)]
    weights.write_bytes(b"2")
    after = [rows.key_of(row, options, None, []) for row in (dim, plain)]
    assert after[0]["depth"] != before[0]["depth"]
    assert after[1] == before[1]
    assert rows.key_of(dim, options, DEFAULT_WEIGHTS, [])["policy"] is not None
    assert before[0]["sources"] != before[1]["sources"]
    assert rows.make_sensor(dim, given(tmp_path)).light == 0.1
    assert "camera@0.1-kinematic-5-2" in dim.name


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": "straight,,magic"}, "'magic'"),
        ({"sensors": "sonar"}, "'sonar'"),
        ({"courses": "6"}, "'6'"),
    ],
)
def test_what_there_is_not_is_refused(rows, tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        list(rows.all_rows(given(tmp_path, **options)))


def test_learnt_rows_are_trainings_of_the_command(rows):
    from eldenet.config import compose, plain

    configs = {name: compose("navigate", ["mode=train", *options]) for name, options in rows.LEARNT.items()}
    assert (configs["paper_literal"].observer.memory, configs["paper_literal"].learner.n_step) == (0, 1)
    assert configs["paper_literal"].learner.target_every > 0
    assert (configs["paper_state"].observer.memory, configs["paper_state"].learner.n_step) == (0, 5)
    assert configs["dqn_walkers"].training.arenas.movers == 10
    assert plain(configs["dqn"].observer)["memory"] == 60


def test_the_moving_arenas_are_frozen_too():
    frozen = json.loads((FOLDER / "arenas.json").read_text())
    assert set(frozen["100"]) == set(frozen["300"]) == set(frozen["500"]) == {"5", "20", "40", "80", "20+10"}
    assert arenas_hash(frozen_arenas(20, 100, movers=10)) == frozen["100"]["20+10"]

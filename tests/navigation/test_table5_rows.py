"""Tables 5 and 6: rows are kept, and made anew when anything that they depend on has changed."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
from support.table5 import FOLDER, given

from eldenet.compose import compose
from eldenet.navigate import NavigateSettings
from eldenet.navigation.policy_files import DEFAULT_WEIGHTS
from eldenet.navigation.provenance import TRAINING_VERSION
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.arenas import arenas_hash


@pytest.fixture
def rows(study):
    return study("rows")


@pytest.fixture
def command(study):
    return study("command")


@pytest.fixture
def methods(study):
    return study("methods")


def test_rows_are_read_until_something_changes(rows, command, tmp_path, monkeypatch, capsys):
    options = given(tmp_path)
    first = [rows.measure(row, options) for row in command.all_rows(options)]
    assert [row.course for row in command.all_rows(options)] == ["5", "20+10"]
    assert capsys.readouterr().out.count("of 2") == 2
    assert [rows.measure(row, options) for row in command.all_rows(options)] == first
    assert capsys.readouterr().out == ""
    monkeypatch.setattr(rows, "EPISODE_VERSION", 0)
    (row, _) = command.all_rows(options)
    assert rows.measure(row, given(tmp_path, stored=True)) == first[0]
    assert capsys.readouterr().out == ""
    rows.measure(row, options)
    assert "of 2" in capsys.readouterr().out


def test_a_new_row_leaves_the_stored_rows_of_its_method_alone(rows, command, tmp_path, monkeypatch):
    options = given(tmp_path, sensors="ranges,noisy")
    every = list(command.all_rows(options))
    first = {row.labels: rows.measure(row, options) for row in every}
    assert rows.stored_episodes(options.rows) == first
    before = rows.read_notes(options.rows / rows.NOTES)
    assert list(before) == [row.name for row in every]
    monkeypatch.setattr(rows, "EPISODE_VERSION", 0)
    rows.measure(every[1], options)
    after = rows.read_notes(options.rows / rows.NOTES)
    assert [name for name in before if before[name]["key"] != after[name]["key"]] == [every[1].name]
    assert rows.stored_episodes(options.rows) == first
    stored = json.loads((options.rows / rows.NOTES).read_text())
    assert len(stored["environments"]) == 1


def test_a_camera_s_row_depends_on_its_network_and_the_renderer(rows, command, tmp_path, monkeypatch):
    (tmp_path / "net" / "model").mkdir(parents=True)
    weights = tmp_path / "net" / "model" / "model.safetensors"
    weights.write_bytes(b"1")
    options = given(tmp_path, depth=str(tmp_path / "net"), sensors="camera@0.1,ranges", courses="5")
    dim, plain = command.all_rows(options)
    before = [rows.key_of(row, options, None, "of them") for row in (dim, plain)]
    for changed in (weights, weights.with_name("config.json")):
        changed.write_bytes(b"2")
        after = [rows.key_of(row, options, None, "of them") for row in (dim, plain)]
        assert after[0]["depth"] != before[0]["depth"], changed
        assert after[1] == before[1]
        before[0] = after[0]
    assert rows.key_of(dim, options, DEFAULT_WEIGHTS, "of them")["policy"] is not None
    assert rows.make_sensor(dim.sensor, given(tmp_path, depth="truth")).light == 0.1
    assert dim.name == "straight-camera@0.1-known-kinematic-5-2"


def test_a_row_depends_on_how_its_method_drives(rows, methods, tmp_path, monkeypatch):
    row, options = rows.Row("dqn", 5, 0, "ranges", "kinematic", 2, 1), given(tmp_path)
    before = rows.key_of(row, options, DEFAULT_WEIGHTS, "of them")
    for changed in ({"slows_within": 2.0}, {"follows": True}):
        other = dataclasses.replace(methods.LEARNED["dqn"], **changed)
        monkeypatch.setitem(methods.LEARNED, "dqn", other)
        after = rows.key_of(row, options, DEFAULT_WEIGHTS, "of them")
        assert [name for name in before if before[name] != after[name]] == ["drives"]
        before = after


def test_learnt_rows_are_trainings_of_the_command(methods):
    for method in methods.LEARNED.values():
        compose(NavigateSettings, ["mode=train", *method.options])
    literal = compose(NavigateSettings, ["mode=train", *methods.LEARNED["paper_literal"].options])
    learner = literal.learner
    assert (literal.observer["memory"], learner["n_step"], learner["max_grad_norm"]) == (0, 1, 0)


def test_the_moving_arenas_are_frozen_too():
    frozen = json.loads((FOLDER / "arenas.json").read_text())
    assert set(frozen["100"]) == set(frozen["300"]) == set(frozen["500"]) == {"5", "20", "40", "80", "20+10"}
    assert arenas_hash(frozen_arenas(20, 100, pedestrians=10)) == frozen["100"]["20+10"]


def policy_folder(tmp_path: Path, config: dict, version: int = TRAINING_VERSION) -> Path:
    folder = tmp_path / "runs" / "dqn-1"
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(DEFAULT_WEIGHTS, folder / "policy.safetensors")
    (folder / "training.json").write_text(json.dumps({"config": config, "version": version}))
    return folder


def test_a_training_of_other_settings_or_version_is_refused(rows, tmp_path):
    row = rows.Row("dqn", 5, 0, "ranges", "kinematic", 2, 1)
    options = given(tmp_path)
    config = dataclasses.asdict(compose(NavigateSettings, ["mode=train", "seed=1", "output=x"]))
    folder = policy_folder(tmp_path, config)
    assert rows.policy_file(row, options) == folder / "policy.safetensors"
    policy_folder(tmp_path, config | {"learner": config["learner"] | {"total_timesteps": 7}})
    with pytest.raises(ValueError, match="trained with another learner"):
        rows.policy_file(row, options)
    policy_folder(tmp_path, config, TRAINING_VERSION + 1)
    with pytest.raises(ValueError, match=f"by version {TRAINING_VERSION + 1}"):
        rows.policy_file(row, options)
    (folder / "training.json").unlink()
    with pytest.raises(ValueError, match=r"without training\.json"):
        rows.policy_file(row, options)
    shutil.rmtree(folder)  # the table is rebuilt without its trainings
    assert rows.policy_file(row, options).read_bytes() == DEFAULT_WEIGHTS.read_bytes()


def test_the_whole_command_writes_headings_with_what_fed_them(rows, study, tmp_path, monkeypatch):
    run = study("run")
    monkeypatch.setattr(run, "HERE", tmp_path)
    monkeypatch.setattr(run, "arguments", lambda: given(
        tmp_path, sensors="ranges,noisy", goal="odometry", courses="5", methods="straight"))  # fmt: skip
    run.main()
    text = (tmp_path / "results-2-goal-odometry.md").read_text()
    assert "## noisy, kinematic, goal odometry" in text
    assert "errors `packaged` (SHA-256 " in text
    assert "goal `odometry` (odometry is exact here)" in text
    assert "nan" not in (tmp_path / "tables.csv").read_text()
    assert "straight-noisy-odometry-kinematic-5-2" in rows.read_notes(tmp_path / "rows" / rows.NOTES)

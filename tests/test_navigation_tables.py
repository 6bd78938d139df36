"""Tables 5 and 6: rows are kept, and made anew when anything that they depend on has changed."""

import dataclasses
import importlib
import json
import shutil
import sys
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes

from eldenet.navigation import sources
from eldenet.navigation.evaluation import Crossing
from eldenet.navigation.policy import DEFAULT_WEIGHTS
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.arenas import arenas_hash

MODULES = ("rows", "command", "methods", "panels", "inputs", "comparisons", "run", "trajectories")
FOLDER = Path(__file__).parents[1] / "experiments" / "table5_success"


@pytest.fixture
def study(monkeypatch):
    """Its modules by their names: other studies have some of the same name."""
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in MODULES:
        sys.modules.pop(name, None)
    yield importlib.import_module
    for name in MODULES:
        sys.modules.pop(name, None)


@pytest.fixture
def rows(study):
    return study("rows")


@pytest.fixture
def command(study):
    return study("command")


@pytest.fixture
def methods(study):
    return study("methods")


def given(tmp_path: Path, **options) -> Namespace:
    settings = {
        "worlds": 2, "seeds": 1, "methods": "straight", "sensors": "ranges", "physics": "kinematic",
        "courses": "5,20+10", "depth": None, "detector": None, "errors": "packaged",
        "goal": "known", "any_sources": False, "recheck": 0, "out": None, "runs": tmp_path / "runs",
        "rows": tmp_path / "rows",
    }  # fmt: skip
    return Namespace(**(settings | options))


def test_rows_are_read_until_something_changes(rows, command, tmp_path, monkeypatch, capsys):
    options = given(tmp_path)
    first = [rows.measure(row, options) for row in command.all_rows(options)]
    assert [row.course for row in command.all_rows(options)] == ["5", "20+10"]
    assert capsys.readouterr().out.count("of 2") == 2
    assert [rows.measure(row, options) for row in command.all_rows(options)] == first
    assert capsys.readouterr().out == ""
    package = tmp_path / "eldenet"
    shutil.copytree(sources.PACKAGE, package, ignore=shutil.ignore_patterns("weights", "__pycache__"))
    monkeypatch.setattr(sources, "PACKAGE", package)
    for name, counts in (
        ("navigation/pictures.py", False),
        ("navigation/planners/dwa.py", True),
        ("navigation/crossings.py", True),
        ("simulation/arena_world.py", True),
        ("simulation/furniture.py", False),
        ("simulation/mjcf.py", True),
        ("runtimes/__init__.py", False),
        ("robot.py", True),
    ):
        file = package / name
        file.write_text(file.read_text() + "# changed\n")
        (row, _) = command.all_rows(options)
        rows.measure(row, options)
        assert ("of 2" in capsys.readouterr().out) == counts, name


def test_a_row_of_other_sources_is_kept_if_its_first_crossings_come_out_the_same(
    rows, command, tmp_path, monkeypatch, capsys
):
    options = given(tmp_path, courses="5", recheck=1)
    (row,) = command.all_rows(options)
    first = rows.measure(row, options)
    monkeypatch.setattr(rows, "crossing_hash", lambda camera: "after a change")
    assert rows.measure(row, options) == first
    assert rows.measure(row, options) == first
    assert capsys.readouterr().out.count("the first 1 came out the same, kept") == 1
    note, table = (options.rows / f"{row.name}.{ending}" for ending in ("json", "csv"))
    assert json.loads(note.read_text())["rechecked"][0]["worlds"] == 1
    table.write_text(table.read_text().replace(str(first[0].seconds), "1.0"))
    monkeypatch.setattr(rows, "crossing_hash", lambda camera: "after another")
    assert rows.measure(row, options) == first
    assert "of 2" in capsys.readouterr().out
    assert "rechecked" not in json.loads(note.read_text())


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
    assert before[0]["sources"] != before[1]["sources"]
    assert rows.make_sensor(dim.sensor, given(tmp_path, depth="truth")).light == 0.1
    assert "camera@0.1-kinematic-5-2" in dim.name


def test_a_row_depends_on_how_its_method_drives(rows, methods, tmp_path, monkeypatch):
    row, options = rows.Row("dqn", 5, 0, "ranges", "kinematic", 2, 1), given(tmp_path)
    before = rows.key_of(row, options, DEFAULT_WEIGHTS, "of them")
    for changed in ({"slows_within": 2.0}, {"follows": True}):
        other = dataclasses.replace(methods.LEARNT["dqn"], **changed)
        monkeypatch.setitem(methods.LEARNT, "dqn", other)
        after = rows.key_of(row, options, DEFAULT_WEIGHTS, "of them")
        assert [name for name in before if before[name] != after[name]] == ["drives"]
        before = after


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": "straight,,magic"}, "'magic'"),
        ({"sensors": "sonar"}, "'sonar'"),
        ({"courses": "6"}, "'6'"),
        ({"sensors": "ranges@0.1"}, "light is for camera and objects"),
        ({"sensors": "camera@dark", "depth": "truth"}, "number above 0"),
        ({"sensors": "camera"}, "--depth: say what feeds the camera"),
        ({"sensors": "camera", "depth": "owner/model"}, "--depth owner/model: no model folder"),
        ({"sensors": "objects", "depth": "truth"}, "--detector: say what finds objects"),
        (
            {"sensors": "objects", "depth": "truth", "detector": "none.onnx"},
            "--detector none.onnx: no such file",
        ),
        ({"sensors": "noisy", "errors": "none.json"}, "--errors none.json"),
    ],
)
def test_what_there_is_not_is_refused(command, tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        list(command.all_rows(given(tmp_path, **options)))


def test_learnt_rows_are_trainings_of_the_command(methods):
    from eldenet.config import compose, plain

    configs = {
        name: compose("navigate", ["mode=train", *method.options]) for name, method in methods.LEARNT.items()
    }
    assert (configs["paper_literal"].observer.memory, configs["paper_literal"].learner.n_step) == (0, 1)
    assert configs["paper_literal"].learner.target_every > 0
    assert configs["paper_literal"].learner.steps == configs["dqn"].learner.steps
    assert configs["paper_literal"].learner.gradient_clip == 0
    assert configs["paper_literal"].learner.learning_rate_end == 1
    assert (configs["paper_state"].observer.memory, configs["paper_state"].learner.n_step) == (0, 5)
    assert configs["dqn_walkers"].training.arenas.movers == 10
    assert plain(configs["dqn"].observer)["memory"] == 60
    assert (configs["dqn"].observer.seen_through, configs["dqn_by_age"].observer.seen_through) == (2, 0)
    assert (configs["dqn_mixed"].sensor.share, configs["dqn_mixed"].sensor.errors) == (0.5, "packaged")
    assert len(configs["dqn_reverse"].observer.turn_rates) == 8
    assert configs["dqn_curriculum"].training.arenas.curriculum == 0.5
    assert configs["dqn_quantile"].learner.quantiles == 16


def test_ways_are_drawn_with_their_end(study, methods):
    trajectories = study("trajectories")
    (arena,) = frozen_arenas(40, 1, split="val")
    picture = trajectories.panel(arena, "straight", methods.PLANNERS["straight"](1))
    assert picture.shape == (trajectories.TITLE + trajectories.SIDE, trajectories.SIDE, 3)
    scene = trajectories.Scene(arena, trajectories.SIDE)
    column, row = scene.pixel(*arena.start[:2])
    assert picture[row + trajectories.TITLE, column].tolist() == [30, 100, 220]  # the dot at the start
    assert (picture[: trajectories.TITLE] < 255).any()


def test_panels_of_ways_fit_a_page(study):
    trajectories = study("trajectories")
    panels = [np.full((5, 4, 3), shade, np.uint8) for shade in range(7)]
    lines = trajectories.lines_of(panels)
    side = trajectories.GAP + 4
    assert [line.shape for line in lines] == [(5 + trajectories.GAP, trajectories.COLUMNS * side, 3)] * 2
    assert [int(lines[1][0, at * side, 0]) for at in range(4)] == [4, 5, 6, 255]
    assert trajectories.heading("arena", panels).shape[1] == lines[0].shape[1]


def test_no_method_hides_another_in_the_figures(study, tmp_path, monkeypatch):
    """Equal values stand side by side, in one colour per method in all panels, whichever a panel has."""
    panels, drawn = study("panels"), []
    errorbar = Axes.errorbar

    def noted(axis, at, values, **options):
        drawn.append((axis.get_subplotspec().num1, options["color"], list(at)))
        return errorbar(axis, at, values, **options)

    monkeypatch.setattr(Axes, "errorbar", noted)
    points = [(5, 90.0, 80.0, 95.0), (80, 50.0, 40.0, 60.0)]
    curves = {("wheels", sensor): {"a": points, "b": points} for sensor in ("one", "two", "three")}
    curves["wheels", "four"] = {"b": points[:1]}
    panels.draw_panels(curves, tmp_path / "figure.png", ylabel="success [%]")
    assert (tmp_path / "figure.png").stat().st_size > 1000
    assert len({tuple(at) for _, _, at in drawn[:2]}) == 2
    assert drawn[-1][:2] == (3, drawn[1][1])
    assert drawn[-1][2] == drawn[1][2][:1]


def test_the_figure_of_the_success_is_that_of_its_csv(study, tmp_path, monkeypatch):
    """From the rows as they are written and as they are read: what is stored can be drawn again."""
    run, drawn = study("run"), []
    monkeypatch.setattr(run, "draw_panels", lambda curves, path, **options: drawn.append(curves))
    rows = [["wheels", "ranges", "dqn", seed, "80", 500, share, share - 1, share + 1] for seed, share in
            ((0, 90.0), (1, 92.0))]  # fmt: skip
    rows.append(["wheels", "ranges", "dqn", 0, "20+10", 500, 50.0, 40.0, 60.0])  # walkers: no density
    for cells in (rows, [[str(value) for value in row] for row in rows]):
        run.plot(cells, tmp_path / "figure.png")
    assert drawn[0] == drawn[1] == {("wheels", "ranges"): {"dqn": [(80, 91.0, 90.0, 92.0)]}}


def test_the_moving_arenas_are_frozen_too():
    frozen = json.loads((FOLDER / "arenas.json").read_text())
    assert set(frozen["100"]) == set(frozen["300"]) == set(frozen["500"]) == {"5", "20", "40", "80", "20+10"}
    assert arenas_hash(frozen_arenas(20, 100, movers=10)) == frozen["100"]["20+10"]


def policy_folder(tmp_path: Path, config: dict, sources_hash: str) -> Path:
    folder = tmp_path / "runs" / "dqn-1"
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(DEFAULT_WEIGHTS, folder / "policy.safetensors")
    (folder / "training.json").write_text(json.dumps({"config": config, "sources": sources_hash}))
    return folder


def test_a_training_of_other_settings_or_sources_is_refused(rows, tmp_path):
    from eldenet.config import compose, plain

    row = rows.Row("dqn", 5, 0, "ranges", "kinematic", 2, 1)
    options = given(tmp_path)
    config = plain(compose("navigate", ["mode=train", "seed=1", "run_dir=x"]))
    folder = policy_folder(tmp_path, config, sources.training_hash())
    assert rows.policy_file(row, options) == folder / "policy.safetensors"
    policy_folder(tmp_path, config | {"learner": config["learner"] | {"steps": 7}}, sources.training_hash())
    with pytest.raises(ValueError, match="trained with another learner"):
        rows.policy_file(row, options)
    policy_folder(tmp_path, config, "of another day")
    with pytest.raises(ValueError, match="by other sources"):
        rows.policy_file(row, options)
    assert rows.policy_file(row, given(tmp_path, any_sources=True)) is not None
    (folder / "training.json").unlink()
    with pytest.raises(ValueError, match=r"without training\.json"):
        rows.policy_file(row, options)


def test_a_training_of_other_sources_is_kept_if_its_first_leg_comes_out_the_same(
    study, tmp_path, monkeypatch, capsys
):
    inputs = study("inputs")
    options = [
        "learner.steps=600", "learner.leg=300", "learner.warmup=100", "learner.batch_size=16",
        "training.robots=4", "training.validate=2", "training.arenas.densities=[0,5]",
    ]  # fmt: skip
    policy = inputs.training_of(tmp_path / "dqn-0", options)
    monkeypatch.setattr(inputs, "training_hash", lambda: "after a change")
    with pytest.raises(ValueError, match="--recheck"):
        inputs.training_of(tmp_path / "dqn-0", options)
    assert inputs.training_of(tmp_path / "dqn-0", options, recheck=True) == policy
    assert "the first leg of its training came out the same" in capsys.readouterr().out
    assert inputs.training_of(tmp_path / "dqn-0", options) == policy
    note = tmp_path / "dqn-0" / "training.json"
    content = json.loads(note.read_text())
    content["legs"][0]["collision"] += 1
    note.write_text(json.dumps(content | {"sources": "of another day"}))
    with pytest.raises(ValueError, match="by other sources"):
        inputs.training_of(tmp_path / "dqn-0", options, recheck=True)


def test_a_table_is_rebuilt_without_its_trainings(rows, tmp_path):
    from eldenet.config import compose, plain

    row, options = rows.Row("dqn", 5, 0, "ranges", "kinematic", 2, 1), given(tmp_path)
    config = plain(compose("navigate", ["mode=train", "seed=1", "run_dir=x"]))
    trained = policy_folder(tmp_path, config, sources.training_hash())
    rows.policy_file(row, options)
    shutil.rmtree(trained)
    kept = rows.policy_file(row, options)
    assert kept.read_bytes() == DEFAULT_WEIGHTS.read_bytes()
    assert not trained.exists()


def test_a_part_does_not_replace_the_whole_table(command, tmp_path):
    table = tmp_path / "results-2.csv"
    assert command.results_name(given(tmp_path)) == "results-2"
    assert command.results_name(given(tmp_path, goal="odometry")) == "results-2-goal-odometry"
    assert command.results_name(given(tmp_path, out="mine")) == "mine"
    command.refuse_to_drop(table, [("wheels", "dwa")])
    table.write_text("physics,method,success\nwheels,dwa,1\nwheels,dqn,2\n")
    command.refuse_to_drop(table, [("wheels", "dwa"), ("wheels", "dqn"), ("wheels", "straight")])
    with pytest.raises(ValueError, match="such as wheels, dqn"):
        command.refuse_to_drop(table, [("wheels", "dwa")])


def crossings(solved: list[bool], seconds: float = 10.0) -> list[Crossing]:
    return [Crossing(f"w{k}", 5, "success" if ok else "timeout", seconds + k, 9.0, 8.0)
            for k, ok in enumerate(solved)]  # fmt: skip


def test_a_sensor_s_loss_is_tested_in_pairs(study):
    comparisons = study("comparisons")
    true, seen = [True] * 90 + [False] * 10, [True] * 80 + [False] * 15 + [True] * 5
    tables = {
        ("wheels", "ranges", "dqn", "5"): [crossings([True] * 100)],
        ("wheels", "ranges", "dqn_mixed", "5"): [crossings(true)],
        ("wheels", "noisy", "dqn_mixed", "5"): [crossings(seen)],
    }
    lines = comparisons.loss(tables, "wheels", "noisy")
    own, default = (line.split(" | ") for line in lines[2:])
    assert own[1:3] == ["dqn_mixed", "5"]
    assert own[3].startswith("5.0 [")
    assert own[4:6] == ["10", "5"]
    assert default[1] == "dqn"
    assert default[3].startswith("15.0 [")
    # the paired interval, against the normal one of the differences
    low, high = (float(value) for value in own[3][len("5.0 [") : -1].split(", "))
    half = 1.96 * 100 * ((0.15 - 0.05**2) / 100) ** 0.5
    assert (low, high) == pytest.approx((5 - half, 5 + half), abs=1.1)
    assert comparisons.loss(tables, "wheels", "ranges") == []


def test_the_default_is_compared_with_all_others(study):
    comparisons = study("comparisons")
    tables = {
        ("wheels", "ranges", "dqn", "5"): [crossings([True] * 6 + [False] * 4)],
        ("wheels", "ranges", "dwa", "5"): [crossings([False] * 10)],
    }
    assert comparisons.paired(tables, "wheels", "ranges")[0].startswith("| dqn against")
    assert [line[:19] for line in comparisons.paired(tables, "wheels", "ranges")[2:]] == [
        "| dwa | 5 | 6 | 0 |"
    ]
    tables["wheels", "ranges", "dqn_ensemble", "5"] = [crossings([True] * 9 + [False])]
    lines = comparisons.paired(tables, "wheels", "ranges")
    assert [line.split(" | ")[:4] for line in lines[2:]] == [
        ["| dqn", "5", "3", "0"],
        ["| dwa", "5", "9", "0"],
    ]


def test_time_is_compared_over_all_trainings_in_pairs(study, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER.parent / "table6_time"))
    sys.modules.pop("run", None)
    run = study("run")
    ok = [True] * 40
    made = {
        "astar_dwa": [crossings(ok)],
        "dqn": [crossings(ok, 11.0), crossings([True] * 39 + [False], 13.0)],
    }
    ratio, low, high, both = run.ratio_to_reference(made, "dqn")
    first = sum(11 + k for k in range(40)) / sum(10 + k for k in range(40))
    second = sum(13 + k for k in range(39)) / sum(10 + k for k in range(39))
    assert ratio == pytest.approx((first + second) / 2)
    assert low < ratio < high
    assert high - low < 0.03  # far less than that of times unpaired
    assert both == 39
    assert run.ratio_to_reference(made, "astar_dwa")[:3] == (1.0, 1.0, 1.0)
    assert run.cell(float("nan"), float("nan"), 0.0, 0.0) == "-"


def test_the_whole_command_writes_headings_with_what_fed_them(study, tmp_path, monkeypatch):
    run = study("run")
    monkeypatch.setattr(run, "HERE", tmp_path)
    monkeypatch.setattr(run, "arguments", lambda: given(
        tmp_path, sensors="ranges,noisy", goal="odometry", courses="5", methods="straight"))  # fmt: skip
    run.main()
    text = (tmp_path / "results-2-goal-odometry.md").read_text()
    assert "## noisy, kinematic, goal odometry" in text
    assert "errors `packaged` (SHA-256 " in text
    assert "goal `odometry` (odometry is exact here)" in text
    assert "nan" not in (tmp_path / "results-2-goal-odometry.csv").read_text()
    assert (tmp_path / "results-2-goal-odometry.png").is_file()
    assert (tmp_path / "rows" / "straight-noisy-goal_odometry-kinematic-5-2.csv").is_file()

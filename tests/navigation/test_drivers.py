"""Drivers: the packaged policy, planners, and the statistics of their episodes."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file

from eldenet.navigation.evaluation import (
    Episode,
    run_episodes,
    spl,
    summarize,
)
from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.observer import Senses
from eldenet.navigation.planners.astar import AStarDWA, AStarOnlineDWA
from eldenet.navigation.planners.dwa import ACCELERATION, TURN_ACCELERATION, DynamicWindow, LocalDWA
from eldenet.navigation.policy import Navigator, export_onnx
from eldenet.navigation.policy_files import DEFAULT_WEIGHTS
from eldenet.navigation.qnetwork import QNetwork
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT, arc

WINDOW = DynamicWindow()


def test_the_packaged_policy_is_small_and_drives():
    assert DEFAULT_WEIGHTS.stat().st_size < 200_000
    rows = run_episodes(
        frozen_arenas(5, 12, split="val"), lambda robots: Navigator.load(robots=robots), Ranges()
    )
    assert summarize(rows)["success"] >= 90


@pytest.mark.slow
def test_an_episode_ends_the_same_alone_and_among_others():
    arenas = frozen_arenas(80, 5, split="val")
    make = lambda robots: Navigator.load(robots=robots)  # noqa: E731
    together = run_episodes(arenas, make, NoisyRanges(), robots=5)
    by_two = run_episodes(arenas, make, NoisyRanges(), robots=2)
    assert together == by_two


def test_a_saved_policy_decides_the_same_once_loaded(tmp_path):
    torch.manual_seed(0)
    navigator = Navigator(QNetwork(39, 5, (16,)), {}, info={"note": "x"})
    navigator.save(tmp_path / "policy.safetensors")
    loaded = Navigator.load(tmp_path)  # a run folder, or the file in it
    assert loaded.info == Navigator.load(tmp_path / "policy.safetensors").info == {"note": "x"}
    rng = np.random.default_rng(0)
    for _ in range(20):
        ranges = rng.uniform(0.3, 10, ROBOT.columns)
        goal = float(rng.uniform(1, 10)), float(rng.uniform(-3, 3))
        assert navigator.step(ranges, goal, (0.0, 0.0, 0.0)) == loaded.step(ranges, goal, (0.0, 0.0, 0.0))
    with pytest.raises(FileNotFoundError, match="no policy"):
        Navigator.load(tmp_path / "none.safetensors")
    (tmp_path / "dqn.pt").write_bytes(b"PK" * 100)
    wrong = r"dqn\.pt is truncated or not a valid \.safetensors file .*: give a training's run"
    with pytest.raises(ValueError, match=wrong):
        Navigator.load(tmp_path / "dqn.pt")
    save_file({"a": torch.zeros(1)}, str(tmp_path / "other.safetensors"))
    with pytest.raises(ValueError, match="is not a navigation policy"):
        Navigator.load(tmp_path / "other.safetensors")


def test_several_networks_drive_together_by_the_mean_of_their_values(tmp_path):
    torch.manual_seed(0)
    files = [tmp_path / f"{number}.safetensors" for number in range(3)]
    for number, file in enumerate(files):
        Navigator(QNetwork(39, 5, (16,)), {}, info={"seed": number}).save(file)
    together = Navigator.load(files, slows_within=1.0)
    assert together.info == {"members": [{"seed": 0}, {"seed": 1}, {"seed": 2}]}
    rows = torch.rand(8, 39, dtype=torch.float64)
    apart = [Navigator.load(file).network(rows) for file in files]
    torch.testing.assert_close(together.network(rows), sum(apart) / 3)
    together.save(tmp_path / "all.safetensors")
    again = Navigator.load(tmp_path / "all.safetensors")
    torch.testing.assert_close(again.network(rows), together.network(rows), rtol=0, atol=2e-3)
    assert again.observer.options == together.observer.options
    assert again.observer.options["slows_within"] == 1.0
    Navigator(QNetwork(39, 5, (8,)), {}).save(files[2])
    with pytest.raises(ValueError, match=r"\(39, 5, \(8,\)\), .*give networks of one shape"):
        Navigator.load(files)
    Navigator(QNetwork(39, 5, (16,)), {"memory": 30}).save(files[1])
    with pytest.raises(ValueError, match=r"1\.safetensors was trained with the observer .*'memory': 30"):
        Navigator.load(files)


@pytest.mark.parametrize(
    ("within", "distance", "expected"),
    [(None, 5.0, 1.0), (None, 1.5, 0.5), (1.0, 1.5, 1.0), (1.0, 0.5, 0.5), (1.0, 0.1, 0.25)],
)
def test_the_driver_slows_down_before_the_goal(within, distance, expected):
    torch.manual_seed(0)
    driver = Navigator(QNetwork(39, 5, (16,)), {} if within is None else {"slows_within": within}).observer
    driver.observe(
        Senses(np.full((1, ROBOT.columns), ROBOT.far), np.zeros((1, 3)), np.array([[distance, 0.0]]))
    )
    assert driver.commands(np.array([2]))[0] == pytest.approx([expected, 0.0])


def test_the_policy_loads_no_simulator():
    code = (
        "import numpy as np, sys; from eldenet.navigation.policy import Navigator; "
        "print(Navigator.load().step(np.full(5, 8.0), (5.0, 0.0), (0.0, 0.0, 0.0))); "
        "print(*sys.modules)"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    speed, turn = eval(shown.stdout.splitlines()[0])
    assert 0 < speed <= 1
    assert abs(turn) <= 1.2
    modules = shown.stdout.splitlines()[1].split()
    assert not {"mujoco", "gymnasium", "cv2", "hydra"} & set(modules)
    assert {name for name in modules if name.startswith("eldenet.simulation.")} == {
        "eldenet.simulation.robot"
    }


def test_an_exported_onnx_file_gives_the_same_values(tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    navigator = Navigator.load()
    export_onnx(navigator, str(tmp_path / "policy.onnx"))
    session = runtime.InferenceSession(str(tmp_path / "policy.onnx"), providers=["CPUExecutionProvider"])
    observation = np.random.default_rng(0).uniform(-1, 1, (7, navigator.network.inputs)).astype(np.float32)
    (values,) = session.run(None, {"observation": observation})
    with torch.no_grad():
        expected = navigator.network(torch.from_numpy(observation).double()).numpy()
    assert values == pytest.approx(expected, abs=1e-4)
    assert json.loads(session.get_modelmeta().custom_metadata_map["navigator"]) == navigator.observer.options


@pytest.mark.parametrize("make", [AStarDWA, AStarOnlineDWA, LocalDWA], ids=lambda make: make.name)
def test_planners_reach_the_goal_in_an_open_arena(make):
    rows = run_episodes(frozen_arenas(5, 3, split="val"), lambda robots: make(robots=robots), Ranges())
    assert [row.outcome for row in rows] == ["success"] * 3
    assert all(row.travelled >= 0.9 * row.shortest for row in rows)


def test_a_star_passes_a_wall_that_a_local_planner_does_not():
    fence = [Obstacle("box", 0.0, y, 0.0, (0.2, 0.5), 1.0) for y in np.arange(-7.5, 6.0, 1.0)]
    arena = Arena("", 14, 0, tuple(fence), (-4.0, -1.0, 0.0), ((4.0, -1.0),))
    (row,) = run_episodes([arena], lambda robots: AStarDWA(robots=robots), Ranges())
    assert row.outcome == "success"
    (row,) = run_episodes([arena], lambda robots: LocalDWA(robots=robots), Ranges())
    assert row.outcome != "success"


def test_the_dynamic_window_avoids_what_is_ahead():
    window = DynamicWindow()
    wall = np.stack([np.full(41, 0.9), np.linspace(-1.0, 0.2, 41)], axis=1)
    pose, command = (0.0, 0.0, 0.0), (0.5, 0.0)
    for _ in range(100):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turned = np.array([[c, -s], [s, c]])
        points, target = (wall - pose[:2]) @ turned, (np.array([2.5, 0.5]) - pose[:2]) @ turned
        assert np.hypot(*np.maximum(np.abs(points) - (0.30, 0.25), 0).T).min() > 0
        command = window.choose(points, tuple(target), command)
        pose = arc(*pose, *command, 0.2)
    assert pose[0] > 1.5  # round its left end
    # a closed ring: no way at all
    angles = np.linspace(0, 2 * math.pi, 200)
    ring = 0.45 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    assert window.choose(ring, (2.0, 0.0), (0.0, 0.0))[0] == 0.0
    assert window.choose(np.empty((0, 2)), (2.0, 0.0), (1.0, 0.0)) == (1.0, 0.0)


@given(
    seed=st.integers(0, 2**31),
    speed=st.floats(0.0, 1.0),
    turn=st.floats(-1.2, 1.2),
    number=st.integers(0, 40),
)
@settings(max_examples=300, deadline=None)
def test_the_window_is_never_left(seed, speed, turn, number):
    """Among any obstacles, blocked or not, the command can be reached within one control period."""
    generator = np.random.default_rng(seed)
    points, target = generator.uniform(-1.5, 1.5, (number, 2)), generator.uniform(-2.0, 2.0, 2)
    found = WINDOW.choose(points, tuple(target), (speed, turn))
    assert abs(found[0] - speed) <= ACCELERATION * ROBOT.period + 1e-9
    assert abs(found[1] - turn) <= TURN_ACCELERATION * ROBOT.period + 1e-9
    assert 0 <= found[0] <= ROBOT.max_speed
    assert abs(found[1]) <= ROBOT.max_turn


# --- statistics


def test_summaries_weigh_success_by_the_length_of_the_path():
    assert spl(
        np.array([True, True, False]), np.array([10.0, 20.0, 5.0]), np.array([10.0, 10.0, 5.0])
    ) == pytest.approx(0.5)
    outcomes = ("success", "collision", "timeout", "success")
    summary = summarize([Episode(f"w{k}", 5, outcome, 10.0, 10.0, 9.0) for k, outcome in enumerate(outcomes)])
    assert summary["success"] + summary["collision"] + summary["timeout"] == 100

"""Plan far, steer near: out of traps, through doors, and never over places that nobody saw."""

from itertools import pairwise

import numpy as np
import pytest

from eldenet.navigation.episodes import Episodes, EpisodeSettings
from eldenet.navigation.evaluation import run_episodes, summarize
from eldenet.navigation.observer import Senses
from eldenet.navigation.planners.dwa import DynamicWindow
from eldenet.navigation.planners.online_map import OnlineMap
from eldenet.navigation.planners.plan_and_steer import SIDEWAYS, PlanAndSteer, is_circle, sideways
from eldenet.navigation.policy import Navigator
from eldenet.navigation.policy_files import DEFAULT_WEIGHTS
from eldenet.navigation.provenance import driver_identity
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.arenas import Arena
from eldenet.simulation.robot import ROBOT


@pytest.mark.parametrize("kind", ["open", "rooms", "traps"])
def test_it_reaches_the_goal_in_every_kind_of_arena(kind):
    arenas = frozen_arenas(10, 3, split="val", kind=kind)
    rows = run_episodes(arenas, lambda robots: PlanAndSteer(robots=robots), Ranges())
    assert summarize(rows)["success"] == 100


@pytest.mark.slow
def test_it_decides_the_same_alone_and_among_others():
    arenas = frozen_arenas(80, 3, split="val")
    make = lambda robots: PlanAndSteer(robots=robots)  # noqa: E731
    assert run_episodes(arenas, make, Ranges(), robots=3) == run_episodes(arenas, make, Ranges(), robots=1)


def test_it_drives_over_no_place_that_it_never_saw():
    driver = PlanAndSteer()
    driver.reset(0)
    near = np.full((1, ROBOT.columns), 2.0)
    goal = np.array([[8.0, 0.0]])
    driver.commands(Senses(near, np.zeros((1, 3)), goal))
    straight, left = 2, 0  # actions
    nothing = np.empty((0, 2))
    start, later = np.zeros(3), np.array([1.2, 0.0, np.pi / 2])  # turned to what was out of view
    assert driver._is_safe(0, straight, nothing, driver._unseen(0, start))
    assert driver._is_safe(0, left, nothing, driver._unseen(0, start))
    assert not driver._is_safe(0, straight, nothing, driver._unseen(0, later))
    assert not driver._is_safe(0, straight, np.array([[0.5, 0.0]]), nothing)


def test_it_is_fast_beside_a_wall_and_slow_before_things_and_near_the_goal():
    driver = PlanAndSteer(slows_within=1.0)
    straight, nothing = 2, np.empty((0, 2))
    beside = np.stack([np.linspace(-1, 2.5, 36), np.full(36, 0.5)], axis=1)
    close = beside - [0, 0.2]
    ahead = np.array([[1.5, 0.0]])
    assert driver._fastest(straight, 8.0, beside, nothing) == ROBOT.max_speed
    assert driver._fastest(straight, 8.0, close, nothing) == 0
    before_a_thing, before_the_unseen = (
        driver._fastest(straight, 8.0, *points) for points in ((ahead, nothing), (nothing, ahead))
    )
    assert 0 < before_a_thing <= before_the_unseen < 0.75
    assert driver._fastest(straight, 0.5, nothing, nothing) == 0.5


def test_it_drives_slower_after_it_slid():
    driver = PlanAndSteer(slows_within=1.0)
    far, goal = np.full((1, ROBOT.columns), ROBOT.far), np.array([[8.0, 0.0]])
    speeds = []
    for x, y in ((0.0, 0.0), (0.2, 0.0), (0.4, 0.04), (0.6, 0.04)):
        speeds.append(float(driver.commands(Senses(far, np.array([[x, y, 0.0]]), goal))[0, 0]))
    assert speeds == [1.0, 1.0, 0.5, 0.5]
    driver.reset(0)
    assert driver.commands(Senses(far, np.zeros((1, 3)), goal))[0, 0] == 1.0


@pytest.mark.parametrize(("friction", "slides"), [(1.1, False), (0.15, True)])
def test_a_robot_moves_sideways_only_where_it_slides(friction, slides):
    arena = Arena("", 0, 0, (), (-8.0, 0.0, 0.0), ((8.0, 0.0),))
    episodes = Episodes(1, Ranges(), EpisodeSettings("wheels", robot_friction=friction))
    episodes.start(0, arena, (0,))
    poses = [episodes.poses[0].copy()]
    for period in range(30):
        episodes.step(np.array([[1.0, 1.2 * (-1) ** (period // 5)]]))
        poses.append(episodes.poses[0].copy())
    assert (max(sideways(*pair) for pair in pairwise(poses)) > SIDEWAYS) == slides


def test_it_backs_up_where_it_can_only_stand():
    driver = PlanAndSteer()
    driver.reset(0)
    y = np.linspace(-0.3, 0.3, 13)
    ahead = np.stack([np.full(13, 0.36), y], axis=1)
    beside = [np.stack([np.linspace(-0.2, 0.3, 11), np.full(11, side)], axis=1) for side in (-0.31, 0.31)]
    walls = np.concatenate([ahead, *beside])
    nothing = np.empty((0, 2))
    assert driver._careful(0, 0.0, walls, nothing)[0] < 0
    behind = np.stack([np.full(13, -0.4), y], axis=1)
    driver.reset(0)
    assert driver._careful(0, 0.0, np.concatenate([walls, behind]), nothing) == (0.0, 0.0)


def test_with_a_lidar_it_turns_toward_the_target_while_it_backs_up():
    nothing = np.empty((0, 2))
    ahead = np.stack([np.full(13, 0.36), np.linspace(-0.3, 0.3, 13)], axis=1)
    corner = np.stack([np.full(5, -0.4), np.linspace(-0.45, -0.31, 5)], axis=1)  # behind, to the right
    cornered = np.concatenate([ahead, corner])
    for columns, walls, turns in ((40, ahead, (0, 0)), (206, ahead, (1, -1)), (206, cornered, (0, -1))):
        driver = PlanAndSteer()
        seen = np.full((1, columns), ROBOT.far)
        driver.commands(Senses(seen, np.zeros((1, 3)), np.array([[5.0, 0.0]])))
        for bearing, turn in zip((0.8, -0.8), turns, strict=True):
            driver.observer.last[:] = driver._backs[:] = 0
            speed, rate = driver._careful(0, bearing, walls, nothing)
            assert speed < 0
            assert np.sign(rate) == turn


def test_a_circle_is_a_place_again_after_a_way():
    turn = np.linspace(0, 2 * np.pi, 60)
    around = [(np.cos(t), np.sin(t), t) for t in turn]
    assert is_circle(around)
    assert not is_circle(around[:45])
    assert not is_circle([(0.1 * k, 0.0, 0.1 * k) for k in range(100)])
    assert not is_circle([(0.0, 0.0, 0.0)] * 100)  # it waits


def test_results_name_the_policy_that_steers():
    identity = driver_identity(PlanAndSteer())
    assert [file["file"] for file in identity["files"]] == [str(DEFAULT_WEIGHTS)]


def test_a_driver_that_backs_up_cannot_steer_for_a_plan(tmp_path):
    """Its arcs are checked ahead of the robot only."""
    driver = Navigator.load()
    driver.observer.options["turn_factors"] = [0.35, 0.75, 1.0, 0.75, -0.4]
    driver.save(tmp_path / "backs.safetensors")
    with pytest.raises(ValueError, match="give a policy that never backs up"):
        PlanAndSteer(tmp_path / "backs.safetensors")


def test_its_dynamic_window_keeps_out_of_places_that_nobody_saw():
    window, nothing = DynamicWindow(), np.empty((0, 2))
    y = np.linspace(-0.4, 0.4, 9)
    wall = np.stack([np.full(9, 0.7), y], axis=1)
    free = window.choose(nothing, (1.3, 0.0), (0.5, 0.0))
    assert free[0] > 0.5
    assert window.choose(nothing, (1.3, 0.0), (0.5, 0.0), wall)[0] <= 0.3


def test_beside_a_wall_it_may_turn_away():
    """Its rear comes nearer to the wall first, by a centimeter or two."""
    wall = np.stack([np.linspace(-2, 2, 81), np.full(81, -0.32)], axis=1)
    speeds = [DynamicWindow(slack).choose(wall, (1.2, 0.5), (0.4, 0.0)) for slack in (0.0, 0.025)]
    assert speeds[0][1] == 0 or speeds[0][0] < speeds[1][0]
    assert speeds[1][1] > 0


def test_what_rays_met_was_seen_and_what_is_behind_was_not():
    known, pose = OnlineMap(), np.zeros(3)
    known.add(known.place(pose), np.full(ROBOT.columns, 2.0))
    unseen = known.unseen_near(pose, 3.0)
    bearing = np.arctan2(unseen[:, 1], unseen[:, 0] - ROBOT.camera_ahead)
    away = np.hypot(*unseen.T)
    assert not ((np.abs(bearing) < 0.4) & (away < 1.9)).any()
    assert ((np.abs(bearing) < 0.4) & (away > 2.5)).any()
    assert not (away < 0.2).any()  # under the robot


def test_it_forgets_where_a_pedestrian_was():
    ahead = {}
    for walkers in (False, True):
        driver = PlanAndSteer(walkers=walkers)
        driver.reset(0)
        for period in range(8):  # from left to right, 2 m ahead
            ranges = np.full((1, ROBOT.columns), ROBOT.far)
            ranges[0, 30 - 3 * period : 36 - 3 * period] = 2.0
            driver.commands(Senses(ranges, np.zeros((1, 3)), np.array([[8.0, 0.0]])))
        ahead[walkers] = len(driver.observer.memory.points(0))
    assert ahead[True] == 0 < ahead[False]

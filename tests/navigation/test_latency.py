"""Delay: commands take effect late, and a driver that knows it decides for where it will be then."""

import math
from dataclasses import replace

import numpy as np
import pytest

from eldenet.navigation.episodes import Episodes, EpisodeSettings, Randomization
from eldenet.navigation.latency import Predictive, ahead
from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.observer import Observer, Senses
from eldenet.navigation.sensors import Ranges
from eldenet.simulation.arenas import Arena
from eldenet.simulation.robot import ROBOT

EMPTY = Arena("", 0, 0, (), (-8.0, 0.0, 0.0), ((8.0, 0.0),))


class Recorder:
    """A driver that drives a list of commands and keeps its senses."""

    name = "recorder"

    def __init__(self, commands: list[tuple[float, float]]) -> None:
        self.left, self.seen = list(commands), []

    def reset(self, robot, world=None):
        pass

    def commands(self, senses, robots=None):
        self.seen.append(senses)
        return np.array([self.left.pop(0)])


@pytest.mark.parametrize(("latency", "stands"), [(0.0, 0), (0.1, 1), (0.2, 2), (0.3, 3), (0.4, 4)])
def test_a_command_takes_effect_after_the_latency(latency, stands):
    episodes = Episodes(1, Ranges(latency=latency))
    episodes.start(0, EMPTY, (0,))
    ways = []
    for _ in range(4):
        before = episodes.travelled[0]
        episodes.step(np.array([[0.5, 0.0]]))
        ways.append(episodes.travelled[0] - before)
    # 0.5 m/s, reached within 0.15 s
    assert sum(ways) == pytest.approx(0.5 * (0.8 - 0.1 * stands), abs=0.05)
    assert [way < 1e-9 for way in ways] == [stands >= 2, stands >= 4, False, False]


@pytest.mark.parametrize("latency", [0.1, 0.2, 0.3, 0.4])
def test_the_predicted_pose_is_the_one_where_the_command_takes_effect(latency):
    commands = [(0.6, 0.5)] * 5 + [(0.4, -1.2)] * 5 + [(1.0, 0.0)] * 5
    driver = Recorder(commands)
    episodes, predictive = Episodes(1, Ranges(latency=latency)), Predictive(driver, latency)
    episodes.start(0, EMPTY, (0,))
    reached = []
    for _ in commands:
        reached.append(episodes.poses[0].copy())
        episodes.step(predictive.commands(episodes.sense()))
    periods = latency / ROBOT.period
    for number in range(10):
        expected = reached[number + int(periods)]
        if periods % 1:  # between two decisions
            expected = (expected + reached[number + int(periods) + 1]) / 2
        seen = driver.seen[number]
        assert seen.odometry[0] == pytest.approx(
            expected, abs=0.16
        )  # it accelerates, the prediction does not
        np.testing.assert_allclose(seen.scanned_from[0], reached[number], atol=1e-9)
        at = seen.odometry[0, 2] + seen.goal[0, 1]
        goal = seen.odometry[0, :2] + seen.goal[0, 0] * np.array([math.cos(at), math.sin(at)])
        assert goal == pytest.approx((8.0, 0.0), abs=1e-6)


def test_nothing_is_predicted_without_commands_or_delay():
    pose, goal = np.array([1.0, 2.0, 0.5]), np.array([3.0, -0.4])
    for sent, latency in (([], 0.4), ([(1.0, 0.5)], 0.0)):
        then, there = ahead(pose, goal, sent, latency)
        np.testing.assert_allclose(then, pose)
        np.testing.assert_allclose(there, goal)


def test_points_are_remembered_from_where_they_were_seen_and_speed_falls_early():
    ranges = np.full((1, ROBOT.columns), 1.2)
    goal, here, later = np.array([[8.0, 0.0]]), np.zeros((1, 3)), np.array([[0.3, 0.0, 0.0]])
    now, then = Observer(), Observer()
    now.observe(Senses(ranges, here, goal))
    then.observe(Senses(ranges, later, goal, None, here))
    assert now.memory.points(0) == pytest.approx(then.memory.points(0))
    assert then.speeds[0, 2] == pytest.approx(now.speeds[0, 2] - 0.3 / 1.2)


@pytest.mark.parametrize("make", [Ranges, NoisyRanges])
def test_a_latency_out_of_range_is_refused(make):
    with pytest.raises(ValueError, match=r"sensor\.latency=2\.0: give 0 to 1\.0 s"):
        make(latency=2.0)
    with pytest.raises(ValueError, match=r"sensor\.latency=0\.15: .* in steps of 0\.1, as 0\.2"):
        make(latency=0.15)
    for step in range(11):
        make(latency=step / 10)
        make(latency=step * 0.1)


def test_a_robot_may_be_larger_and_faster_than_its_driver_knows():
    ways = {}
    for name, settings in {
        "plain": EpisodeSettings("wheels"),
        "fast": EpisodeSettings("wheels", robot_speed=1.2),
        "large": EpisodeSettings("wheels", robot_size=1.15),
    }.items():
        episodes = Episodes(1, Ranges(), settings)
        episodes.start(0, EMPTY, (0,))
        for _ in range(10):
            episodes.step(np.array([[0.5, 0.2]]))
        ways[name] = episodes.travelled[0], episodes.poses[0, 2]
    assert ways["fast"][0] == pytest.approx(1.2 * ways["plain"][0], rel=0.05)
    assert ways["large"] == pytest.approx(ways["plain"], rel=0.1)
    with pytest.raises(ValueError, match=r"robot\.size=3\.0: give 0\.5 to 1\.5"):
        EpisodeSettings(robot_size=3.0)


def test_a_training_draws_another_robot_for_each_arena_and_episode():
    ranges = Randomization(size=(0.85, 1.15), speed=(0.8, 1.2), latency=(0.0, 0.4))
    episodes = Episodes(1, Ranges(), randomization=ranges)
    sizes, ways = set(), []
    for seed in range(20):
        episodes.start(0, replace(EMPTY, index=seed), (seed,))
        for _ in range(10):
            episodes.step(np.array([[0.5, 0.0]]))
        sizes.add(episodes.worlds[0].size)
        ways.append(episodes.travelled[0])
    assert len(sizes) == 20
    assert 0.85 <= min(sizes) < 0.95 < 1.05 < max(sizes) <= 1.15
    assert max(ways) > 1.4 * min(ways)  # faster, or sooner
    kept = episodes.worlds[0].size
    episodes.start(0, replace(EMPTY, index=19), (3,))
    assert episodes.worlds[0].size == kept  # the same arena
    episodes.start(0, EMPTY, (3,))
    assert episodes.worlds[0].size in sizes  # from the seed alone
    with pytest.raises(
        ValueError, match=r"training\.randomize\.size=\[0\.2, 1\.0\]: give \[least, greatest\] within 0\.5"
    ):
        Randomization(size=(0.2, 1.0))
    Randomization(speed=(0.5, 2.0))  # as far as an evaluation's robot.speed


@pytest.mark.parametrize("physics", ["kinematic", "wheels"])
def test_the_footprint_has_the_size_that_is_set(physics):
    gap = 0.32  # between the axle and the wall: free for 0.60 m of length, not for 0.69 m
    arena = Arena("", 0, 0, (), (10.0 - gap, 0.0, 0.0), ((-8.0, 0.0),))
    touched = []
    for size in (1.0, 1.15):
        episodes = Episodes(1, Ranges(), EpisodeSettings(physics, robot_size=size))
        episodes.start(0, arena, (0,))
        touched.append(int(episodes.step(np.array([[0.0, 0.0]]))[1][0]))
    assert touched == [0, 2]


def test_a_slippery_floor_lets_the_wheels_spin():
    ways = {}
    for friction in (1.1, 0.15):
        episodes = Episodes(1, Ranges(), EpisodeSettings("wheels", robot_friction=friction))
        episodes.start(0, EMPTY, (0,))
        for _ in range(3):
            episodes.step(np.array([[1.0, 0.0]]))
        ways[friction] = episodes.travelled[0]
    assert 0 < ways[0.15] < 0.8 * ways[1.1]
    with pytest.raises(ValueError, match=r"robot\.friction=9: give 0\.05 to 2"):
        EpisodeSettings("wheels", robot_friction=9)
    with pytest.raises(ValueError, match=r"robot\.friction=0\.2 has no effect with physics=kinematic"):
        EpisodeSettings(robot_friction=0.2)

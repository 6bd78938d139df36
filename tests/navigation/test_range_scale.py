"""What the range scale promises: ranges that are all wrong by one factor become right, others stay."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldenet.navigation.episodes import Episodes, EpisodeSettings
from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.policy import Navigator
from eldenet.navigation.range_scale import RangeScale
from eldenet.navigation.sensors import EXACT, Ranges
from eldenet.simulation.arenas import generate_arena
from eldenet.simulation.robot import ROBOT

ANGLES = np.array(ROBOT.column_angles)


POSTS = [(2.5, 1.2), (3.2, -1.0), (4.5, 0.9), (5.6, -1.3), (6.5, 1.4), (7.4, -0.8), (8.3, 1.1), (9.2, -1.2)]


def posts(pose: np.ndarray, radius: float = 0.3) -> np.ndarray:
    """Ranges among round posts, from their geometry alone ``(columns,)`` [m]."""
    camera = pose[:2] + ROBOT.camera_ahead * np.array([math.cos(pose[2]), math.sin(pose[2])])
    ahead = np.stack([np.cos(pose[2] + ANGLES), np.sin(pose[2] + ANGLES)], axis=1)
    to = np.array(POSTS) - camera
    along = ahead @ to.T
    square = radius**2 - ((to**2).sum(axis=1) - along**2)
    hit = (square > 0) & (along > 0)
    away = np.where(hit, along - np.sqrt(np.maximum(square, 0)), ROBOT.far)
    return away.min(axis=1)


def drive(factor: float, scale: RangeScale, turn: float = 0.02) -> list[tuple[np.ndarray, np.ndarray]]:
    """True and corrected ranges on the way past the posts, 0.1 m a scan."""
    out, pose = [], np.array([0.5, 0.0, 0.0])
    for step in range(50):
        true = posts(pose)
        out.append((true, scale(np.clip(true * factor, ROBOT.near, ROBOT.far), pose)[0]))
        pose = pose + np.array([0.1 * math.cos(pose[2]), 0.1 * math.sin(pose[2]), turn * math.cos(step / 8)])
    return out


@settings(deadline=None, max_examples=25)
@given(st.floats(0.75, 1.3), st.floats(-0.03, 0.03))
def test_a_factor_is_found_within_three_percent_or_left_alone(factor, turn):
    scale = RangeScale()
    drive(factor, scale, turn)
    left_alone = scale.factor == 1
    assert left_alone or scale.factor * factor == pytest.approx(1, abs=0.03)
    if abs(math.log(factor)) < 0.03:
        assert left_alone
    elif abs(math.log(factor)) > 0.14:
        assert not left_alone


def test_readings_at_the_ends_of_the_camera_stay():
    scale = RangeScale()
    scale.factor = 1.2
    ranges = np.full(ROBOT.columns, 5.0)
    ranges[0], ranges[-1] = ROBOT.near, ROBOT.far
    out, cautious = scale(ranges, np.zeros(3), ranges - 0.1)
    assert out.tolist() == [ROBOT.near, *[6.0] * 38, ROBOT.far]
    assert cautious[1] == pytest.approx(1.2 * 4.9)


def test_a_robot_that_stands_or_turns_learns_nothing():
    scale = RangeScale()
    for step in range(40):
        pose = np.array([0.5, 0.0, 0.05 * step])
        scale(0.8 * posts(pose), pose)
    assert scale.factor == 1.0


def test_it_forgets_at_a_new_start():
    scale = RangeScale()
    drive(0.85, scale)
    assert scale.factor != 1
    scale.reset()
    assert scale.factor == 1
    again, fresh = drive(1.15, scale), drive(1.15, RangeScale())
    assert all((one[1] == other[1]).all() for one, other in zip(again, fresh, strict=True))


def crossing(sensor, range_scale: bool) -> tuple[list[np.ndarray], float]:
    """Ranges of a crossing, and the factor at its end."""
    episodes = Episodes(1, sensor, EpisodeSettings("wheels", range_scale=range_scale))
    episodes.start(0, generate_arena("val", 80, 1), (0, 1))
    driver, out = Navigator.load(), []
    for _ in range(40):
        out.append(episodes.sense().ranges[0])
        episodes.step(driver.commands(episodes.senses()))
    return out, episodes._scales[0].factor


@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_episodes_correct_a_sensor_with_a_factor(factor):
    assert crossing(Ranges(factor=factor), True)[1] * factor == pytest.approx(1, abs=0.025)
    assert crossing(Ranges(factor=factor), False)[1] == 1


@pytest.mark.parametrize("sensor", [Ranges(), NoisyRanges(errors="packaged", drift=EXACT)])
def test_true_ranges_and_those_of_a_network_stay(sensor):
    with_it, factor = crossing(sensor, True)
    without, _ = crossing(sensor, False)
    assert factor == 1
    assert all((one == other).all() for one, other in zip(with_it, without, strict=True))


def test_the_navigator_corrects_if_it_is_asked_to():
    navigator, plain = Navigator.load(), Navigator.load()
    navigator.range_scale = RangeScale()
    pose, same = np.array([0.5, 0.0, 0.0]), []
    for _ in range(40):
        ranges = 0.8 * posts(pose)
        steps = [one.step(ranges, (8.0 - pose[0], 0.0), pose) for one in (navigator, plain)]
        same.append(steps[0] == steps[1])
        pose = pose + np.array([0.1, 0.0, 0.0])
    assert navigator.range_scale.factor == pytest.approx(1.25, abs=0.03)
    assert same[0]
    navigator.reset()
    assert navigator.range_scale.factor == 1

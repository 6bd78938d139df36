"""Navigation: position fixes and odometry that drifts."""

import math

import numpy as np
import pytest

from eldenet.navigation.episodes import Episodes, EpisodeSettings
from eldenet.navigation.localization import Localizer
from eldenet.navigation.sensors import Drift, Odometry, Ranges
from eldenet.simulation.arenas import generate_arena


def drive(localizer: Localizer, odometry: Odometry, rng: np.random.Generator, steps: int, deviation: float):
    """Drive a winding path with a fix per second; return the true pose at its end."""
    pose = odometry.pose
    for step in range(1, steps + 1):
        yaw = pose[2] + 0.1 * math.sin(step / 7)
        after = (pose[0] + 0.14 * math.cos(pose[2]), pose[1] + 0.14 * math.sin(pose[2]), yaw)
        odometry.move(pose, after)
        pose = after
        localizer.move(odometry.pose)
        if step % 5 == 0 and deviation < math.inf:
            localizer.fix(*(np.array(pose[:2]) + deviation * rng.standard_normal(2)).tolist())
    return pose


def test_without_fixes_the_pose_is_the_odometry():
    rng = np.random.default_rng(0)
    odometry = Odometry(Drift(), rng, (1.0, 2.0, 0.3))
    localizer = Localizer((1.0, 2.0, 0.3), deviation=0.1)
    drive(localizer, odometry, rng, 50, math.inf)
    assert localizer.pose == pytest.approx(odometry.pose, abs=1e-9)
    assert localizer.odometry == pytest.approx(odometry.pose, abs=1e-9)


def test_fixes_bound_the_error_and_calibrate_the_odometry():
    poses, headings, scales, drifts, raw = [], [], [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        odometry = Odometry(Drift(), rng, (0.0, 0.0, 0.0))
        localizer = Localizer((0.0, 0.0, 0.0), deviation=0.15)
        true = drive(localizer, odometry, rng, 120, 0.15)
        poses.append(math.dist(localizer.pose[:2], true[:2]))
        headings.append(localizer.pose[2] - true[2])
        scales.append(odometry.scale - 1 - localizer._state[3])
        drifts.append(odometry.turn_per_meter - localizer._state[4])
        raw.append(math.dist(odometry.pose[:2], true[:2]))
    deviation = [float(np.sqrt(np.mean(np.square(values)))) for values in (poses, headings, scales, drifts)]
    assert deviation[0] < 0.13  # less than a single fix is wrong by (0.21 m)
    assert math.degrees(deviation[1]) < 1.2
    assert deviation[2] < 0.01  # of 0.02
    assert math.degrees(deviation[3]) < 0.15  # of 1 degree a meter
    assert float(np.sqrt(np.mean(np.square(raw)))) > 1.5


def test_bearings_are_counter_clockwise_from_ahead():
    localizer = Localizer((1.0, 1.0, math.pi / 2), deviation=0.1)
    assert localizer.towards(1.0, 4.0) == pytest.approx((3.0, 0.0))
    assert localizer.towards(0.0, 1.0) == pytest.approx((1.0, math.pi / 2))


def test_episodes_with_fixes_know_the_goal_within_decimeters():
    sensor = Ranges(drift=Drift(0.05, math.radians(3)))
    episodes = Episodes(2, sensor, EpisodeSettings(goal="fixes"))
    lost = Episodes(2, sensor, EpisodeSettings(goal="odometry"))
    for running in (episodes, lost):
        for slot in range(2):
            running.start(slot, generate_arena("val", 0, slot), (5, slot))
        for step in range(60):
            running.step(np.full((2, 2), (0.6, 0.6 * math.sin(step / 5))))
    error = np.abs(episodes.sense().goal - episodes.goals())
    assert error[:, 0].max() < 0.3
    assert (np.abs(lost.sense().goal - lost.goals())[:, 1] > 3 * error[:, 1]).all()
    assert (episodes.poses == lost.poses).all()  # fixes change no random number of the rest

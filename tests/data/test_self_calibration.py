"""A drive tells the focal length and the mount of its camera, whatever was told, or says that it does not."""

import math

import cv2
import numpy as np
import pytest

from eldenet.data.self_calibration import Pair, fit_camera, floor_below, from_told
from eldenet.geometry import level_rotation, pinhole

TRUE = pinhole(230.0, 230.0, 159.5, 119.5)
FORWARD = np.array([0.0, 0.0, 1.0])


def pairs(
    pitch: float = 0.0, yaw: float = 0.0, ahead: float = 0.0, *, curve: float = 0.1, drift: float = 0.002
) -> list[Pair]:
    """Corners of a camera that is mounted so [rad], [m]; motions are of a level one on the axle."""
    rng = np.random.default_rng(0)
    mount = from_told(pitch, yaw)
    found = []
    for number in range(60):
        turn = curve * math.sin(number)
        motion = np.eye(4)
        motion[:3, :3] = cv2.Rodrigues(np.array([0.0, turn, 0.0]))[0]
        motion[:3, 3] = (0.0, 0.0, -0.1)
        rays = np.column_stack([rng.uniform(-0.7, 0.7, 90), rng.uniform(-0.5, 0.5, 90), np.ones(90)])
        points = rays * rng.uniform(0.8, 5.0, 90)[:, None]  # in the true camera's frame
        told = points @ mount  # in that of the camera that was told
        before = told + ahead * FORWARD  # in that of a camera above the axle
        later = (before @ motion[:3, :3].T + motion[:3, 3] - ahead * FORWARD) @ mount.T
        here, there = ((seen @ TRUE.T)[:, :2] / seen[:, 2:] for seen in (points, later))
        there += rng.normal(0, 0.3, there.shape)
        there[:9] += rng.uniform(-30, 30, (9, 2))  # a tenth was mistaken
        error = np.eye(4)  # of the odometry: usually 0.1 degrees, 2 % of the way
        error[:3, :3] = cv2.Rodrigues(np.array([0.0, rng.normal(0, drift), 0.0]))[0]
        error[:3, 3] = rng.normal(0, drift, 3) * (1, 0, 1)
        found.append(Pair(here, there, error @ motion))
    return found


def told(factor: float) -> np.ndarray:
    """Intrinsics ``(3, 3)`` with another focal length."""
    return pinhole(factor * 230, factor * 230, 159.5, 119.5)


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.6])
@pytest.mark.parametrize(("pitch", "yaw", "ahead"), [(0.0, 0.0, 0.0), (0.1, -0.08, 0.25)])
def test_focal_length_and_mount_are_found_whatever_was_told(factor, pitch, yaw, ahead):
    fit = fit_camera(pairs(pitch, yaw, ahead), told(factor), FORWARD)
    assert fit.focal == pytest.approx(1 / factor, rel=0.02)
    assert fit.pitch == pytest.approx(pitch, abs=0.01)
    assert fit.yaw == pytest.approx(yaw, abs=0.02)
    assert fit.ahead == pytest.approx(ahead, abs=0.02)


def test_poses_of_the_camera_itself_tell_the_focal_length_alone():
    fit = fit_camera(pairs(), told(1.25))
    assert fit.focal == pytest.approx(0.8, rel=0.02)
    assert fit[1:] == (None, None, None)


@pytest.mark.parametrize("drift", [0.0, 0.002])
def test_a_straight_drive_tells_the_mount_and_not_the_focal_length(drift):
    fit = fit_camera(pairs(0.1, curve=0.0, drift=drift), TRUE, FORWARD)
    assert fit.focal is None
    assert fit.ahead is None
    assert fit.pitch == pytest.approx(0.1, abs=0.02)


@pytest.mark.slow
def test_odometry_whose_heading_drifts_tells_lens_and_pitch_all_the_same():
    yaws = np.repeat((0.1, 0.05, 0.0, -0.05, -0.1), 12)
    fit = fit_camera([pairs(0.1, yaw)[k] for k, yaw in enumerate(yaws)], told(1.4), FORWARD)
    assert fit.yaw is None
    assert fit.focal == pytest.approx(1 / 1.4, rel=0.03)
    assert fit.pitch == pytest.approx(0.1, abs=0.01)


@pytest.mark.slow
def test_few_pairs_or_corners_that_fit_no_camera_tell_nothing():
    assert fit_camera(pairs()[:20], TRUE, FORWARD) == (None, None, None, None)
    mistaken = [pair._replace(there=pair.there[::-1]) for pair in pairs()]
    assert fit_camera(mistaken, TRUE, FORWARD) == (None, None, None, None)


@pytest.mark.slow
def test_a_heading_of_the_wrong_sign_tells_nothing():
    other = np.eye(4)
    turned = []
    for pair in pairs():
        other[:3, :3], other[:3, 3] = pair.motion[:3, :3].T, pair.motion[:3, 3]
        turned.append(pair._replace(motion=other.copy()))
    assert fit_camera(turned, TRUE, FORWARD) == (None, None, None, None)


def on_a_floor(height: float, pitch: float, *, clutter: int = 60, floor: int = 60) -> list[Pair]:
    """Corners on a floor so far below a camera that drives straight on, and anywhere above it."""
    rng = np.random.default_rng(1)
    level = level_rotation(pitch)
    found = []
    for _ in range(40):
        below = np.concatenate([np.full(floor, height), height * rng.uniform(0.05, 0.95, clutter)])
        ahead = rng.uniform(0.7, 2.5, len(below))
        points = np.column_stack([ahead * rng.uniform(-0.6, 0.6, len(below)), below, ahead])  # level
        motion = np.eye(4)
        motion[:3, 3] = level.T @ (0.0, 0.0, -0.1)
        seen = points @ level
        here, there = ((at @ TRUE.T)[:, :2] / at[:, 2:] for at in (seen, seen + motion[:3, 3]))
        found.append(Pair(here, there + rng.normal(0, 0.3, there.shape), motion))
    return found


@pytest.mark.parametrize(("height", "pitch"), [(0.15, 0.0), (0.4, 0.2), (1.2, 0.35)])
def test_corners_on_the_floor_tell_how_far_below_the_camera_it_lies(height, pitch):
    assert floor_below(on_a_floor(height, pitch), TRUE, pitch) == pytest.approx(height, rel=0.03)


def test_no_floor_in_view_tells_no_height():
    assert floor_below(on_a_floor(0.4, 0.0, clutter=20, floor=0), TRUE, 0.0) is None
    assert floor_below([], TRUE, 0.0) is None

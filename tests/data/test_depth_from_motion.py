"""Depth from motion agrees with scenes of known depth, whatever odometry gets wrong within its bounds."""

import cv2
import numpy as np
import pytest

from eldenet.data.depth_from_motion import MotionDepth, beside_floor, bundle
from eldenet.geometry import level_rotation, pinhole

SIZE = (120, 160)
CAMERA = pinhole(130.0, 130.0, 79.5, 59.5)
TEXTURE = cv2.resize(
    np.random.default_rng(0).integers(0, 255, (150, 200, 3), np.uint8),
    (800, 600),
    interpolation=cv2.INTER_CUBIC,
)
RNG = np.random.default_rng(1)


def pose(way: tuple[float, float, float], turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Camera to world of a camera moved by ``way`` [m] and turned by ``turn`` [rad]."""
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = cv2.Rodrigues(np.array(turn))[0], way
    return camera


def points(count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Rays ``(N, 2)`` of points in front of a camera, and their depth ``(N,)`` [m]."""
    return RNG.uniform(-0.5, 0.5, (count, 2)), RNG.uniform(0.5, 5.0, count)


def seen_from(rays: np.ndarray, depth: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """The points ``(V, N, 2)`` as other views see them, x / z and y / z."""
    world = np.column_stack([rays, np.ones(len(rays))]) * depth[:, None]
    moved = world @ motions[:, :3, :3].transpose(0, 2, 1) + motions[:, None, :3, 3]
    return moved[..., :2] / moved[..., 2:]


def drive(scale: float = 1.0) -> np.ndarray:
    """Motions ``(V, 4, 4)`` from a view to six others of a robot that drives ahead in a bow."""
    ways = np.array([-0.4, -0.2, -0.1, 0.1, 0.2, 0.4])
    return np.stack(
        [np.linalg.inv(pose((0.3 * w * scale, 0.0, w * scale), (0.0, 0.2 * w, 0.0))) for w in ways]
    )


def wrong(motions: np.ndarray, turn: float, share: float) -> np.ndarray:
    """The motions as odometry says them: turned by ``turn`` [rad per m], their ways off by a share."""
    found = motions.copy()
    for motion in found:
        way = np.linalg.norm(motion[:3, 3])
        motion[:3, :3] = cv2.Rodrigues(np.array([0.0, turn * way, 0.0]))[0] @ motion[:3, :3]
        motion[:3, 3] *= 1 + share
    return found


def test_points_that_six_views_agree_on_have_their_depth():
    rays, depth = points()
    seen = seen_from(rays, depth, drive())
    inverse, sigma = bundle(rays, seen + RNG.normal(0, 0.3 / 400, seen.shape), drive(), 400.0)
    sure = sigma < 0.1 * inverse
    assert sure.mean() > 0.6
    error = np.abs(np.log(inverse * depth))[sure]
    assert np.median(error) < 0.02
    assert np.median(error / (sigma / inverse)[sure]) < 1  # sigma is no promise too small


def test_odometry_that_turns_wrongly_is_corrected():
    rays, depth = points()
    seen = seen_from(rays, depth, drive())
    told = wrong(drive(), np.radians(0.5), 0.0)
    inverse, sigma = bundle(rays, seen, told, 400.0)
    sure = sigma < 0.1 * inverse
    assert np.median(np.abs(np.log(inverse * depth))[sure]) < 0.01


@pytest.mark.parametrize("share", [-0.1, 0.02, 0.1])
def test_a_scale_error_of_odometry_scales_depth_and_nothing_else(share):
    rays, depth = points()
    seen = seen_from(rays, depth, drive())
    true, true_sigma = bundle(rays, seen, drive(), 400.0)
    found, sigma = bundle(rays, seen, wrong(drive(), 0.0, share), 400.0)
    sure = true_sigma < 0.1 * true
    np.testing.assert_allclose(true[sure] / found[sure], 1 + share, rtol=1e-3)
    np.testing.assert_allclose((sigma / found)[sure], (true_sigma / true)[sure], rtol=1e-2)


def test_a_point_that_moves_or_was_mistaken_is_given_up():
    rays, depth = points()
    seen = seen_from(rays, depth, drive())
    seen[:, :20] += RNG.normal(0, 0.05, (6, 20, 2))  # 20 pixels
    _, sigma = bundle(rays, seen, drive(), 400.0)
    assert np.isinf(sigma[:20]).mean() > 0.9
    assert np.isfinite(sigma[20:]).mean() > 0.9


def test_a_camera_that_does_not_move_is_unsure_of_all_depth():
    rays, depth = points()
    turns = np.stack([np.linalg.inv(pose((1e-3, 0.0, 0.0), (0.0, turn, 0.0))) for turn in (-0.1, 0.05, 0.1)])
    inverse, sigma = bundle(rays, seen_from(rays, depth, turns), turns, 400.0)
    assert not (sigma < 0.1 * inverse).any()


def wall(camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Picture ``(H, W, 3)`` and depth ``(H, W)`` [m] of a wall 2 m ahead that is slanted by 0.6 rad."""
    normal, distance = np.array([np.sin(0.6), 0.0, -np.cos(0.6)]), -2.0 * np.cos(0.6)
    columns, rows = np.meshgrid(np.arange(SIZE[1]), np.arange(SIZE[0]))
    rays = np.stack([columns, rows, np.ones(SIZE)], -1) @ np.linalg.inv(CAMERA).T
    depth = (distance - camera[:3, 3] @ normal) / (rays @ camera[:3, :3].T @ normal)
    world = (rays * depth[..., None]) @ camera[:3, :3].T + camera[:3, 3]
    along = np.array([np.cos(0.6), 0.0, np.sin(0.6)])
    at = np.stack([world @ along * 130 + 400, world[..., 1] * 130 + 300], -1).astype(np.float32)
    return cv2.remap(TEXTURE, at[..., 0], at[..., 1], cv2.INTER_LINEAR), depth


def test_depth_along_a_drive_past_a_wall_is_that_of_the_wall():
    solver = MotionDepth(CAMERA, SIZE)
    cameras = [pose((0.0, 0.0, 0.05 * i), (0.0, 0.01 * i, 0.0)) for i in range(14)]
    views = [solver.view(str(i), wall(camera)[0], camera) for i, camera in enumerate(cameras)]
    labeled = list(solver.along(views, spacing=0.2))
    assert 2 < len(labeled) < 6
    for view, found in labeled:
        columns, rows = np.rint(found.pixels).astype(int).T
        error = np.log(found.depth / wall(view.pose)[1][rows, columns])
        assert len(error) > 60
        assert abs(np.median(error)) < 0.03
        assert np.percentile(np.abs(error), 90) < 0.15


def test_what_a_robot_drives_up_to_keeps_its_corners_though_each_view_shows_it_at_another_size():
    solver = MotionDepth(CAMERA, SIZE)
    cameras = [pose((0.0, 0.0, 1.3 + 0.05 * i)) for i in range(8)]
    views = [solver.view(str(i), wall(camera)[0], camera) for i, camera in enumerate(cameras)]
    found = solver.points(views[-1], views[-2::-1], [])
    columns, rows = np.rint(found.pixels).astype(int).T
    depth = wall(cameras[-1])[1][rows, columns]
    assert len(depth) > 300
    assert np.median(depth) < 0.5
    assert np.median(np.abs(np.log(found.depth / depth))) < 0.015


def test_views_that_show_something_else_give_no_points():
    solver = MotionDepth(CAMERA, SIZE)
    view = solver.view("a", wall(np.eye(4))[0], np.eye(4))
    cameras = [pose((0.1 * i, 0.0, 0.0)) for i in (1, 2, 3, 4)]
    same, others = (
        [solver.view("b", picture(wall(camera)[0]), camera) for camera in cameras]
        for picture in (np.copy, lambda shown: shown[::-1, ::-1].copy())
    )
    assert len(solver.points(view, same, []).depth) > 60
    assert len(solver.points(view, others, []).depth) < 6


def test_points_on_the_floor_take_its_height_and_points_below_it_are_given_up():
    rotation = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]) @ level_rotation(0.2)
    rays = np.array([[0.0, 0.3], [0.0, 0.3], [0.0, 0.3], [0.0, -0.3]])
    down = 0.3 * np.cos(0.2) + np.sin(0.2)
    floor = down / 0.4  # inverse depth of the floor below a camera at 0.4 m
    inverse = np.array([1.03, 2.0, 0.5, 1.0]) * floor
    sigma = np.full(4, 0.08 * floor)
    found, spread = beside_floor(inverse, sigma, rays, rotation, 0.4)
    assert abs(found[0] / floor - 1) < 0.01
    assert spread[0] < sigma[0]
    assert (found[[1, 3]] == inverse[[1, 3]]).all()  # a thing before the floor, and what is above the horizon
    assert np.isinf(spread[2])

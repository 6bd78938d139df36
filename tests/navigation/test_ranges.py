"""From depth maps and boxes to ranges per column: holes, blindness, other cameras."""

import math

import numpy as np
import pytest

from eldenet.geometry import level_rotation
from eldenet.navigation.on_robot import as_ranges
from eldenet.navigation.ranges import depth_to_ranges, footprints_to_ranges
from eldenet.simulation.arena_view import ArenaView
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import Arena, generate_arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT


def hall(
    *boxes: tuple[float, float, float, float], size=(96, 128), camera_height=ROBOT.camera_height
) -> tuple[np.ndarray, np.ndarray]:
    """Depth of a floor, a wall at 8 m and boxes (distance, right side's, left side's place, height) [m]."""
    height, width = size
    focal = width / 2 / math.tan(ROBOT.field_of_view / 2)
    intrinsics = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    left = (intrinsics[0, 2] - np.arange(width)) / focal
    down = ((np.arange(height) - intrinsics[1, 2]) / focal)[:, None]
    depth = np.minimum(camera_height / np.maximum(down, 1e-6), 8.0) * np.ones(width)
    for at, first, last, top in boxes:
        on = (left > first / at) & (left < last / at)
        on = on & (down * at < camera_height) & (down * at > camera_height - top)
        depth[on & (depth > at)] = at
    return depth, intrinsics


@pytest.mark.parametrize(("size", "unknown"), [((96, 128), 0.0), ((480, 640), np.nan), ((96, 128), -1.0)])
def test_small_holes_in_a_depth_map_are_no_obstacles(size, unknown):
    depth, intrinsics = hall((3.0, -0.4, 0.4, 0.6), size=size)
    true = depth_to_ranges(depth, intrinsics)
    assert true.min() == pytest.approx(3.0, abs=0.01)
    rng = np.random.default_rng(0)
    for share in (0.01, 0.1):
        holes = np.where(rng.random(depth.shape) < share, unknown, depth)
        assert depth_to_ranges(holes, intrinsics) == pytest.approx(true, rel=0.05)
    depth[: size[0] // 8] = unknown  # as stereo loses the upper rows
    depth[-2:] = unknown
    assert (depth_to_ranges(depth, intrinsics) == true).all()


@pytest.mark.parametrize(("at", "top"), [(0.9, 0.3), (2.0, 0.3), (2.0, 1.0), (4.0, 0.6)])
def test_an_unknown_patch_is_an_obstacle_where_it_meets_the_floor(at, top):
    depth, intrinsics = hall((at, -0.3, 0.3, top), size=(240, 320))
    true = depth_to_ranges(depth, intrinsics)
    depth[depth == at] = 0.0
    got = depth_to_ranges(depth, intrinsics)
    assert got == pytest.approx(true, rel=0.06)
    assert got.min() < at * 1.06


@pytest.mark.parametrize("shoes", [0.02, 0.06, 0.10, 0.14])
@pytest.mark.parametrize("at", [1.2, 2.0, 4.0])
def test_an_unknown_patch_is_as_near_as_what_is_visible_below_it(at, shoes):
    depth, intrinsics = hall((at, -0.3, 0.3, 1.7), size=(480, 640))  # black trousers
    true = depth_to_ranges(depth, intrinsics)
    lower, _ = hall((at, -0.3, 0.3, shoes), size=(480, 640))
    depth[(depth == at) & (lower != at)] = np.nan
    assert depth_to_ranges(depth, intrinsics) == pytest.approx(true, rel=0.1)


def test_infinite_depth_is_far():
    depth, intrinsics = hall()
    assert (depth_to_ranges(np.where(depth > 5, np.inf, depth), intrinsics) == ROBOT.far).all()


@pytest.mark.parametrize("camera_height", [0.2, 0.4, 0.8, 1.4])
def test_a_blind_camera_reads_as_near_at_any_height(camera_height):
    """Also above the highest point that the robot can touch."""
    depth, intrinsics = hall(camera_height=camera_height, size=(480, 640))

    def ranges(seen: np.ndarray) -> np.ndarray:
        return depth_to_ranges(seen, intrinsics, camera_height=camera_height)

    free = ranges(depth)
    assert (free > 7.9).all()
    for blind in (0.0, np.nan, -np.inf):
        assert (ranges(np.full_like(depth, blind)) == ROBOT.near).all()
        seen = depth.copy()
        seen[120:, 200:300] = blind  # a thing so close that stereo loses it, and the floor below it
        assert (ranges(seen) == ROBOT.near).sum() >= 5
        dead = depth.copy()
        dead[:, 250] = blind
        assert ranges(dead) == pytest.approx(free, rel=0.01)


def test_a_camera_at_another_height_sees_the_same_wall():
    """10 cm lower it sees the floor nearer, and must not take it for an obstacle."""
    depth, intrinsics = hall(camera_height=0.2)
    assert depth_to_ranges(depth, intrinsics).min() < 2.0
    assert depth_to_ranges(depth, intrinsics, camera_height=0.2).min() == pytest.approx(8.0, abs=0.01)


def test_ranges_from_depth_agree_with_rays():
    arena = generate_arena("val", 40, 5)
    world, view = ArenaWorld(arena), ArenaView(arena, (120, 160))
    depth = view.photo(arena.start).depth
    got, true = depth_to_ranges(depth, view.intrinsics), world.ranges()
    near = true < 8
    assert near.sum() > 10
    assert np.median(np.abs(got - true)[near] / true[near]) < 0.03
    assert (got > true * 1.1).mean() < 0.05  # never far where something is near


def test_ranges_of_sectors_are_spread_over_the_columns():
    sectors = as_ranges(np.array([0.0, np.nan, np.inf, 5.0, 0.1]), None).reshape(5, -1)[:, 0]
    assert sectors.tolist() == [0.3, 0.3, 10, 5, 0.3]
    with pytest.raises(ValueError, match="intrinsics"):
        as_ranges(np.ones((4, 4)), None)
    with pytest.raises(ValueError, match=r"\(7,\)"):
        as_ranges(np.ones(7), None)


def test_ranges_from_boxes_agree_with_rays():
    box = Obstacle("box", 3.0, 0.7, 0.4, (0.5, 0.3), 1.0)
    arena = Arena("", 1, 0, (box,), (0.0, 0.0, 0.0), ((5.0, 0.0),))
    true = ArenaWorld(arena).ranges()
    got = footprints_to_ranges(np.array([[3.0 - ROBOT.camera_ahead, 0.7, 0.4, 0.5, 0.3]]))
    on_box = got < ROBOT.far
    assert on_box.sum() > 5
    assert got[on_box] == pytest.approx(true[on_box], abs=1e-4)
    assert (footprints_to_ranges(np.empty((0, 5))) == ROBOT.far).all()


@pytest.mark.parametrize("wrong", [0.0, np.nan, 0.3, -np.inf])
def test_a_dead_pixel_column_is_no_obstacle(wrong):
    depth, intrinsics = hall((3.0, -0.4, 0.4, 0.6), size=(480, 640))
    true = depth_to_ranges(depth, intrinsics)
    depth[:, [50, 200, 330, 500]] = wrong
    assert depth_to_ranges(depth, intrinsics) == pytest.approx(true, rel=0.01)
    free = np.full((480, 640), np.inf)
    free[:, 200] = wrong
    assert (depth_to_ranges(free, intrinsics) == ROBOT.far).all()


@pytest.mark.parametrize(
    ("fov", "size", "pitch"),
    [(60, (480, 640), 0.3), (60, (480, 640), 0.4), (69.4, (96, 128), 0.5), (55, (360, 640), -0.3)],
)
def test_a_tilted_camera_calls_no_column_free_in_which_it_sees_the_floor_close_by_alone(
    fov: float, size: tuple[int, int], pitch: float
) -> None:
    """By rays to points 3 m ahead: a column is free only where the picture shows one of them."""
    height, width = size
    focal = width / 2 / math.tan(math.radians(fov / 2))
    intrinsics = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    ranges = depth_to_ranges(np.full(size, np.inf), intrinsics, tilt=(pitch, 0.0))
    shown, step = [], ROBOT.field_of_view / ROBOT.columns
    for angle in np.array(ROBOT.column_angles)[:, None] + step * np.array([-0.49, 0, 0.49]):
        up = ROBOT.camera_height - np.linspace(0.16, 0.59, 40)  # below the camera
        level = np.stack(np.broadcast_arrays(-3.0 * np.tan(angle)[:, None], up, 3.0)).reshape(3, -1)
        c, s = math.cos(pitch), math.sin(pitch)
        x, y, z = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ level
        u, v = focal * x / z + (width - 1) / 2, focal * y / z + (height - 1) / 2
        inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5) & (z > 0)
        shown.append(inside.any())
    shown = np.array(shown)
    assert 30 <= shown.sum() < 40
    assert (np.isnan(ranges) | shown).all()
    assert (ranges == ROBOT.far).sum() >= shown.sum() - 2  # less than a pixel of a column may show it


@pytest.mark.parametrize(
    ("fov", "size", "camera_height", "pitch", "roll"),
    [
        (60, (90, 160), 0.3, 0.19, 0.0), (60, (90, 160), 1.25, 0.42, 0.0), (55, (160, 120), 0.3, 0.4, -0.1),
        (55, (96, 128), 1.5, 0.38, 0.05), (69.4, (96, 128), 0.4, 0.4, 0.0),
    ],
)  # fmt: skip
def test_no_column_is_free_that_shows_too_little_of_a_wall_for_an_obstacle(
    fov: float, size: tuple[int, int], camera_height: float, pitch: float, roll: float
) -> None:
    """A wall 3 m ahead, right across the picture; outer columns show a few pixels of it."""
    height, width = size
    focal = width / 2 / math.tan(math.radians(fov / 2))
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height), [1.0])).reshape(3, -1)
    intrinsics = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    _, down, ahead = level_rotation(pitch, roll) @ np.linalg.inv(intrinsics) @ pixels
    depth = np.minimum(3.0 / ahead, camera_height / np.maximum(down, 1e-6)).reshape(size)
    ranges = depth_to_ranges(depth, intrinsics, camera_height=camera_height, tilt=(pitch, roll))
    assert np.isfinite(ranges).sum() >= 28
    assert np.nanmax(ranges) < 3.0 / math.cos(ROBOT.field_of_view / 2) + 0.1


@pytest.mark.parametrize(("camera_height", "pitch", "roll"), [(1.4, 0.0, 0.0), (1.0, -0.15, 0.1)])
@pytest.mark.parametrize("away", [0.5, 1.0, 2.0])
def test_a_wall_is_near_though_a_high_camera_shows_only_what_is_above_the_robot(
    away: float, camera_height: float, pitch: float, roll: float
) -> None:
    rays = np.stack(np.meshgrid((np.arange(160) - 79.5) / 115, (np.arange(90) - 44.5) / 115, [1.0]))
    _, down, ahead = level_rotation(pitch, roll) @ rays.reshape(3, -1)
    depth = np.minimum(away / ahead, camera_height / np.maximum(down, 1e-6)).reshape(90, 160)
    camera = {"camera_height": camera_height, "tilt": (pitch, roll)}
    ranges = depth_to_ranges(depth, (115, 115, 79.5, 44.5), **camera)
    assert ranges[20] == pytest.approx(away, rel=0.01)
    assert np.nanmax(ranges) < away / math.cos(ROBOT.field_of_view / 2)


@pytest.mark.parametrize(
    ("camera_height", "pitch", "roll"),
    [(0.4, 0.5, 0.0), (0.4, -0.5, 0.0), (0.4, 0.36, 0.3), (1.2, 0.0, 0.0), (2.5, 0.0, 0.0)],
)
def test_a_camera_that_does_not_show_all_that_stands_ahead_is_refused(
    camera_height: float, pitch: float, roll: float
) -> None:
    said = (
        rf"^a camera {camera_height} m high with camera_pitch={pitch:g} and camera_roll={roll:g} does not "
        r"show what stands 3 m ahead, 0\.15 to 0\.6 m above the floor, up to 25\.0 degrees to each side: "
        r"mount it so that it does, or give the whole picture$"
    )
    level, intrinsics = np.full((360, 640), np.inf), (457, 457, 319.5, 179.5 if camera_height < 1 else 300.0)
    with pytest.raises(ValueError, match=said):
        depth_to_ranges(level, intrinsics, camera_height=camera_height, tilt=(pitch, roll))


def test_a_far_low_object_still_has_enough_pixels():
    for size in ((96, 128), (480, 640)):
        depth, intrinsics = hall((6.0, -0.5, 0.5, 0.3), size=size)
        assert depth_to_ranges(depth, intrinsics).min() == pytest.approx(6.0, rel=0.02)

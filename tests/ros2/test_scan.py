"""A scan of any camera, for Nav2, and of a lidar, for the driver."""

import math

import numpy as np
import pytest
from eldenet_ros.scan import read_scan, scan_depth
from support.ros import BUILDER, header, through_cdr

from eldenet.geometry import back_project, pinhole
from eldenet.navigation.lidar import scan_to_ranges
from eldenet.simulation.robot import ALL_ROUND

OPTIONS = {"camera_height": 0.4, "heights": (0.15, 0.6), "near": 0.3, "far": 10.0}


def room(width: int, focal: float, wall: float, *, thing: tuple[float, float] | None = None) -> np.ndarray:
    """Depth ``(96, width)`` of a floor and a wall ahead, and of something upright at x, z [m]."""
    rays = back_project(np.ones((96, width)), pinhole(focal, focal, (width - 1) / 2, 47.5))
    down = np.maximum(rays[..., 1], 1e-9)
    depth = np.minimum(0.4 / down, wall)
    if thing is not None:
        hit = (abs(rays[..., 0] * thing[1] - thing[0]) < 0.15) & (thing[1] < depth)
        depth = np.where(hit, thing[1], depth)
    return depth


@pytest.mark.parametrize(("width", "focal"), [(128, 60.0), (128, 200.0), (640, 460.0)])
def test_a_wall_is_where_it_is_for_wide_and_narrow_cameras(width, focal) -> None:
    ranges, half = scan_depth(
        room(width, focal, 4.0), pinhole(focal, focal, (width - 1) / 2, 47.5), **OPTIONS
    )
    assert half == pytest.approx(math.atan(width / 2 / focal))
    angles = (np.arange(len(ranges)) + 0.5) * 2 * half / len(ranges) - half
    assert ranges == pytest.approx(np.minimum(4.0 / np.cos(angles), 10.0), rel=0.03)


def test_something_on_the_right_is_in_the_first_beams() -> None:
    ranges, _ = scan_depth(room(160, 110.0, 9.0, thing=(0.8, 2.0)), pinhole(110, 110, 79.5, 47.5), **OPTIONS)
    assert ranges.min() == pytest.approx(math.hypot(0.65, 2.0), rel=0.05)
    assert ranges.argmin() < len(ranges) / 2
    assert ranges[len(ranges) // 2 :].min() > 8


def test_nothing_reads_far_and_a_blind_camera_near() -> None:
    camera = pinhole(110, 110, 79.5, 47.5)
    free = np.where(room(160, 110.0, 50.0) < 20, room(160, 110.0, 50.0), np.inf)
    assert (scan_depth(free, camera, **OPTIONS)[0] == 10.0).all()
    assert (scan_depth(np.full((96, 160), np.nan), camera, **OPTIONS)[0] == 0.3).all()


def test_only_heights_that_the_robot_can_touch_count() -> None:
    camera = pinhole(110, 110, 79.5, 47.5)
    depth = room(160, 110.0, 8.0)
    depth[:25] = 3.0  # hangs from above: from 1.0 m on
    assert scan_depth(depth, camera, **OPTIONS)[0].min() > 7
    assert scan_depth(depth, camera, **{**OPTIONS, "heights": (0.15, 1.3)})[0].max() < 4


@pytest.mark.parametrize(
    "wrong", [{"near": 0.0}, {"far": 0.2}, {"heights": (0.6, 0.15)}, {"far": math.inf}, {"near": math.nan}]
)
def test_numbers_out_of_range_end_in_one_line(wrong) -> None:
    with pytest.raises(ValueError, match="give meters"):
        scan_depth(room(160, 110.0, 8.0), pinhole(110, 110, 79.5, 47.5), **{**OPTIONS, **wrong})


def test_a_lidar_s_scan_is_read_with_its_limits_and_its_place() -> None:
    message = through_cdr(
        BUILDER.laser_scan(header(), np.array([0.1, 2.0, np.nan, 10.0]), 0.4, 0.3, 10.0, 0.2)
    )
    scan = read_scan(message, ahead=0.1, yaw=1.0)
    np.testing.assert_array_equal(scan.ranges, [np.nan, 2.0, np.nan, np.inf])
    assert scan.angles == pytest.approx([0.7, 0.9, 1.1, 1.3])
    assert scan.ahead == 0.1
    for low, high in ((0.3, 0.0), (0.3, math.nan), (math.nan, 10.0), (-1.0, 10.0)):
        message.range_min, message.range_max = low, high
        with pytest.raises(ValueError, match="its publisher must send meters"):
            read_scan(message, ahead=0.1, yaw=0.0)


@pytest.mark.parametrize("yaw", [0.0, 0.05, -2.0, math.pi])
def test_a_lidar_that_counts_a_whole_turn_from_0_may_be_mounted_turned(yaw) -> None:
    message = through_cdr(BUILDER.laser_scan(header(), np.full(360, 5.0), math.pi, 0.1, 12.0, 0.2))
    message.angle_min, message.angle_max = 0.0, 2 * math.pi
    angles = np.arange(360) * message.angle_increment + yaw
    message.ranges = np.where(np.cos(angles - 0.3) > 0.99, 2.0, 5.0).astype(np.float32)  # to the left
    ranges = scan_to_ranges(read_scan(message, ahead=0.2, yaw=yaw))
    seen = np.array(ALL_ROUND.column_angles)[ranges < 3.0]
    assert seen.mean() == pytest.approx(0.3, abs=0.02)

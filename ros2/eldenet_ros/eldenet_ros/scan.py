"""A laser scan from a depth image, for Nav2, and a lidar's for the driver. Needs no ROS."""

import math
from typing import Any

import numpy as np

from eldenet.navigation.lidar import Scan
from eldenet.navigation.ranges import depth_to_ranges
from eldenet.simulation.robot import Robot

BEAM = math.radians(1.0)  # width of a beam where the picture has enough pixels
LEAST_PIXELS = 2.0  # of a beam


def scan_depth(
    depth: np.ndarray,
    intrinsics: np.ndarray,
    *,
    camera_height: float,
    heights: tuple[float, float],
    near: float,
    far: float,
) -> tuple[np.ndarray, float]:
    """Return ranges ``(N,)`` [m], right to left, and half of the angle that they cover [rad].

    The scan covers the same angle to both sides: that of the side where the camera sees less.

    Args:
        depth: ``(H, W)`` [m] of a level camera; :func:`eldenet.navigation.ranges.depth_to_ranges` says what
            unknown pixels mean.
        intrinsics: ``(3, 3)`` of it [px].
        camera_height: of its optical center above the floor [m].
        heights: low and high end of what the robot can touch, above the floor [m].
        near: least range [m], also that of a column that may be blind.
        far: greatest range [m], also where nothing is seen.

    Raises:
        ValueError: the intrinsics are not those of a camera, or a number is out of range.
    """
    if not (0 < near < far < math.inf and 0 <= heights[0] < heights[1] < math.inf):
        raise ValueError(
            f"range_min={near}, range_max={far}, lowest={heights[0]}, highest={heights[1]}: give meters, the "
            "second above the first"
        )
    focal, middle = float(intrinsics[0, 0]), float(intrinsics[0, 2])
    side = min(middle + 0.5, depth.shape[1] - 0.5 - middle)
    if not (focal > 0 and side > 0):
        raise ValueError(f"intrinsics={intrinsics.tolist()}: give those of pictures of {depth.shape[1]} px")
    half = math.atan(side / focal)
    beams = max(1, int(2 * half / max(BEAM, LEAST_PIXELS / focal)))
    view = Robot(field_of_view=2 * half, columns=beams, near=near, far=far)
    ranges = depth_to_ranges(depth, intrinsics, camera_height=camera_height, robot=view, heights=heights)
    return ranges, half


def read_scan(scan: Any, *, ahead: float, yaw: float) -> Scan:
    """Ranges [m] and angles of a ``sensor_msgs/LaserScan``; inf from ``range_max``, NaN below ``range_min``.

    Args:
        scan: of a level lidar.
        ahead: of the lidar, in front of the axle's center [m].
        yaw: of its frame, counter-clockwise from straight ahead [rad].

    Raises:
        ValueError: ``range_min`` is negative or not below ``range_max``.
    """
    if not 0 <= scan.range_min < scan.range_max:
        raise ValueError(
            f"scan has range_min {scan.range_min} and range_max {scan.range_max}: its publisher must send "
            "meters, the second above the first"
        )
    ranges = np.array(scan.ranges, np.float64)
    free, close = ranges >= scan.range_max, ranges < scan.range_min
    angles = yaw + scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    return Scan(np.where(free, np.inf, np.where(close, np.nan, ranges)), angles, ahead)

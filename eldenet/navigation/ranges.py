"""Ranges per column from a depth map or from boxes on the floor. Needs NumPy only."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from eldenet.geometry import (
    check_camera_height,
    check_intrinsics,
    check_meters,
    intrinsic_matrix,
    level_rotation,
)
from eldenet.simulation.robot import ROBOT, Robot

LOWEST, HIGHEST = 0.15, 0.60  # heights that can touch the robot, with a margin for the floor [m]
QUANTILE = 0.10  # of a column's pixels: its nearest surface
OUTLIERS = 0.08  # of the pixels that a surface would fill there: so few are wrong (a dead pixel column)
LEAST_VIEW = 50.0  # of a camera, half of it to each side [degrees]
LOWEST_CAMERA = 0.01  # [m]
LEAST_REACH = 3.0  # what stands so far ahead must be in the picture [m]
MOST_TILTED = 0.5  # pitch and roll of a camera; more are degrees given as radians [rad]
CAUTION = 0.8  # of the interval of depth whose low end is how near things may be
LEAVES = 0.1  # what a picture shows in the lowest so many meters at a distance may reach below it
STANDS = 0.9  # share of the floor's depth below which a pixel shows what stands on the floor
BEYOND = 100.0  # stands for infinite [m]


def depth_to_ranges(
    depth: np.ndarray,
    intrinsics: np.ndarray | Sequence[Any],
    *,
    camera_height: float = ROBOT.camera_height,
    tilt: tuple[float, float] = (0.0, 0.0),
    low: np.ndarray | None = None,
    robot: Robot = ROBOT,
    heights: tuple[float, float] = (LOWEST, HIGHEST),
) -> np.ndarray:
    """Nearest range in each column of the field of view ``(columns,)`` [m], right to left.

    This is the 10 % quantile of the horizontal ranges of a column's pixels between ``heights``. A range also
    needs as many pixels as 8 % of what a surface at that distance fills of the column, so that a few wrong
    pixels in an otherwise empty column are not an obstacle.

    Infinite depth means nothing in range (ROS REP 117), negative infinite depth something too close. Unknown
    pixels (0, negative, nan) belong to the object that is visible right below them, or stand on the floor
    there: small holes end below ``heights`` and are ignored, a patch that could hide an obstacle is one.
    Without visible floor below, the camera may be blind close up, and the column reads as near.

    Where the lowest that the picture shows at a distance is above ``heights``, what it shows there counts as
    an obstacle: a wall close to a high camera goes on below the picture.

    Columns beside the camera's view are nan, and so are empty ones where a tilted camera sees the floor close
    by and nothing of what stands :data:`LEAST_REACH` ahead. At least :data:`LEAST_VIEW` degrees must show it.

    Args:
        depth: ``(H, W)`` [m] along the optical axis.
        intrinsics: ``(fx, fy, cx, cy)`` or ``(3, 3)`` of the depth map [px].
        camera_height: of the optical center above the floor [m].
        tilt: pitch below the horizon and clockwise roll of the camera [rad].
        low: ``(H, W)`` [m], for how near things may be: ``depth`` decides which pixels are obstacles, ``low``
            how far they are.
        robot: its field of view, columns, near and far end are those of the ranges.
        heights: low and high end of what the robot can touch, above the floor [m].

    Raises:
        ValueError: ``depth`` is in millimeters, the camera's field of view is too small or shows nothing of
            what stands ahead, its pixels are too few for the columns, or its intrinsics, height or tilt are
            impossible.
    """
    check_meters(depth)
    height, width = depth.shape
    check_camera_height(camera_height, LOWEST_CAMERA)  # centimeters would hide a wall
    for name, angle in zip(("pitch", "roll"), tilt, strict=True):
        if not abs(angle) <= MOST_TILTED:
            raise ValueError(f"camera_{name}={angle}: give radians from -{MOST_TILTED} to {MOST_TILTED}")
    intrinsics = intrinsic_matrix(intrinsics)
    check_intrinsics(intrinsics, (height, width))
    column = columns_of(width, intrinsics, robot)
    right = (np.arange(width) - intrinsics[0, 2]) / intrinsics[0, 0]
    down = ((np.arange(height) - intrinsics[1, 2]) / intrinsics[1, 1])[:, None]
    close = np.isneginf(depth)
    known = (depth > 0) | close  # nan is not
    depth = np.where(np.isposinf(depth), BEYOND, np.where(close, 0.0, depth))
    if any(tilt):  # go on with the level camera at the same place
        x, y, z = (a * right + b * down + c for a, b, c in level_rotation(*tilt))
        right, down, depth, low = x / z, y / z, depth * z, None if low is None else low * z
        bearing = robot.field_of_view / 2 - np.arctan(right)
        column = np.floor(bearing * robot.columns / robot.field_of_view).astype(int)
    if not known.all():
        depth = _standing_on_the_floor(depth, known, down, camera_height, heights[0])
    above_floor = camera_height - down * depth
    # what is too close or may hide something counts at any height: the camera may be above the robot
    lowest = camera_height - down.max(axis=0) * depth
    counts = (depth == 0) | _touches(above_floor, heights) | _leaves_below(above_floor, lowest, heights)
    away = depth if low is None else np.minimum(low, depth)
    ranges = np.where(counts, away * np.sqrt(1 + right * right), np.inf)
    rows = _rows_at(down[:, width // 2] if any(tilt) else down[:, 0], camera_height, robot, heights)
    shown = np.broadcast_to(_touches(camera_height - down * LEAST_REACH, heights), ranges.shape)
    least_rows = np.interp(LEAST_REACH, *rows)
    least = min(math.radians(LEAST_VIEW), robot.field_of_view) / 2
    ahead = np.abs(robot.column_angles) < least
    out = np.full(robot.columns, robot.far)
    for number in range(robot.columns):
        here = column == number
        pixels = ranges[here] if any(tilt) else ranges[:, here]
        outliers = OUTLIERS * (pixels.size / height)  # of each row that a surface would fill
        if not (shown[here] if any(tilt) else shown[:, here]).sum() > outliers * least_rows:
            out[number] = np.nan
            if ahead[number]:
                raise ValueError(
                    f"a camera {camera_height:g} m high with camera_pitch={tilt[0]:g} and camera_roll="
                    f"{tilt[1]:g} does not show what stands {LEAST_REACH:g} m ahead, {heights[0]:g} to "
                    f"{heights[1]:g} m above the floor, up to {math.degrees(least):.1f} degrees to each side"
                    ": mount it so that it does, or give the whole picture"
                )
        values = np.sort(pixels[np.isfinite(pixels)])
        first = int(QUANTILE * values.size)
        needed = outliers * np.interp(values[first:], *rows)
        enough = np.flatnonzero(np.arange(first, values.size) + 1 > needed)
        if enough.size:
            out[number] = values[first + enough[0]]
    return np.clip(out, robot.near, robot.far)


def fill_unseen(ranges: np.ndarray, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ranges and how near things may be ``(columns,)`` [m], far and 0 in columns that are nan."""
    unseen = np.isnan(ranges)
    return np.where(unseen, ROBOT.far, ranges), np.where(unseen, 0.0, low)


def _touches(above_floor: np.ndarray, heights: tuple[float, float]) -> np.ndarray:
    return (above_floor > heights[0]) & (above_floor < heights[1])


def _leaves_below(above_floor: np.ndarray, lowest: np.ndarray, heights: tuple[float, float]) -> np.ndarray:
    """Which pixels may show what goes on below the picture; ``lowest`` is its lower edge at their depth."""
    return (above_floor >= heights[1]) & (above_floor < lowest + LEAVES)


def _rows_at(
    down: np.ndarray, camera_height: float, robot: Robot, heights: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Depths [m], and how many pixel rows see what counts as an obstacle there ``(21,)`` each.

    Depth 0 stands for blind pixels, which any row may have.
    """
    depths = np.geomspace(robot.near, robot.far, 20)
    above = camera_height - down * depths[:, None]
    lowest = above.min(axis=1, keepdims=True)
    seen = (_touches(above, heights) | _leaves_below(above, lowest, heights)).sum(axis=1)
    return np.array([0.0, *depths]), np.array([len(down), *seen])


def _standing_on_the_floor(
    depth: np.ndarray, known: np.ndarray, down: np.ndarray, camera_height: float, lowest: float
) -> np.ndarray:
    """Depth ``(H, W)`` [m] whose holes are as far as what is right below them: a thing, or else the floor.

    A hole down to the picture's edge is 0 where it reaches above the height ``lowest`` [m].
    """
    with np.errstate(divide="ignore"):
        floor = np.broadcast_to(np.where(down > 0, camera_height / down, BEYOND), depth.shape).copy()
    stands = known[1:] & (depth[1:] < STANDS * floor[1:])  # the shoes below black trousers
    floor[:-1][stands] = depth[1:][stands]
    filled, at = depth.copy(), np.full(depth.shape[1], np.nan)
    below = np.full(depth.shape[1], False)  # whether a pixel below is known
    for row in range(len(depth) - 1, -1, -1):
        at = np.where(known[row], np.nan, np.where(np.isnan(at), floor[row], at))
        below |= known[row]
        hides = camera_height - down[row] * at > lowest
        filled[row] = np.where(known[row], depth[row], np.where(~below & hides, 0.0, at))
    return filled


def columns_of(width: int, intrinsics: np.ndarray, robot: Robot = ROBOT) -> np.ndarray:
    """Return the column of the field of view for each pixel column ``(width,)``, from the right.

    Columns beside the camera's view have no pixels.

    Raises:
        ValueError: the camera sees too little, or a column within its view has no pixels.
    """
    focal, middle = float(intrinsics[0, 0]), float(intrinsics[0, 2])
    bearing = -np.arctan((np.arange(width) - middle) / focal)
    step = robot.field_of_view / robot.columns
    column = np.floor((bearing + robot.field_of_view / 2) / step).astype(int)
    seen = np.isin(np.arange(robot.columns), column)
    left, right = (math.degrees(math.atan(side / focal)) for side in (middle + 0.5, width - 0.5 - middle))
    least = min(math.radians(LEAST_VIEW), robot.field_of_view) / 2
    wanted = np.abs(robot.column_angles) < least
    if not seen[wanted].all() or np.count_nonzero(np.diff(seen.astype(int), prepend=0, append=0)) > 2:
        pixels = math.ceil(2 * math.tan(robot.field_of_view / 2) / math.tan(step))
        raise ValueError(
            f"a depth map {width} px wide that covers {left:.1f} degrees to the left and {right:.1f} to the "
            f"right: give one that covers {math.degrees(least):.1f} degrees to each side, with at least "
            f"{pixels} px for {math.degrees(robot.field_of_view):.1f} degrees"
        )
    return column


def footprints_to_ranges(footprints: np.ndarray) -> np.ndarray:
    """Range to the near face of the nearest box in each column ``(columns,)`` [m]; ``far`` without one.

    Args:
        footprints: ``(K, 5)`` center ahead of and left of the camera [m], yaw [rad], half length, half width
            [m].

    Raises:
        ValueError: a box is not finite.
    """
    if not np.isfinite(footprints).all():
        raise ValueError("a box is not finite: remove such boxes, or stop the robot")
    angles = np.array(ROBOT.column_angles)
    out = np.full(ROBOT.columns, ROBOT.far)
    for ahead, left, yaw, half_length, half_width in np.asarray(footprints, dtype=float).reshape(-1, 5):
        c, s = math.cos(yaw), math.sin(yaw)
        origin = (-c * ahead - s * left, s * ahead - c * left)  # the camera, in the box's frame
        with np.errstate(divide="ignore", invalid="ignore"):
            entry, leave = np.full(ROBOT.columns, -np.inf), np.full(ROBOT.columns, np.inf)
            for start, direction, half in zip(
                origin, (np.cos(angles - yaw), np.sin(angles - yaw)), (half_length, half_width), strict=True
            ):
                first, second = (-half - start) / direction, (half - start) / direction
                entry = np.fmax(entry, np.fmin(first, second))
                leave = np.fmin(leave, np.fmax(first, second))
        hit = (leave >= entry) & (leave > 0)
        out[hit] = np.minimum(out[hit], entry[hit])
    return np.clip(out, ROBOT.near, ROBOT.far)

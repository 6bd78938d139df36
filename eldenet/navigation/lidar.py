"""A lidar's scan in a driver's columns. Needs NumPy only."""

import math
from typing import NamedTuple

import numpy as np

from eldenet.geometry import check_meters
from eldenet.navigation.ranges import BEYOND, LEAST_VIEW
from eldenet.simulation.robot import ALL_ROUND, ROBOT, front

FARTHEST_AHEAD = 0.5  # a lidar's place in front of the axle or behind it [m]
WIDEST_STEP = 2 * math.degrees(ROBOT.field_of_view / ROBOT.columns)  # between two beams [degrees]


class Scan(NamedTuple):
    """One scan of a lidar, at any angles and in any order.

    Attributes:
        ranges: ``(N,)`` [m]; inf: nothing in range; 0, negative and nan: unknown.
        angles: ``(N,)`` of the beams [rad, counter-clockwise from straight ahead].
        ahead: of the lidar, in front of the axle's center [m].
    """

    ranges: np.ndarray
    angles: np.ndarray
    ahead: float = ROBOT.camera_ahead


def scan_to_ranges(scan: Scan) -> np.ndarray:
    """Nearest range in each column all round ``(206,)`` [m], from the camera's place, right to left.

    What lies within the robot's footprint is the robot, and counts as unknown. A column of which all beams
    are unknown reads as near in the camera's view, where the robot must not drive blindly, and as nan beside
    it. A column between two beams is as near as the nearer one. Columns without beams are nan.

    Raises:
        ValueError: not one angle in radians per range, ranges in millimeters, a place off the robot, or the
            beams leave a gap in the middle :data:`~eldenet.navigation.ranges.LEAST_VIEW` degrees.
    """
    ranges, angles, ahead = scan
    _check(ranges, angles, ahead)
    known = ranges > 0
    away = np.where(known, np.minimum(ranges.astype(np.float64), BEYOND), BEYOND)
    x, y = ahead + away * np.cos(angles), away * np.sin(angles)
    known &= (np.abs(x) > ROBOT.length / 2) | (np.abs(y) > ROBOT.width / 2)
    away = np.where(known, away, BEYOND)  # a mast behind the camera's place hides what is ahead
    x, y = ahead + away * np.cos(angles) - ROBOT.camera_ahead, away * np.sin(angles)
    column = _columns(np.arctan2(y, x))
    out = np.full(ALL_ROUND.columns + 1, np.inf)  # the last one is behind, where no column fits
    np.minimum.at(out, column[known], np.hypot(x, y)[known])
    met, clear = np.full(len(out), False), np.full(len(out), False)
    met[column], clear[column[known]] = True, True
    out, blind = np.where(clear, out, np.nan)[:-1], (met & ~clear)[:-1]
    front(out)[front(blind)] = ROBOT.near
    between = np.flatnonzero(~met[1:-2] & met[:-3] & met[2:-1]) + 1
    out[between] = np.fmin(out[between - 1], out[between + 1])
    return np.clip(out, ALL_ROUND.near, ALL_ROUND.far)


def _columns(bearing: np.ndarray) -> np.ndarray:
    """Number of the column of each bearing ``(N,)`` from -pi to pi [rad]; that of none is the last."""
    column = np.floor((bearing / ALL_ROUND.field_of_view + 0.5) * ALL_ROUND.columns).astype(np.intp)
    return np.where((column < 0) | (column >= ALL_ROUND.columns), ALL_ROUND.columns, column)


def _check(ranges: np.ndarray, angles: np.ndarray, ahead: float) -> None:
    if ranges.ndim != 1 or ranges.shape != angles.shape or not ranges.size:
        raise ValueError(
            f"a scan has ranges of shape {ranges.shape} and angles {angles.shape}: give both as (N,)"
        )
    check_meters(ranges)
    if isinstance(ahead, bool) or not (isinstance(ahead, int | float) and abs(ahead) <= FARTHEST_AHEAD):
        raise ValueError(
            f"a scan's ahead={ahead!r:.60}: give -{FARTHEST_AHEAD} to {FARTHEST_AHEAD}, meters in front of "
            "the axle's center"
        )
    if wrong := np.count_nonzero(~np.isfinite(angles)):
        raise ValueError(f"{wrong} of a scan's {angles.size} angles are not finite: give radians")
    low, high = float(angles.min()), float(angles.max())
    if high - low > math.tau + 0.01:  # wherever they begin
        raise ValueError(
            f"a scan's angles go from {low:g} to {high:g}, more than a turn: degrees? Give radians, "
            "counter-clockwise from straight ahead (np.radians)"
        )
    met = np.full(ALL_ROUND.columns + 2, False)  # with one more at each end
    met[_columns(np.arctan2(np.sin(angles), np.cos(angles))) + 1] = True
    seen = met[1:-1] | (met[:-2] & met[2:])
    wanted = np.abs(ALL_ROUND.column_angles) < math.radians(LEAST_VIEW / 2)
    if not seen[wanted].all():
        raise ValueError(
            f"a scan of {angles.size} beams from {math.degrees(low):.0f} to {math.degrees(high):.0f} "
            f"degrees: give one with a beam every {WIDEST_STEP:.1f} degrees, {LEAST_VIEW / 2:g} to each "
            "side of straight ahead (0)"
        )

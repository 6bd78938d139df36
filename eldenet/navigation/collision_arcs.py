"""Collision times along arcs, from tables: when does the footprint reach a point on the floor?

A robot with constant speed and turn rate drives along an arc. For every command and every 5 cm cell around
the robot, a table has the time until which the footprint is free of the cell's center, and the clearance
along the arc. A lookup is a hundred times cheaper than moving rectangles; its error is half a cell.
"""

import functools

import numpy as np

from eldenet.navigation.safety_margins import DRIVER_MARGIN
from eldenet.simulation.robot import ROBOT, arc

CELL = 0.05  # [m]
REACH = 2.4  # half the side of the table's square [m]
STEP = 0.1  # between poses along an arc [s]
_SIDE = round(2 * REACH / CELL)


class ArcTable:
    """Collision times and clearances of a set of commands.

    Args:
        commands: rows of speed [m/s] and turn rate [rad/s].
        horizon: duration of the arcs [s].
        margin: added to the footprint on all sides [m].

    Attributes:
        time: ``(cells, K)`` uint8 number of poses (every :data:`STEP`) before the first that hits the cell;
            ``count`` if none hits it, or it is under the robot at the start.
        gap: ``(cells, K)`` uint8 least distance between footprint and cell along the arc [cm], at most 255,
            as where the cell is under the robot at the start.
        count: number of poses; the first is one :data:`STEP` after the start.
    """

    def __init__(
        self, commands: tuple[tuple[float, float], ...], horizon: float, margin: float = DRIVER_MARGIN
    ) -> None:
        self.commands = np.array(commands, dtype=np.float64)
        self.horizon, self.count = horizon, round(horizon / STEP)
        middle = ((np.arange(_SIDE) + 0.5) * CELL - REACH).astype(np.float32)
        x, y = (axis.ravel() for axis in np.meshgrid(middle, middle, indexing="ij"))
        self.time = np.full((x.size, len(commands)), self.count, np.uint8)
        self.gap = np.empty((x.size, len(commands)), np.uint8)
        touching = (_outside(x, y) > 0) & (_outside(x, y) < margin)
        for number, (speed, turn) in enumerate(commands):
            first = np.full(x.size, self.count, np.uint8)
            nearest = np.full(x.size, np.inf, np.float32)
            for step in range(self.count, 0, -1):
                px, py, yaw = arc(0.0, 0.0, 0.0, speed, turn, step * STEP)
                c, s = np.float32(np.cos(yaw)), np.float32(np.sin(yaw))
                dx, dy = x - np.float32(px), y - np.float32(py)
                outside = _outside(c * dx + s * dy, c * dy - s * dx)
                # a cell within the margin already only counts where the footprint itself hits it
                first[outside <= np.where(touching, 0, margin)] = step - 1
                np.minimum(nearest, outside, out=nearest)
            own = _outside(x, y) <= 0  # under the robot: drift or noise, no obstacle
            first[own], nearest[own] = self.count, np.inf
            self.time[:, number] = first
            self.gap[:, number] = np.clip(nearest * 100, 0, 255)

    def cells(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return cell numbers ``(M,)`` of points in the robot's frame [m], all within :data:`REACH`."""
        rows, columns = (
            np.minimum(((axis + np.float32(REACH)) * np.float32(1 / CELL)).astype(np.int32), _SIDE - 1)
            for axis in (x, y)
        )
        out: np.ndarray = rows * _SIDE + columns
        return out


def _outside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance ``(M,)`` from points in the robot's frame to its footprint, 0 inside [m]."""
    along = np.maximum(np.abs(x) - np.float32(ROBOT.length / 2), 0)
    across = np.maximum(np.abs(y) - np.float32(ROBOT.width / 2), 0)
    out: np.ndarray = np.hypot(along, across)
    return out


@functools.lru_cache(maxsize=8)
def arc_table(
    commands: tuple[tuple[float, float], ...], horizon: float, margin: float = DRIVER_MARGIN
) -> ArcTable:
    """Return the table of a set of commands, computed once per process."""
    return ArcTable(commands, horizon, margin)

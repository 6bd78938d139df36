"""Dimensions of the mobile robot, shared by simulation and navigation."""

import math
from typing import NamedTuple

import numpy as np


class Robot(NamedTuple):
    """A three-wheeled robot with a forward RGB-D camera, as the paper's; its differential drive is ours.

    The frame has x ahead, y to the left, and its origin at the center of the footprint, on the wheels' axle.
    """

    length: float = 0.60  # of the footprint along x [m]
    width: float = 0.50  # of the footprint along y [m]
    height: float = 0.50  # of its top [m]
    camera_ahead: float = 0.20  # optical center in front of the axle [m]
    camera_height: float = 0.40  # optical center above the floor [m]
    field_of_view: float = math.radians(69.4)  # of the camera, horizontal [rad]
    columns: int = 40  # sectors of equal angle in the field of view, right to left
    near: float = 0.3  # least range that the camera measures [m], also reported for anything nearer
    far: float = 10.0  # greatest range [m], also reported where nothing is hit
    max_speed: float = 1.0  # [m/s]
    max_turn: float = 1.2  # [rad/s]
    period: float = 0.2  # of control [s]

    @property
    def radius(self) -> float:
        """Radius of the circle around the footprint [m]."""
        return math.hypot(self.length, self.width) / 2

    @property
    def column_angles(self) -> tuple[float, ...]:
        """Bearing of each column's center, counter-clockwise from straight ahead [rad]."""
        step = self.field_of_view / self.columns
        return tuple((number + 0.5) * step - self.field_of_view / 2 for number in range(self.columns))

    def camera_center(self, pose: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the optical center x, y, z [m] of the robot at a pose x, y [m], heading [rad]."""
        x, y, yaw = pose
        ahead = self.camera_ahead
        return x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), self.camera_height


ROBOT = Robot()
_EXTRA = int((math.pi - ROBOT.field_of_view / 2) / ROBOT.field_of_view * ROBOT.columns)  # to each side
#: All that a lidar sees: columns as wide as the camera's all round (357 degrees), the camera's in the middle.
ALL_ROUND = ROBOT._replace(
    field_of_view=ROBOT.field_of_view * (1 + 2 * _EXTRA / ROBOT.columns),
    columns=ROBOT.columns + 2 * _EXTRA,
    near=0.05,
)


def view_of(columns: int) -> Robot:
    """Return whose columns a scan has: :data:`ROBOT`'s, or :data:`ALL_ROUND`'s."""
    return ROBOT if columns == ROBOT.columns else ALL_ROUND


def front(values: np.ndarray) -> np.ndarray:
    """Return the values of the camera's columns ``(..., 40)`` of those of a scan ``(..., columns)``."""
    beside = (values.shape[-1] - ROBOT.columns) // 2
    return values[..., beside : beside + ROBOT.columns]


def arc(
    x: float, y: float, yaw: float, speed: float, turn: float, seconds: float
) -> tuple[float, float, float]:
    """Return the exact pose after ``seconds`` at constant ``speed`` [m/s] and ``turn`` rate [rad/s]."""
    half = turn * seconds / 2
    chord = speed * seconds * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + turn * seconds

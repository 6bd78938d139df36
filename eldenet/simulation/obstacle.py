"""An upright object on the floor of an arena."""

import math
from dataclasses import dataclass

import numpy as np

from eldenet.simulation.pedestrians import position_on

SIDE = 20.0  # of the arena [m]
WALL_HEIGHT = 2.0  # [m]

Point = tuple[float, float]
THIN = 0.2  # boxes thinner than this are walls [m]


@dataclass(frozen=True)
class Obstacle:
    """An upright object on the floor."""

    kind: str  # "cylinder", "person" (both round), "box" or "vehicle"
    x: float  # of its center [m]
    y: float  # of its center [m]
    yaw: float  # counter-clockwise [rad]
    half: Point  # half extents along its own axes [m]; the radius twice if it is round
    height: float  # [m]
    # corners of the closed path on which a pedestrian walks; empty for a standing obstacle
    path: tuple[Point, ...] = ()
    speed: float = 0.0  # along the path [m/s]

    @property
    def round(self) -> bool:
        """Whether the footprint is a circle."""
        return self.kind in ("cylinder", "person")

    @property
    def is_wall(self) -> bool:
        """Whether it is a wall between rooms, which no detector finds."""
        return self.kind == "box" and 2 * min(self.half) < THIN

    @property
    def radius(self) -> float:
        """Radius of the circle around the footprint [m]."""
        return self.half[0] if self.round else math.hypot(*self.half)

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distance ``(...)`` from points on the floor to the footprint [m], 0 inside."""
        dx, dy = x - self.x, y - self.y
        if self.round:
            return np.maximum(np.hypot(dx, dy) - self.half[0], 0.0)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        along, across = np.abs(c * dx + s * dy) - self.half[0], np.abs(c * dy - s * dx) - self.half[1]
        return np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))

    def position(self, time: float) -> Point:
        """Return the center ``time`` [s] after the start."""
        return position_on(self.path, self.speed, time) if self.path else (self.x, self.y)

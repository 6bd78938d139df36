"""An upright object on the floor of an arena."""

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

SIDE = 20.0  # of the arena [m]
WALL_HEIGHT = 2.0  # [m]

Point = tuple[float, float]
THIN = 0.2  # boxes thinner than this are walls [m]


@dataclass(frozen=True)
class Obstacle:
    """An upright object on the floor.

    Attributes:
        kind: "cylinder", "person" (both round), "box" or "vehicle".
        x: of its center [m].
        y: of its center [m].
        yaw: counter-clockwise [rad].
        half: half extents along its own axes [m]; the radius twice if it is round.
        height: [m].
        path: corners of the closed path on which a pedestrian walks; empty for a standing obstacle.
        speed: along the path [m/s].
    """

    kind: str
    x: float
    y: float
    yaw: float
    half: Point
    height: float
    path: tuple[Point, ...] = ()
    speed: float = 0.0

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
        """Return the distance from points on the floor to the footprint [m], 0 inside."""
        dx, dy = x - self.x, y - self.y
        if self.round:
            return np.maximum(np.hypot(dx, dy) - self.half[0], 0.0)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        along, across = np.abs(c * dx + s * dy) - self.half[0], np.abs(c * dy - s * dx) - self.half[1]
        return np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))

    def position(self, time: float) -> Point:
        """Return the center ``time`` [s] after the start."""
        if not self.path:
            return self.x, self.y
        lengths, starts = self._legs
        along = (time * self.speed) % starts[-1]
        leg = min(bisect_right(starts, along) - 1, len(lengths) - 1)
        share = (along - starts[leg]) / lengths[leg]
        (x, y), (to_x, to_y) = self.path[leg], self.path[(leg + 1) % len(self.path)]
        return x + share * (to_x - x), y + share * (to_y - y)

    @cached_property
    def _legs(self) -> tuple[list[float], list[float]]:
        """Length of every leg of the path, and the distance walked before each and after the last [m]."""
        lengths = [math.dist(a, b) for a, b in zip(self.path, (*self.path[1:], self.path[0]), strict=True)]
        return lengths, [0.0, *accumulate(lengths)]

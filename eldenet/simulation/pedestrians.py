"""People who walk through an arena: the paths that are drawn for them, and where they are at a time."""

import math
from bisect import bisect_right
from functools import lru_cache
from itertools import accumulate

from eldenet.simulation.rendering.mjcf import Draw

PERSON_RADIUS = 0.25  # also of people who stand [m]
PERSON_HEIGHTS = (1.5, 1.9)  # [m]
WALKING_SPEEDS = (0.3, 0.9)  # [m/s]
SHORTEST_LEG = 2.0  # between two corners of a path [m]
PEDESTRIAN_CLEARANCE = 3.0  # from the robot's start to where a path begins [m]

Path = tuple[tuple[float, float], ...]


def draw_walk(draw: Draw, start: tuple[float, float, float], side: float) -> tuple[Path, float]:
    """Draw a closed path and a speed: back and forth, or around three to five corners.

    Returns the corners [m] and the speed [m/s]. The first corner keeps away from ``start``, x, y [m] and
    heading [rad] of the robot; ``side`` is the arena's [m].
    """
    limit = side / 2 - 1.0
    back_and_forth = draw.chance(0.5)
    while True:
        count = 2 if back_and_forth else draw.integer(3, 5)
        path = tuple(
            (round(draw.uniform(-limit, limit), 4), round(draw.uniform(-limit, limit), 4))
            for _ in range(count)
        )
        if math.dist(path[0], start[:2]) > PEDESTRIAN_CLEARANCE and min(_legs(path)[0]) > SHORTEST_LEG:
            return path, round(draw.uniform(*WALKING_SPEEDS), 4)


def position_on(path: Path, speed: float, time: float) -> tuple[float, float]:
    """Return where a person is on a closed path [m], ``time`` [s] after setting out at its first corner."""
    lengths, starts = _legs(path)
    along = (time * speed) % starts[-1]
    leg = min(bisect_right(starts, along) - 1, len(lengths) - 1)
    share = (along - starts[leg]) / lengths[leg]
    (x, y), (to_x, to_y) = path[leg], path[(leg + 1) % len(path)]
    return x + share * (to_x - x), y + share * (to_y - y)


@lru_cache(maxsize=1024)
def _legs(path: Path) -> tuple[list[float], list[float]]:
    """Length of every leg of a path, and the distance walked before each and after the last [m]."""
    lengths = [math.dist(a, b) for a, b in zip(path, (*path[1:], path[0]), strict=True)]
    return lengths, [0.0, *accumulate(lengths)]

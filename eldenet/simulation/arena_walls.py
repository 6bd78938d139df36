"""Walls inside of an arena: rooms with doors, and a U-shaped trap between start and goal.

Walls are boxes, so physics, ranges, maps and pictures need nothing new.
"""

import math
from typing import NamedTuple

import numpy as np

from eldenet.simulation.obstacle import SIDE, WALL_HEIGHT, Obstacle, Point
from eldenet.simulation.rendering.mjcf import Draw

THICKNESS = 0.12  # [m]
DOORS = (1.1, 1.5)  # widths [m]
EXTRA_DOOR = 0.5  # chance of a door that no room needs to be reached
DOOR_CLEARANCE = 1.2  # around a door's center, free of furniture [m]
FROM_WALLS = 0.2  # between a wall and furniture [m]
END_CLEARANCE = 1.1  # around start and goal beside a trap [m]
TRAP_WIDTHS, TRAP_DEPTHS = (2.0, 3.5), (2.0, 3.5)  # inner measures [m]


class Walls(NamedTuple):
    """Walls of an arena, and where nothing else may stand.

    Attributes:
        boxes: the walls.
        clear: points [m] and the radius [m] around each that stays free of obstacles.
        ends: start x, y [m], heading [rad] and goal x, y [m], where the walls go with them; None: anywhere.
    """

    boxes: tuple[Obstacle, ...]
    clear: tuple[tuple[Point, float], ...]
    ends: tuple[tuple[float, float, float], Point] | None = None

    def leave_room(self, x: float, y: float, radius: float) -> bool:
        """Whether an obstacle of this radius [m] may stand here."""
        off_walls = all(
            float(wall.distance(np.array(x), np.array(y))) > radius + FROM_WALLS for wall in self.boxes
        )
        return off_walls and all(math.dist(point, (x, y)) > radius + free for point, free in self.clear)


OPEN = Walls((), ())


def draw_rooms(draw: Draw) -> Walls:
    """Draw nine rooms with doors 1.1 to 1.5 m wide; every room can be reached from every other."""
    cuts = [
        [-SIDE / 2, *(middle + draw.uniform(-0.8, 0.8) for middle in (-3.3, 3.3)), SIDE / 2] for _ in "xy"
    ]
    rooms = [(column, row) for row in range(3) for column in range(3)]
    sides = [((c, r), (c + 1, r)) for c, r in rooms if c < 2] + [
        ((c, r), (c, r + 1)) for c, r in rooms if r < 2
    ]
    group = {room: number for number, room in enumerate(rooms)}
    boxes: list[Obstacle] = []
    clear: list[tuple[Point, float]] = []
    for _ in range(len(sides)):
        first, second = sides.pop(int(draw.unit() * len(sides)))
        upright = first[1] == second[1]  # the wall runs along y
        across = cuts[0][second[0]] if upright else cuts[1][second[1]]
        low, high = (cuts[1][first[1] + k] if upright else cuts[0][first[0] + k] for k in (0, 1))
        joins = group[first] != group[second]
        door, width = draw.chance(EXTRA_DOOR) or joins, draw.uniform(*DOORS)
        middle = draw.uniform(low + 0.4 + width / 2, high - 0.4 - width / 2)
        parts = [(low, middle - width / 2), (middle + width / 2, high)] if door else [(low, high)]
        boxes += [_wall(across, part, upright) for part in parts]
        if door:
            clear.append(((across, middle) if upright else (middle, across), DOOR_CLEARANCE))
            old, new = group[second], group[first]
            group = {room: new if number == old else number for room, number in group.items()}
    return Walls(tuple(boxes), tuple(clear))


def _wall(across: float, along: tuple[float, float], upright: bool) -> Obstacle:
    middle, half = (along[0] + along[1]) / 2, (along[1] - along[0]) / 2
    x, y = (across, middle) if upright else (middle, across)
    extents = (THICKNESS / 2, half) if upright else (half, THICKNESS / 2)
    return Obstacle(
        "box", round(x, 4), round(y, 4), 0.0, (round(extents[0], 4), round(extents[1], 4)), WALL_HEIGHT
    )


def draw_trap(draw: Draw) -> Walls:
    """Draw a U of three walls that opens toward the start and hides the goal behind its back."""
    width, depth = draw.uniform(*TRAP_WIDTHS), draw.uniform(*TRAP_DEPTHS)
    limit = SIDE / 2 - END_CLEARANCE
    while True:
        opens = draw.uniform(-math.pi, math.pi)
        c, s = math.cos(opens), math.sin(opens)
        x, y = draw.uniform(-1.5, 1.5), draw.uniform(-1.5, 1.5)

        def place(ahead: float, left: float) -> Point:
            return round(x + c * ahead - s * left, 4), round(y + s * ahead + c * left, 4)  # noqa: B023

        start = place(draw.uniform(5.0, 7.0), draw.uniform(-0.5, 0.5))
        goal = place(draw.uniform(-7.0, -5.0), draw.uniform(-0.5, 0.5))
        if max(map(abs, (*start, *goal))) < limit and math.dist(start, goal) >= 10.0:
            break
    half = THICKNESS / 2
    walls = [  # center ahead, left of the trap's middle; half extents
        (-depth / 2 - half, 0.0, half, width / 2 + THICKNESS),
        (0.0, width / 2 + half, depth / 2, half),
        (0.0, -width / 2 - half, depth / 2, half),
    ]
    boxes = tuple(
        Obstacle("box", *place(ahead, left), round(opens, 4), (round(a, 4), round(b, 4)), WALL_HEIGHT)
        for ahead, left, a, b in walls
    )
    around = ((x, y), math.hypot(width, depth) / 2 + 1.0)
    clear = (around, (start, END_CLEARANCE), (goal, END_CLEARANCE))
    heading = round(draw.uniform(-math.pi, math.pi), 4)
    return Walls(boxes, clear, ((*start, heading), goal))

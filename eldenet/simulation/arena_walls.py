"""Walls inside of an arena: rooms with doors, a U-shaped trap, an office, a maze, a winding corridor.

Walls are boxes, so physics, ranges, maps and pictures need nothing new.
"""

import math
from dataclasses import replace
from itertools import pairwise
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
CORRIDORS = (1.15, 1.40)  # widths in offices, mazes and corridors [m]
OFFICE_DOORS, OFFICE_ROOMS = (1.05, 1.25), (3.2, 5.5)  # widths [m]
MAZE = 7  # cells along a side
EXTRA_OPENING = 0.1  # chance of an opening that no cell needs to be reached
LANES = (3, 5)  # least and greatest number of lanes of a corridor


class Walls(NamedTuple):
    """Walls of an arena, and where nothing else may stand."""

    boxes: tuple[Obstacle, ...]  # the walls
    # points [m] and the radius [m] around each that stays free of obstacles
    clear: tuple[tuple[Point, float], ...]
    # start x, y [m], heading [rad] and goal x, y [m], where the walls go with them; None: anywhere
    ends: tuple[tuple[float, float, float], Point] | None = None
    # nowhere is more room than a corridor has: no obstacles, and less room around the ends
    narrow: bool = False

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
    rooms, sides = _cells(3)
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


def _cells(count: int) -> tuple[list[tuple[int, int]], list[tuple[tuple[int, int], tuple[int, int]]]]:
    """Cells (column, row) of a square, and the pairs of neighbors."""
    cells = [(column, row) for row in range(count) for column in range(count)]
    across = [((c, r), (c + 1, r)) for c, r in cells if c < count - 1]
    return cells, across + [((c, r), (c, r + 1)) for c, r in cells if r < count - 1]


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


def draw_office(draw: Draw) -> Walls:
    """Draw four rows of rooms along two corridors, which a third one joins; every room has one door."""
    half = SIDE / 2
    widths = [draw.uniform(*CORRIDORS) for _ in range(3)]
    middles = [sign * 4.9 + draw.uniform(-0.5, 0.5) for sign in (-1, 1)]
    edges = [
        (y - w / 2 - THICKNESS / 2, y + w / 2 + THICKNESS / 2) for y, w in zip(middles, widths, strict=False)
    ]
    joint = draw.uniform(-5.0, 5.0)
    gap = (joint - widths[2] / 2 - THICKNESS / 2, joint + widths[2] / 2 + THICKNESS / 2)
    back = (edges[0][1] + edges[1][0]) / 2  # of the two rows between the corridors
    boxes = [_wall(x, (edges[0][1], edges[1][0]), True) for x in gap]
    boxes += [_wall(back, part, False) for part in ((-half, gap[0]), (gap[1], half))]
    clear: list[tuple[Point, float]] = []
    for y, w in zip(middles, widths, strict=False):
        clear += [((x, y), w / 2) for x in np.arange(-half, half, 0.5).tolist()]
    clear += [((joint, y), widths[2] / 2) for y in np.arange(middles[0], middles[1], 0.5).tolist()]
    rows = [  # the wall with the doors, the far end, stretches of rooms
        (edges[0][0], -half, [(-half, half)]),
        (edges[0][1], back, [(-half, gap[0]), (gap[1], half)]),
        (edges[1][0], back, [(-half, gap[0]), (gap[1], half)]),
        (edges[1][1], half, [(-half, half)]),
    ]
    for door_line, far, stretches in rows:
        for low, high in stretches:
            count = max(1, round((high - low) / draw.uniform(*OFFICE_ROOMS)))
            cuts = np.linspace(low, high, count + 1).tolist()
            boxes += [_wall(x, (min(door_line, far), max(door_line, far)), True) for x in cuts[1:-1]]
            for left, right in pairwise(cuts):
                width = draw.uniform(*OFFICE_DOORS)
                door = draw.uniform(left + 0.3 + width / 2, right - 0.3 - width / 2)
                boxes += [
                    _wall(door_line, part, False)
                    for part in ((left, door - width / 2), (door + width / 2, right))
                ]
                clear.append(((door, door_line), DOOR_CLEARANCE))
    return Walls(tuple(boxes), tuple(clear))


def draw_maze(draw: Draw) -> Walls:
    """Draw seven times seven cells as wide as a corridor; every cell can be reached, few in two ways."""
    pitch = draw.uniform(*CORRIDORS) + THICKNESS
    half = MAZE * pitch / 2
    cells, sides = _cells(MAZE)
    group = {cell: number for number, cell in enumerate(cells)}
    boxes = _frame(half, half)
    for _ in range(len(sides)):
        first, second = sides.pop(int(draw.unit() * len(sides)))
        if group[first] != group[second]:
            old, new = group[second], group[first]
            group = {cell: new if number == old else number for cell, number in group.items()}
        elif not draw.chance(EXTRA_OPENING):
            upright = first[1] == second[1]
            across, along = (second[0], first[1]) if upright else (second[1], first[0])
            low = along * pitch - half
            boxes.append(_wall(across * pitch - half, (low, low + pitch), upright))
    first = draw.pick(cells)
    last = draw.pick([cell for cell in cells if math.dist(cell, first) >= MAZE / 2])
    (x, y), goal = (
        (round((c + 0.5) * pitch - half, 4), round((r + 0.5) * pitch - half, 4)) for c, r in (first, last)
    )
    heading = round(draw.uniform(-math.pi, math.pi), 4)
    return Walls(tuple(boxes), (), ((x, y, heading), goal), narrow=True)


def draw_corridor(draw: Draw) -> Walls:
    """Draw a corridor that winds: lanes side by side, each joined to the next near one end."""
    widths = [draw.uniform(*CORRIDORS) for _ in range(draw.integer(*LANES))]
    length = draw.uniform(5.0, 7.0)
    lines = (
        np.cumsum([0.0, *(width + THICKNESS for width in widths)])
        - (sum(widths) + THICKNESS * len(widths)) / 2
    )
    boxes = _frame(float(lines[-1]), length / 2)
    end = draw.sign()
    start_end = -end
    for line in lines[1:-1].tolist():
        opening = draw.uniform(*CORRIDORS)
        middle = end * (length / 2 - opening / 2 - THICKNESS / 2 - draw.uniform(0.0, 0.8))
        boxes += [
            _wall(line, part, True)
            for part in ((-length / 2, middle - opening / 2), (middle + opening / 2, length / 2))
            if part[1] - part[0] > THICKNESS
        ]
        end = -end
    inner = length / 2 - THICKNESS / 2 - 0.6
    x, y = (lines[0] + lines[1]) / 2, start_end * inner
    goal = (lines[-2] + lines[-1]) / 2, end * inner
    heading = round(draw.uniform(-math.pi, math.pi), 4)
    if draw.chance(0.5):  # along the other axis
        boxes = [replace(wall, x=wall.y, y=wall.x, half=wall.half[::-1]) for wall in boxes]
        (x, y), goal = (y, x), goal[::-1]
    start = (round(float(x), 4), round(float(y), 4), heading)
    return Walls(tuple(boxes), (), (start, (round(float(goal[0]), 4), round(float(goal[1]), 4))), narrow=True)


def _frame(half_x: float, half_y: float) -> list[Obstacle]:
    """Four walls around the origin."""
    upright = [_wall(x, (-half_y, half_y), True) for x in (-half_x, half_x)]
    return upright + [_wall(y, (-half_x, half_x), False) for y in (-half_y, half_y)]

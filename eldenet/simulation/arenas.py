"""Walled arenas with cylinders, boxes, vehicles and people, a start and a goal that can be reached.

An arena depends on ``(kind, split, density, pedestrians, index, min_distance)`` alone and is the same on
every machine (:class:`~eldenet.simulation.rendering.mjcf.Draw`, four decimals). The splits share no seed, so
no arena is in two of them.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from eldenet.simulation.arena_walls import (
    OPEN,
    Walls,
    draw_corridor,
    draw_maze,
    draw_office,
    draw_rooms,
    draw_trap,
)
from eldenet.simulation.obstacle import SIDE, Obstacle, Point
from eldenet.simulation.pedestrians import PEDESTRIAN_CLEARANCE, PERSON_HEIGHTS, PERSON_RADIUS, draw_walk
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.robot import ROBOT
from eldenet.system.checks import one_of
from eldenet.system.digests import digest_of

#: First number of every split's seeds; no other seed of this package starts with these.
SPLITS = {"train": 100, "val": 101, "test": 102}
#: Kinds of arenas: what draws the walls, and the numbers that end the seeds; open ones have none.
KINDS: dict[str, tuple[Callable[[Draw], Walls], tuple[int, ...]]] = {
    "open": (lambda _: OPEN, ()),
    "rooms": (draw_rooms, (1,)),
    "traps": (draw_trap, (2,)),
    "office": (draw_office, (3,)),
    "maze": (draw_maze, (4,)),
    "corridor": (draw_corridor, (5,)),
}
MAX_DENSITY = 120  # standing obstacles beside the walls
RESOLUTION = 0.1  # of the grid on which the goal must be reachable [m]
INFLATION = 0.45  # robot's circumscribed radius 0.39 and a margin [m]
START_CLEARANCE, GOAL_CLEARANCE = 1.0, 0.8  # [m]
MAX_CLEARANCE = 1.6  # of a clearance map [m]
VEHICLE_HALF, VEHICLE_HEIGHT = (0.6, 0.35), 0.6  # half length and width, height [m]


@dataclass(frozen=True)
class Arena:
    """A world, a start and way-points."""

    split: str  # whose seed it has; "" for one that was written by hand
    density: int  # number of standing obstacles beside the walls
    index: int  # within the kind, split, density and number of pedestrians
    obstacles: tuple[Obstacle, ...]  # standing ones, then pedestrians
    start: tuple[float, float, float]  # x, y [m] and heading [rad] of the robot
    waypoints: tuple[Point, ...]  # to be reached in this order, the goal last [m]
    side: float = SIDE  # of the square around the origin [m]
    kind: str = "open"  # of KINDS, as generate_arena describes them

    @property
    def pedestrians(self) -> tuple[Obstacle, ...]:
        """The obstacles that walk."""
        return tuple(obstacle for obstacle in self.obstacles if obstacle.path)

    @property
    def name(self) -> str:
        """Unique over kinds, splits and densities."""
        moving = f"+{len(self.pedestrians)}" if self.pedestrians else ""
        kind = "" if self.kind == "open" else f"{self.kind}-"
        return f"{self.split or 'course'}-{kind}{self.density}{moving}-{self.index}"


def generate_arena(
    split: str,
    density: int,
    index: int,
    *,
    pedestrians: int = 0,
    min_distance: float = 10.0,
    kind: str = "open",
) -> Arena:
    """Generate arena ``index`` of a split.

    Layouts whose goal cannot be reached are drawn again.

    Args:
        split: "train", "val" or "test".
        density: number of standing obstacles, 0 to :data:`MAX_DENSITY`.
        index: from 0.
        pedestrians: number of walking people.
        min_distance: from start to goal, as the crow flies [m]; in traps it is always 10 m or more, in mazes
            and corridors what they give.
        kind: "open"; "rooms": nine rooms with doors 1.1 to 1.5 m wide; "traps": a U-shaped wall opens toward
            the start and hides the goal; "office": rooms along corridors 1.15 to 1.4 m wide; "maze": 7 x 7
            cells of that width; "corridor": one that winds. The last two have no obstacles.

    Raises:
        ValueError: an argument is out of its range.
    """
    one_of("split", split, SPLITS)
    one_of("arena.kind", kind, KINDS)
    for name, value, most in (
        ("density", density, MAX_DENSITY),
        ("pedestrians", pedestrians, 40),
        ("min_distance", min_distance, SIDE),
    ):
        if not 0 <= value <= most:
            raise ValueError(f"{name}={value}: give 0 to {most:g}")
    draw_walls, ending = KINDS[kind]
    draw = Draw((SPLITS[split], density, pedestrians, index, *ending))
    while True:
        walls = draw_walls(draw)
        if walls.narrow and (density or pedestrians):
            raise ValueError(
                f"density={density}, pedestrians={pedestrians}: arena.kind={kind} has room for none, give 0"
            )
        obstacles = draw_obstacles(draw, density, walls)
        if obstacles is None:
            continue
        obstacles = (*walls.boxes, *obstacles)
        clearance = clearance_map(obstacles)
        endpoints = walls.ends or draw_start_and_goal(draw, clearance, min_distance)
        room = (INFLATION, INFLATION) if walls.narrow else (START_CLEARANCE, GOAL_CLEARANCE)
        if endpoints is None or not (walls.ends is None or connected(clearance, *walls.ends, room)):
            continue
        start, goal = endpoints
        walking = [_draw_pedestrian(draw, start) for _ in range(pedestrians)]
        return Arena(split, density, index, (*obstacles, *walking), start, (goal,), kind=kind)


def draw_obstacles(draw: Draw, count: int, walls: Walls = OPEN) -> tuple[Obstacle, ...] | None:
    """Draw obstacles whose bounding circles do not overlap; None if one found no free place.

    They keep 0.2 m from ``walls`` and leave free what these keep clear.
    """
    obstacles: list[Obstacle] = []
    for _ in range(count):
        share = draw.unit()
        yaw, height = draw.uniform(-math.pi, math.pi), draw.uniform(0.6, 1.6)
        if share < 0.4:
            radius = round(draw.uniform(0.20, 0.45), 4)
            kind, half = "cylinder", (radius, radius)
        elif share < 0.5:
            kind, half, height = "person", (PERSON_RADIUS, PERSON_RADIUS), draw.uniform(*PERSON_HEIGHTS)
        elif share < 0.9:
            kind, half = "box", (round(draw.uniform(0.2, 0.5), 4), round(draw.uniform(0.2, 0.5), 4))
        else:
            kind, half, height = "vehicle", VEHICLE_HALF, VEHICLE_HEIGHT
        reach = half[0] if kind in ("cylinder", "person") else math.hypot(*half)
        limit = SIDE / 2 - 0.5
        for _ in range(100):
            x, y = round(draw.uniform(-limit, limit), 4), round(draw.uniform(-limit, limit), 4)
            apart = all(math.hypot(x - o.x, y - o.y) > reach + o.radius for o in obstacles)
            if apart and walls.leave_room(x, y, reach):
                obstacles.append(Obstacle(kind, x, y, round(yaw, 4), half, round(height, 4)))
                break
        else:
            return None
    return tuple(obstacles)


def _draw_pedestrian(draw: Draw, start: tuple[float, float, float]) -> Obstacle:
    path, speed = draw_walk(draw, start, SIDE)
    half = (PERSON_RADIUS, PERSON_RADIUS)
    return Obstacle("person", *path[0], 0.0, half, round(draw.uniform(*PERSON_HEIGHTS), 4), path, speed)


def draw_start_and_goal(
    draw: Draw, clearance: np.ndarray, min_distance: float, pedestrians: Sequence[Obstacle] = ()
) -> tuple[tuple[float, float, float], Point] | None:
    """Draw a start with its heading and a goal that a robot can reach; None after three failures.

    ``clearance (n, n)`` [m] is a :func:`clearance_map`.

    The start keeps its distance from where ``pedestrians`` set out. A goal is reachable if the grid, inflated
    by :data:`INFLATION`, connects it to the start in four directions.
    """
    regions = reachable(clearance)
    starts = np.argwhere((clearance >= START_CLEARANCE) & (regions > 0))
    goals = np.argwhere((clearance >= GOAL_CLEARANCE) & (regions > 0))
    for pedestrian in pedestrians:
        place = (starts[:, ::-1] + 0.5) * RESOLUTION - SIDE / 2
        starts = starts[np.hypot(*(place - pedestrian.position(0.0)).T) > PEDESTRIAN_CLEARANCE]
    for _ in range(3 if len(starts) else 0):
        row, column = starts[int(draw.unit() * len(starts))]
        away = np.hypot(*(goals - (row, column)).T) * RESOLUTION
        same = regions[goals[:, 0], goals[:, 1]] == regions[row, column]
        options = goals[(away >= min_distance) & same]
        if len(options):
            goal = cell_center(*options[int(draw.unit() * len(options))])
            yaw = round(draw.uniform(-math.pi, math.pi), 4)
            return (*cell_center(row, column), yaw), goal
    return None


def reachable(clearance: np.ndarray) -> np.ndarray:
    """Number the parts of a clearance map ``(n, n)`` [m] within which a robot can drive; 0: no room."""
    from skimage.measure import label

    return np.asarray(label(clearance >= INFLATION, connectivity=1))


def connected(clearance: np.ndarray, start: Sequence[float], goal: Point, room: tuple[float, float]) -> bool:
    """Whether start and goal have ``room`` [m] each and the inflated grid ``(n, n)`` [m] connects them."""
    regions = reachable(clearance)
    cells = [tuple(int((value + SIDE / 2) / RESOLUTION) for value in (at[1], at[0])) for at in (start, goal)]
    clear = clearance[cells[0]] >= room[0] and clearance[cells[1]] >= room[1]
    return bool(clear and regions[cells[0]] == regions[cells[1]] > 0)


def cell_center(row: int, column: int) -> Point:
    """Return the center of a grid cell in the world [m]: rows run along y, columns along x."""
    x, y = ((int(cell) + 0.5) * RESOLUTION - SIDE / 2 for cell in (column, row))
    return round(x, 4), round(y, 4)


def clearance_map(
    obstacles: Sequence[Obstacle], side: float = SIDE, resolution: float = RESOLUTION
) -> np.ndarray:
    """Return each cell's distance to the nearest obstacle or wall ``(n, n)`` [m], at most ``MAX_CLEARANCE``.

    Distances from the cells' centers are exact, to the shapes that the physics engine simulates.
    Pedestrians are left out.
    """
    count = round(side / resolution)
    middle = (np.arange(count) + 0.5) * resolution - side / 2
    to_wall = np.minimum(side / 2 - np.abs(middle), MAX_CLEARANCE)
    clearance = np.minimum(to_wall[:, None], to_wall[None, :])
    for obstacle in obstacles:
        if obstacle.path:
            continue
        window = []
        for center in (obstacle.y, obstacle.x):
            reach = obstacle.radius + MAX_CLEARANCE
            first = math.floor((center - reach + side / 2) / resolution)
            last = math.ceil((center + reach + side / 2) / resolution)
            window.append(slice(max(first, 0), min(last, count)))
        rows, columns = window
        distance = obstacle.distance(middle[None, columns], middle[rows, None])
        clearance[rows, columns] = np.minimum(clearance[rows, columns], distance)
    return clearance


def arenas_hash(arenas: Sequence[Arena]) -> str:
    """Return the SHA-256 of all numbers of some arenas: the identity of a test set."""
    contents = [asdict(arena) for arena in arenas]
    for content in contents:
        if content["kind"] == "open":  # as before there were others
            del content["kind"]
    return digest_of(json.dumps(contents, sort_keys=True))


def triangle_course() -> Arena:
    """Return a course like the paper's triangle ABC (section 4.6), in an empty arena; its 6 m are ours."""
    height = round(6.0 * math.sqrt(3) / 4, 4)
    a, b, c = (3.0, -height), (0.0, height), (-3.0, -height)
    return Arena("", 0, 0, (), (*c, 0.0), (a, b, c))


assert ROBOT.radius < INFLATION

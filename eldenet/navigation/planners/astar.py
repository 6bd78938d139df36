"""A* on a grid with the dynamic window: with the true map, or with a map built while driving.

Hart, Nilsson, Raphael, "A formal basis for the heuristic determination of minimum cost paths", 1968. The
search is scikit-image's ``MCP_Geometric`` (Dijkstra): its path has the same cost as A*'s.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np

from eldenet.navigation.observer import Senses
from eldenet.navigation.planners.dwa import DynamicWindow
from eldenet.simulation.arenas import INFLATION, RESOLUTION, SIDE, Arena, clearance_map
from eldenet.simulation.robot import ROBOT

CARROT = 1.3  # distance to the target along the path [m]; nearer is safer and slower
REPLAN_EVERY = 5  # control periods, on a map built while driving
TIGHT = 0.30  # inflation if no path exists at the full one [m]
_MARGIN = 2.0  # around the built map: odometry may drift out of the arena [m]


def shortest_path(
    cost: np.ndarray,
    start: tuple[float, float],
    goal: tuple[float, float],
    side: float = SIDE,
    *,
    corner: tuple[int, int] = (0, 0),
) -> np.ndarray | None:
    """Return way-points ``(n, 2)`` [m] of the cheapest path on an 8-connected grid; None without path.

    Args:
        cost: of each cell ``(n, m)``, 0.1 m wide, rows along y; infinite where the robot must not be.
        start: x, y [m].
        goal: x, y [m].
        side: of the whole grid [m]; its center is the origin.
        corner: row and column of the whole grid where ``cost`` starts.
    """
    from skimage.graph import MCP_Geometric

    ends = [
        tuple(np.clip(cell[::-1].astype(int) - corner, 0, np.array(cost.shape) - 1))
        for cell in ((np.array(point) + side / 2) / RESOLUTION for point in (start, goal))
    ]
    cost = cost.copy()
    cost[ends[0]] = 1.0 if not np.isfinite(cost[ends[0]]) else cost[ends[0]]
    search = MCP_Geometric(cost)
    costs, _ = search.find_costs([ends[0]], [ends[1]])
    if not np.isfinite(costs[ends[1]]):
        return None
    cells = np.array(search.traceback(ends[1]))
    return np.asarray(((cells + corner)[:, ::-1] + 0.5) * RESOLUTION - side / 2)


def path_length(path: np.ndarray) -> float:
    """Length of a path [m]."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def inflated_cost(clearance: np.ndarray) -> np.ndarray:
    """1 where the robot may be, infinite elsewhere."""
    return np.where(clearance >= INFLATION, 1.0, np.inf)


def optimal_length(arena: Arena) -> float:
    """Length of the shortest path through all way-points on the inflated grid [m]; nan without path."""
    cost = inflated_cost(clearance_map(arena.obstacles, arena.side))
    points = [arena.start[:2], *arena.waypoints]
    length = 0.0
    for start, goal in pairwise(points):
        path = shortest_path(cost, start, goal, arena.side)
        length += np.nan if path is None else path_length(path)
    return length


class _PathFollower:
    """The dynamic window along a path of each robot.

    Args:
        carrot: distance to the target along the path [m].
        robots: number of robots.
    """

    def __init__(self, *, carrot: float = CARROT, robots: int = 1) -> None:
        self.carrot = carrot
        self.window = DynamicWindow()
        self.last = np.zeros((robots, 2))
        self._paths: list[np.ndarray | None] = [None] * robots

    def _follow(self, robot: int, pose: np.ndarray, goal: tuple[float, float], points: np.ndarray) -> None:
        """Choose the next command, among points in the robot's frame."""
        path = self._paths[robot]
        target = goal if path is None else carrot(path, pose, self.carrot)
        self.last[robot] = self.window.choose(
            points, tuple(_to_robot(np.array([target]), pose)[0]), tuple(self.last[robot])
        )


class AStarDWA(_PathFollower):
    """A* once on the full map from the true pose, then the dynamic window along the path.

    The map has the standing obstacles; pedestrians are only visible in the ranges.
    """

    name = "astar_dwa"

    def __init__(self, *, carrot: float = CARROT, robots: int = 1) -> None:
        super().__init__(carrot=carrot, robots=robots)
        self._worlds: list[Any] = [None] * robots
        self._points: list[np.ndarray] = [np.empty((0, 2))] * robots
        self._goals: list[tuple[float, float] | None] = [None] * robots

    def reset(self, robot: int, world: Any = None) -> None:
        """Start an episode with the map of ``world``, its :class:`ArenaWorld`."""
        self.last[robot] = 0.0
        self._worlds[robot] = world
        self._goals[robot] = None
        fine = 0.05
        clearance = clearance_map(world.arena.obstacles, world.arena.side, fine)
        # cells next to a wall are half a cell from it, give or take rounding
        edge = np.argwhere(clearance <= fine / 2 + 1e-6)
        self._points[robot] = (edge[:, ::-1] + 0.5) * fine - world.arena.side / 2

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        for robot in range(len(self.last)) if robots is None else robots:
            world = self._worlds[robot]
            pose = np.array(world.pose)
            goal = _goal_in_world(pose, senses.goal[robot])
            before = self._goals[robot]
            if before is None or math.dist(goal, before) > 0.1:
                self._goals[robot] = goal
                cost = inflated_cost(clearance_map(world.arena.obstacles, world.arena.side))
                self._paths[robot] = shortest_path(cost, tuple(pose[:2]), goal, world.arena.side)
            points = [_to_robot(self._points[robot], pose), seen_points(senses.ranges[robot])]
            self._follow(robot, pose, goal, np.concatenate(points))
        return self.last.copy()


class AStarOnlineDWA(_PathFollower):
    """A* on a map built from the robot's own ranges and odometry, then the dynamic window.

    A cell is occupied if more rays ended in it than passed through it recently; unseen cells are free. The
    path is searched anew every second; without one at full inflation, it may pass closer to obstacles.
    """

    name = "astar_online_dwa"

    def __init__(self, *, carrot: float = CARROT, robots: int = 1) -> None:
        super().__init__(carrot=carrot, robots=robots)
        self.side = 2 * SIDE + _MARGIN  # the start is the center, the goal up to a side away
        self.cells = round(self.side / RESOLUTION)
        self._evidence = np.zeros((robots, self.cells, self.cells), np.int8)
        self._origin = np.zeros((robots, 2))
        self._scans = np.zeros(robots, np.intp)

    def reset(self, robot: int, world: Any = None) -> None:
        """Forget the map."""
        self.last[robot] = 0.0
        self._evidence[robot] = 0
        self._paths[robot] = None
        self._scans[robot] = 0

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        for robot in range(len(self.last)) if robots is None else robots:
            if self._scans[robot] == 0:
                self._origin[robot] = senses.odometry[robot, :2]
            pose = senses.odometry[robot].copy()
            pose[:2] -= self._origin[robot]
            self._map(robot, pose, senses.ranges[robot])
            goal = _goal_in_world(pose, senses.goal[robot])
            if self._scans[robot] % REPLAN_EVERY == 0 or self._paths[robot] is None:
                self._paths[robot] = self._plan(robot, pose, goal)
            self._scans[robot] += 1
            points = [_to_robot(self._walls_near(robot, pose), pose), seen_points(senses.ranges[robot])]
            self._follow(robot, pose, goal, np.concatenate(points))
        return self.last.copy()

    def _map(self, robot: int, pose: np.ndarray, ranges: np.ndarray) -> None:
        """Update the evidence: up where rays end, down where they pass."""
        angles = np.array(ROBOT.column_angles) + pose[2]
        camera = pose[:2] + ROBOT.camera_ahead * np.array([np.cos(pose[2]), np.sin(pose[2])])
        rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        grid = self._evidence[robot]
        steps = np.arange(0.0, ROBOT.far, RESOLUTION)
        passed = steps[None, :] < ranges[:, None] - 0.15
        cells = self._cells((camera + steps[None, :, None] * rays[:, None])[passed])
        grid[cells] = np.maximum(grid[cells] - 1, -2)
        ends = ranges < ROBOT.far
        cells = self._cells(camera + ranges[ends, None] * rays[ends])
        grid[cells] = np.minimum(np.maximum(grid[cells], 0) + 2, 8)

    def _cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        numbers = np.clip(((points + self.side / 2) / RESOLUTION).astype(int), 0, self.cells - 1)
        return numbers[:, 1], numbers[:, 0]

    def _walls_near(self, robot: int, pose: np.ndarray) -> np.ndarray:
        """Centers of occupied cells within 3 m ``(M, 2)`` [m]."""
        low, high = (
            np.clip((pose[:2] + self.side / 2 + reach) / RESOLUTION, 0, self.cells).astype(int)
            for reach in (-3.2, 3.2)
        )
        window = self._evidence[robot, low[1] : high[1], low[0] : high[0]]
        walls = (np.argwhere(window > 0)[:, ::-1] + low + 0.5) * RESOLUTION - self.side / 2
        return np.asarray(walls[np.hypot(*(walls - pose[:2]).T) < 3.0])

    def _plan(self, robot: int, pose: np.ndarray, goal: tuple[float, float]) -> np.ndarray | None:
        taken = self._evidence[robot] > 0
        rows, columns = self._window(taken, tuple(pose[:2]), goal)
        taken = taken[rows, columns].astype(np.uint8)
        corner = (rows.start, columns.start)
        too_close, much_too_close = (_within(taken, reach) for reach in (INFLATION, TIGHT))
        for close, cost_of_close in ((too_close, np.inf), (much_too_close, 6.0)):
            cost = np.where(close, np.inf, np.where(too_close, cost_of_close, 1.0))
            path = shortest_path(cost, tuple(pose[:2]), goal, self.side, corner=corner)
            if path is not None:
                return path
        return None

    def _window(
        self, taken: np.ndarray, start: tuple[float, float], goal: tuple[float, float]
    ) -> tuple[slice, slice]:
        """Rows and columns with start, goal, all occupied cells and free cells around them.

        No path outside is cheaper: clamped to the window it is no longer, and the border is free.
        """
        (y0, y1), (x0, x1) = self._cells(np.array([start, goal]))
        margin = math.ceil(INFLATION / RESOLUTION) + 1
        out = []
        for used, ends in ((taken.any(axis=1), (y0, y1)), (taken.any(axis=0), (x0, x1))):
            among = [*np.flatnonzero(used)[[0, -1]], *ends] if used.any() else list(ends)
            out.append(slice(max(min(among) - margin, 0), min(max(among) + margin + 1, self.cells)))
        return out[0], out[1]


def _within(taken: np.ndarray, reach: float) -> np.ndarray:
    """Mask of the cells within ``reach`` [m] of an occupied one, between centers ``(n, m)`` bool."""
    import cv2

    count = math.ceil(reach / RESOLUTION)
    offset = np.arange(-count, count + 1)
    # equal to a distance transform, to the last digit
    disc = np.sqrt(offset[:, None] ** 2 + offset**2) * RESOLUTION < reach
    grown = cv2.dilate(taken, disc.astype(np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(grown > 0)


def seen_points(ranges: np.ndarray) -> np.ndarray:
    """Points in view in the robot's frame ``(M, 2)`` [m]."""
    seen = ranges < ROBOT.far
    angles = np.array(ROBOT.column_angles)[seen]
    return np.stack(
        [ROBOT.camera_ahead + ranges[seen] * np.cos(angles), ranges[seen] * np.sin(angles)], axis=1
    )


def carrot(path: np.ndarray, pose: np.ndarray, ahead: float) -> tuple[float, float]:
    """Point of a path ``ahead`` [m] after the one nearest to the robot."""
    nearest = int(np.hypot(*(path - pose[:2]).T).argmin())
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[nearest:], axis=0).T))])
    index = nearest + int(np.searchsorted(along, ahead).clip(0, len(along) - 1))
    return float(path[index, 0]), float(path[index, 1])


def _goal_in_world(pose: np.ndarray, goal: np.ndarray) -> tuple[float, float]:
    distance, bearing = goal
    return (
        float(pose[0] + distance * np.cos(pose[2] + bearing)),
        float(pose[1] + distance * np.sin(pose[2] + bearing)),
    )


def _to_robot(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    dx, dy = (points - pose[:2]).T
    return np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)

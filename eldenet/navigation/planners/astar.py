"""A* on a grid with the dynamic window: with the true map, or with a map built while driving."""

import math
from typing import Any

import numpy as np

from eldenet.navigation.observer import Senses
from eldenet.navigation.planners.dwa import DynamicWindow
from eldenet.navigation.planners.online_map import OnlineMap
from eldenet.navigation.planners.paths import inflated_cost, shortest_path
from eldenet.simulation.arenas import clearance_map
from eldenet.simulation.robot import ROBOT, view_of

CARROT = 1.6  # distance to the target along the path [m]; experiments/table6_time/carrots.md
REPLAN_EVERY = 5  # control periods, on a map built while driving
OTHER_GOAL = 0.1  # a goal that moves by more is another way-point [m]
_FINE = 0.05  # cells of the full map whose centers are the window's points [m]


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
        """Choose the next command at ``pose (3,)``, among points ``(M, 2)`` in the robot's frame [m].

        Without a path the target is ``goal``, in the frame of the pose and the path.
        """
        path = self._paths[robot]
        target = goal if path is None else _point_along(path, pose, self.carrot)
        self.last[robot] = self.window.choose(
            points, tuple(to_robot(np.array([target]), pose)[0]), tuple(self.last[robot])
        )


class AStarDWA(_PathFollower):
    """A* on the full map from the true pose, once for each way-point, then the dynamic window along the path.

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
        clearance = clearance_map(world.arena.obstacles, world.arena.side, _FINE)
        # cells next to a wall are half a cell from it, give or take rounding
        edge = np.argwhere(clearance <= _FINE / 2 + 1e-6)
        self._points[robot] = (edge[:, ::-1] + 0.5) * _FINE - world.arena.side / 2

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        for robot in range(len(self.last)) if robots is None else robots:
            world = self._worlds[robot]
            scanned = pose = np.array(world.pose)
            if senses.scanned_from is not None:  # decide for a later pose
                before, after = senses.scanned_from[robot], senses.odometry[robot]
                place = from_robot(to_robot(after[None, :2], before), scanned)[0]
                pose = np.array([*place, scanned[2] + after[2] - before[2]])
            goal = goal_in_world(pose, senses.goal[robot])
            last_goal = self._goals[robot]
            if last_goal is None or math.dist(goal, last_goal) > OTHER_GOAL:
                self._goals[robot] = goal
                cost = inflated_cost(clearance_map(world.arena.obstacles, world.arena.side))
                self._paths[robot] = shortest_path(cost, tuple(pose[:2]), goal, world.arena.side)
            points = [self._points[robot], from_robot(seen_points(senses.ranges[robot]), scanned)]
            self._follow(robot, pose, goal, to_robot(np.concatenate(points), pose))
        return self.last.copy()


class AStarOnlineDWA(_PathFollower):
    """A* on a map built from the robot's own ranges and odometry, then the dynamic window.

    The path is searched again every second; see :class:`~eldenet.navigation.planners.online_map.OnlineMap`.
    """

    name = "astar_online_dwa"

    def __init__(self, *, carrot: float = CARROT, robots: int = 1) -> None:
        super().__init__(carrot=carrot, robots=robots)
        self._maps = [OnlineMap() for _ in range(robots)]
        self._scans = np.zeros(robots, np.intp)

    def reset(self, robot: int, world: Any = None) -> None:
        """Forget the map."""
        self.last[robot] = 0.0
        self._maps[robot].reset()
        self._paths[robot] = None
        self._scans[robot] = 0

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        for robot in range(len(self.last)) if robots is None else robots:
            known = self._maps[robot]
            pose = known.place(senses.odometry[robot])
            scanned_from = pose if senses.scanned_from is None else known.place(senses.scanned_from[robot])
            known.add(scanned_from, *senses.scan(robot))
            goal = goal_in_world(pose, senses.goal[robot])
            if self._scans[robot] % REPLAN_EVERY == 0 or self._paths[robot] is None:
                self._paths[robot] = known.plan(pose, goal)
            self._scans[robot] += 1
            seen = from_robot(seen_points(senses.ranges[robot]), scanned_from)
            points = np.concatenate([known.walls_near(pose), seen])
            self._follow(robot, pose, goal, to_robot(points, pose))
        return self.last.copy()


def seen_points(ranges: np.ndarray) -> np.ndarray:
    """Points in view in the robot's frame ``(M, 2)`` [m]."""
    seen = ranges < ROBOT.far
    angles = np.array(view_of(len(ranges)).column_angles)[seen]
    return np.stack(
        [ROBOT.camera_ahead + ranges[seen] * np.cos(angles), ranges[seen] * np.sin(angles)], axis=1
    )


def _point_along(path: np.ndarray, pose: np.ndarray, ahead: float) -> tuple[float, float]:
    """Point of a path ``(K, 2)`` that is ``ahead`` [m] after the one nearest to the robot ``(3,)``."""
    nearest = int(np.hypot(*(path - pose[:2]).T).argmin())
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[nearest:], axis=0).T))])
    index = nearest + int(np.searchsorted(along, ahead).clip(0, len(along) - 1))
    return float(path[index, 0]), float(path[index, 1])


def goal_in_world(pose: np.ndarray, goal: np.ndarray) -> tuple[float, float]:
    """The goal ``(2,)`` (distance [m], bearing [rad]) in the frame of the pose ``(3,)``."""
    distance, bearing = goal
    return (
        float(pose[0] + distance * np.cos(pose[2] + bearing)),
        float(pose[1] + distance * np.sin(pose[2] + bearing)),
    )


def to_robot(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points ``(N, 2)`` of the pose's frame in the robot's frame."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    dx, dy = (points - pose[:2]).T
    return np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)


def from_robot(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points ``(N, 2)`` of the robot's frame in the pose's frame."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + pose[:2])

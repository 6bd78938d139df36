"""Plan far, steer near: A* on a map built while driving gives way-points, the learned driver steers there.

The learned driver alone is fast and avoids what it remembers, but knows no way around: it runs into dead ends
and goes round in circles. Here it gets a way-point for its goal. Its command is driven if its arc is free of
remembered obstacles and of places never seen, and faster where a faster arc has room; otherwise the dynamic
window chooses one. Where its wheels slide it slows down.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from eldenet.navigation.collision_arcs import REACH, STEP, ArcTable, arc_table
from eldenet.navigation.observer import Senses
from eldenet.navigation.obstacle_memory import Memory
from eldenet.navigation.on_robot import OnRobot
from eldenet.navigation.planners.astar import REPLAN_EVERY, goal_in_world, to_robot
from eldenet.navigation.planners.dwa import DynamicWindow
from eldenet.navigation.planners.online_map import OnlineMap
from eldenet.navigation.policy import Driver, Navigator
from eldenet.navigation.safety_margins import BESIDE, FAST_ROOM, STEER_MARGIN, STEER_ROOM, WINDOW_SLACK
from eldenet.simulation.robot import ROBOT

NO_WAY = 5.0  # time for which the map must have closed every way to the goal for sure [s]
NO_PATH = 20.0  # the same where a search finds no path, but by readings that may be wrong [s]
REMEMBERED = 300  # control periods that points and the robot's own way are remembered
#: Cost of a meter where the nearest obstacle is less than this away [m]; 1 elsewhere.
COSTS = ((0.25, math.inf), (0.35, 20.0), (0.42, 3.0), (0.50, 1.5))
WIDE = ((0.40, math.inf), (0.50, 1.5))  # the same where it went round in a circle or could only stand
AHEAD = 3.0  # greatest distance along the path to the way-point [m]
LEAST_AHEAD = 0.5  # least distance to it [m]
DWA_AHEAD = 1.3  # distance to the target of the dynamic window [m]
FREE = 0.8  # time for which an arc must be free [s]
HORIZON = 1.8  # duration of an arc, along which it needs room [s]
SIDEWAYS = 0.1  # speed across its heading from which on a robot slides [m/s]; a normal floor stays below 0.04
SLIDING_FOR = 5.0  # time for which it then drives slower [s]
SLIDING_SPEED = 0.5  # of it then, relative to the learned driver's
FREE_START = 0.6  # radius around the start that counts as seen [m]
LOOK_WAY, LOOK_TURN = 0.3, 2 * math.pi  # within this way [m], so much turning [rad] is to look all round
UNSEEN_REACH = 1.6  # distance up to which unseen places count [m]
CIRCLE_RADIUS, CIRCLE_WAY, CIRCLE_TIME = 0.7, 3.0, 6.0  # back within [m], after a way [m] and a time [s]
OUT_OF_CIRCLE = 8.0  # time for which the dynamic window alone then follows a path through wide places [s]
#: Commands [m/s], [rad/s] of a robot that can only stand, for a time [s]; those that turn need a lidar.
BACK, BACK_LEFT, BACK_RIGHT = BACKS = (-0.25, 0.0), (-0.25, 0.5), (-0.25, -0.5)
BACKS_FOR = 2.0
#: Of what this driver decides, without and with ``heeds_unseen``; stored rows name it.
STEER_VERSION, HEEDS_VERSION = 4, 1
_LEVELS = 20  # of speed in the table of arcs, per m/s


class PlanAndSteer(OnRobot):
    """A* on a map built while driving; the learned driver steers to way-points on its path.

    The map keeps what was seen; unseen cells are free for the plan, but not for the next arc. When the robot
    comes back to where it was, it follows a path through wider places with the dynamic window alone for a
    while. Where it can only stand, it backs up, or turns on the spot, and does the same. With a lidar, which
    sees what is behind, it turns while it backs up.

    Args:
        path: policy of the learned driver; None: the packaged one.
        slows_within: distance to the goal at which it slows down [m].
        heeds_unseen: the dynamic window keeps out of places never seen until the robot has looked all round,
            and may turn away from a wall close by; False: as for the stored rows of the studies.
        walkers: track pedestrians: forget where they were, remember where they will be.
        robots: number of robots.

    Raises:
        ValueError: the learned driver backs up, or its middle action turns.

    Attributes:
        navigator: the learned driver.
        circles: how often each robot was caught in a circle ``(robots,)``.
    """

    name = "astar_online_dqn"
    patience = 80.0

    def __init__(
        self,
        path: str | Path | Sequence[str | Path] | None = None,
        *,
        slows_within: float | None = 1.0,
        heeds_unseen: bool = True,
        walkers: bool = False,
        robots: int = 1,
    ) -> None:
        super().__init__()
        self.heeds_unseen = heeds_unseen
        self.navigator = Navigator.load(path, slows_within=slows_within, robots=robots)
        self.observer: Driver = self.navigator.observer
        rates = self.observer.turn_rates.tolist()
        if self.observer.turn_factors.min() < 0 or rates[len(rates) // 2] != 0:
            raise ValueError(
                f"turn_rates={rates}, turn_factors={self.observer.turn_factors.tolist()}: give a policy "
                "that never backs up and whose middle action drives straight"
            )
        self.observer.memory = Memory(
            robots, REMEMBERED, seen_through=self.observer.memory.seen_through, walkers=walkers
        )
        self._maps = [OnlineMap() for _ in range(robots)]
        self._paths: list[np.ndarray | None] = [None] * robots
        self._trails: list[list[tuple[float, float, float]]] = [[] for _ in range(robots)]  # x, y, way so far
        self._before = np.full((robots, 3), np.nan)  # last poses
        self._sliding = np.zeros(robots, np.intp)  # control periods for which it still drives slower
        self._wide = np.zeros(robots, np.intp)  # control periods for which it still takes wide paths
        self._backs = np.zeros(robots, np.intp)  # control periods that it still backs up
        self._closed = np.zeros(robots, np.intp)  # control periods without a way
        self._pathless = np.zeros(robots, np.intp)  # control periods without a path
        self.circles = np.zeros(robots, np.intp)
        self._looks = np.zeros((robots, 3))  # where it is [m], and how far it has turned there [rad]
        self._window = DynamicWindow(WINDOW_SLACK if heeds_unseen else 0.0)
        arcs = [(level / _LEVELS, rate) for level in range(_LEVELS + 1) for rate in rates]
        self._table = arc_table((*arcs, *BACKS), HORIZON, STEER_MARGIN)
        self._sees_behind = False

    def reset(self, robot: int | slice = slice(None), world: Any = None) -> None:
        """Forget the map."""
        super().reset(robot, world)
        self.navigator.reset(robot)
        for number in np.atleast_1d(np.arange(len(self._maps))[robot]).tolist():
            self._restart(number)

    def _restart(self, robot: int) -> None:
        """Start a new map, and forget the way so far."""
        self._maps[robot].reset()
        self._paths[robot] = None
        self._trails[robot] = []
        self._before[robot] = np.nan
        self._sliding[robot] = self._looks[robot] = 0
        self._wide[robot] = self._backs[robot] = self.circles[robot] = self._closed[robot] = 0
        self._pathless[robot] = 0

    @property
    def no_way(self) -> bool:
        """Whether its map has closed every way to the goal for a while."""
        closed, pathless = self._closed[0] * ROBOT.period, self._pathless[0] * ROBOT.period
        return bool(closed >= NO_WAY or pathless >= NO_PATH)

    @torch.inference_mode()
    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        who = np.arange(self.observer.robots) if robots is None else robots
        goal, poses = senses.goal.copy(), {}
        self._sees_behind = senses.ranges.shape[1] > ROBOT.columns
        walls_before = self._remembered(senses, who)
        for robot in who.tolist():
            known = self._maps[robot]
            if not known.covers(senses.odometry[robot]):
                self._restart(robot)
            pose = poses[robot] = known.place(senses.odometry[robot])
            known.add(
                pose if senses.scanned_from is None else known.place(senses.scanned_from[robot]),
                *senses.scan(robot),
            )
            self._sliding[robot] = max(self._sliding[robot] - 1, 0)
            if sideways(self._before[robot], pose) > SIDEWAYS:
                self._sliding[robot] = round(SLIDING_FOR / ROBOT.period)
            self._before[robot] = pose
            self._plan(robot, pose, goal_in_world(pose, goal[robot]))
            goal[robot] = waypoint(self._paths[robot], pose, goal[robot], walls_before[robot])
        observation = self.observer.observe(senses._replace(goal=goal), who)
        actions = self.navigator.network(torch.from_numpy(observation).double()).argmax(1).numpy()
        walls_now = self._remembered(senses, who)
        out = self.observer.last.copy()
        for robot, action in zip(who.tolist(), actions, strict=True):
            wanted = self.observer.speeds[robot, action], self.observer.turn_rates[action]
            walls, unseen = walls_now[robot], self._unseen(robot, poses[robot])
            backs = self._backs[robot] > 0
            if not backs and self._wide[robot] == 0 and self._is_safe(robot, int(action), walls, unseen):
                if self._sliding[robot] > 0:
                    speed = SLIDING_SPEED * wanted[0]
                else:
                    distance = float(senses.goal[robot, 0])
                    speed = max(wanted[0], self._fastest(int(action), distance, walls, unseen))
                out[robot] = speed, wanted[1]
            else:
                hidden = self._hidden(robot, poses[robot])
                out[robot] = self._careful(robot, float(goal[robot, 1]), walls, hidden)
            self._looked(robot, out[robot], poses[robot])
        self.observer.last = out
        return out

    def _remembered(self, senses: Senses, who: np.ndarray) -> dict[int, np.ndarray]:
        """Remembered points within 3 m of each robot, in its frame ``(M, 2)`` [m]."""
        row, x, y, _ = self.observer.memory.near(senses.odometry[who], who)
        points = np.stack([x, y], axis=1)
        return {int(robot): points[row == number] for number, robot in enumerate(who)}

    def _plan(self, robot: int, pose: np.ndarray, goal: tuple[float, float]) -> None:
        """Search a path from ``pose (3,)``: every second, in every period without one, after each circle."""
        trail = self._trails[robot]
        extend(trail, pose)
        self._wide[robot] = max(self._wide[robot] - 1, 0)
        circle = self._wide[robot] == 0 and is_circle(trail)
        if circle:
            self.circles[robot] += 1
            self._wide[robot] = round(OUT_OF_CIRCLE / ROBOT.period)
            del trail[:-1]
        if circle or len(trail) % REPLAN_EVERY == 1 or self._paths[robot] is None:
            known = self._maps[robot]
            points = self.observer.memory.points(robot) - known.origin
            wide = known.plan_by_costs(pose, goal, WIDE, points) if self._wide[robot] > 0 else None
            self._paths[robot] = known.plan_by_costs(pose, goal, COSTS, points) if wide is None else wide
        pathless = self._paths[robot] is None
        self._pathless[robot] = self._pathless[robot] + 1 if pathless else 0
        closed = pathless and self._maps[robot].closes(pose, goal)
        self._closed[robot] = self._closed[robot] + 1 if closed else 0

    def _unseen(self, robot: int, pose: np.ndarray) -> np.ndarray:
        """Centers of cells near the robot without evidence, in its frame ``(M, 2)`` [m].

        These were never seen, or their evidence has come back to 0.
        """
        centers, evidence = self._maps[robot].near(pose, UNSEEN_REACH)
        return to_robot(centers[(evidence == 0) & (np.hypot(*centers.T) > FREE_START)], pose)

    def _hidden(self, robot: int, pose: np.ndarray) -> np.ndarray:
        """Centers of cells that were never seen, but slivers; none once the robot has looked all round."""
        if not self.heeds_unseen or self._looks[robot, 2] > LOOK_TURN:
            return np.empty((0, 2))
        centers = self._maps[robot].unseen_near(pose, UNSEEN_REACH)
        return to_robot(centers[np.hypot(*centers.T) > FREE_START], pose)

    def _looked(self, robot: int, command: np.ndarray, pose: np.ndarray) -> None:
        """Count how far it has turned where it stands, ``pose (3,)``."""
        if math.dist(pose[:2], self._looks[robot, :2]) > LOOK_WAY:
            self._looks[robot] = *pose[:2], 0.0
        self._looks[robot, 2] += abs(float(command[1])) * ROBOT.period

    def _careful(
        self, robot: int, bearing: float, walls: np.ndarray, hidden: np.ndarray
    ) -> tuple[float, float]:
        """Command of the dynamic window; where that can only stand, back up or turn on the spot.

        ``walls (M, 2)`` are remembered points in the robot's frame [m], here and below; ``hidden (M, 2)``
        were never seen.
        """
        target = DWA_AHEAD * math.cos(bearing), DWA_AHEAD * math.sin(bearing)
        last = tuple(self.observer.last[robot])
        self._backs[robot] = max(self._backs[robot] - 1, 0)
        if self._backs[robot] == 0:
            command = self._window.choose(walls, target, last, hidden)
            if command != (0.0, 0.0) or last[0] > 0:
                return command
            self._backs[robot] = round(BACKS_FOR / ROBOT.period)
            self._wide[robot] = round(OUT_OF_CIRCLE / ROBOT.period)
        behind = np.concatenate([walls, hidden])
        turns = (BACK_LEFT, BACK_RIGHT) if bearing > 0 else (BACK_RIGHT, BACK_LEFT)
        for command in (turns[0], BACK, turns[1]) if self._sees_behind else (BACK,):
            number = len(self._table.commands) - len(BACKS) + BACKS.index(command)
            if _along(self._table, behind, number)[0] >= FREE:
                return command
        self._backs[robot] = 0
        return 0.0, self._free_turn(bearing, last[1], walls)

    def _free_turn(self, bearing: float, last: float, walls: np.ndarray) -> float:
        """Rate of a turn on the spot free of ``walls (M, 2)`` [rad/s], first as the last, else to the target.

        0 if there is none.
        """
        rates = self.observer.turn_rates.tolist()  # those of speed 0 are the table's first commands
        for rate in sorted(rates, key=lambda rate: -rate * math.copysign(1.0, last or bearing)):
            if rate and _along(self._table, walls, rates.index(rate))[0] >= HORIZON:
                return rate
        return 0.0

    def _fastest(self, action: int, distance: float, walls: np.ndarray, unseen: np.ndarray) -> float:
        """Greatest speed [m/s] at which an action's arc has room among ``(M, 2)`` to its end; 0 if none.

        The driver's own law knows only the nearest obstacle, so it also slows beside a wall that it passes.
        """
        top = ROBOT.max_speed * min(1.0, distance / self.observer.slows_within)
        for level in range(int(top * _LEVELS), 0, -1):
            command = level * self.observer.actions + action
            free, gap = _along(self._table, walls, command)
            if gap >= FAST_ROOM and min(free, _along(self._table, unseen, command)[0]) >= HORIZON:
                return level / _LEVELS
        return 0.0

    def _is_safe(self, robot: int, action: int, walls: np.ndarray, unseen: np.ndarray) -> bool:
        """Whether an action's arc is free of ``walls (M, 2)``, with room to turn, and of unseen places."""
        observer = self.observer
        level = int(np.clip(np.rint(observer.speeds[robot, action] * _LEVELS), 0, _LEVELS))
        command = level * observer.actions + action
        standing = observer.actions // 2  # speed 0, straight ahead
        free, gap = _along(self._table, walls, command)
        if free < FREE or gap < min(STEER_ROOM, _along(self._table, walls, standing)[1]):
            return False
        return _along(self._table, unseen, command)[0] >= FREE


def sideways(before: np.ndarray, now: np.ndarray) -> float:
    """Speed across the heading between poses ``(3,)`` of two periods in a row [m/s]; nan if one is nan."""
    turn = math.remainder(now[2] - before[2], math.tau)
    heading = before[2] + turn / 2
    dx, dy = now[:2] - before[:2]
    return abs(math.cos(heading) * dy - math.sin(heading) * dx) / ROBOT.period


def extend(trail: list[tuple[float, float, float]], pose: np.ndarray) -> None:
    """Add a pose ``(3,)`` to a trail of x, y and way so far [m], which forgets old ones.

    It forgets ``REPLAN_EVERY`` at once, so the length still tells when a search is due.
    """
    way = trail[-1][2] + math.dist(trail[-1][:2], pose[:2]) if trail else 0.0
    trail.append((float(pose[0]), float(pose[1]), way))
    if len(trail) > REMEMBERED:
        del trail[:REPLAN_EVERY]


def is_circle(trail: Sequence[tuple[float, float, float]]) -> bool:
    """Whether the robot is where it was before, though it has driven since: x, y [m] and way so far [m]."""
    apart = round(CIRCLE_TIME / ROBOT.period)
    if len(trail) <= apart:
        return False
    points = np.array(trail)
    x, y, way = points[-1]
    near = np.hypot(points[:-apart, 0] - x, points[:-apart, 1] - y) < CIRCLE_RADIUS
    return bool((near & (way - points[:-apart, 2] > CIRCLE_WAY)).any())


def waypoint(
    path: np.ndarray | None, pose: np.ndarray, goal: np.ndarray, walls: np.ndarray
) -> tuple[float, float]:
    """Distance left on a path [m] and bearing of its farthest point in a free straight line [rad].

    ``path (n, 2)`` (None: none is known) and ``pose (3,)`` are in the map's frame; ``goal (2,)`` has distance
    and bearing, ``walls (M, 2)`` are points in the robot's frame [m].
    """
    distance, bearing = float(goal[0]), float(goal[1])
    at = np.array([distance * math.cos(bearing), distance * math.sin(bearing)])
    if path is None or (distance <= AHEAD and is_free(at, walls)):
        return distance, bearing
    path = to_robot(path, pose)
    path = path[int(np.hypot(*path.T).argmin()) :]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    first, last = np.searchsorted(along, (LEAST_AHEAD, AHEAD)).clip(0, len(path) - 1)
    x, y = next((path[k] for k in range(last, first, -2) if is_free(path[k], walls)), path[first])
    return max(distance, float(along[-1])), math.atan2(y, x)


def is_free(target: np.ndarray, walls: np.ndarray) -> bool:
    """Whether the straight line to a target ``(2,)`` keeps clear of points ``(M, 2)`` [m]."""
    share = np.clip(walls @ target / max(float(target @ target), 1e-9), 0, 1)
    return bool((np.hypot(*(walls - share[:, None] * target).T) > BESIDE).all())


def _along(table: ArcTable, points: np.ndarray, command: int) -> tuple[float, float]:
    """Time until an arc meets one of the points ``(M, 2)`` [s], and its clearance [m]."""
    near = (np.abs(points) < REACH).all(axis=1)
    if not near.any():
        return table.horizon, math.inf
    cells = table.cells(points[near, 0], points[near, 1])
    return float(table.time[cells, command].min()) * STEP, float(table.gap[cells, command].min()) / 100

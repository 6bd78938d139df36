"""Plan far, steer near: A* on a map built while driving gives way-points, the learned driver goes there."""

from pathlib import Path
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from eldenet.navigation.collision_arcs import REACH, STEP, arc_table
from eldenet.navigation.observer import Senses
from eldenet.navigation.obstacle_memory import Memory
from eldenet.navigation.planners.astar import goal_in_world, seen_points, to_robot, from_robot
from eldenet.navigation.planners.online_map import OnlineMap
from eldenet.navigation.planners.paths import shortest_path
from eldenet.navigation.planners.dwa import DynamicWindow
from eldenet.navigation.policy import Navigator
from eldenet.simulation.arenas import RESOLUTION
from eldenet.simulation.robot import ROBOT
import os
E=lambda n,d: float(os.environ.get(n,d))
REPLAN_EVERY = 5  # control periods
FREE_START = E("FREE_START",0.6)  # radius around the start that is taken for free [m]
GUARD_HORIZON = 1.8
ENOUGH = E("ENOUGH",0.8)  # time for which an arc must be free [s]
UNSEEN = E("UNSEEN",0.8)
AHEAD = E("AHEAD",3.0)
LEVELS = 20
GMARGIN = E("GMARGIN",0.04)
SIDE_CLEAR = E("SIDE_CLEAR",0.35)
DIST = os.environ.get("DIST","path")
ROOM = E("ROOM",0.06)
WITHU = E("WITHU",0)
OTHER = E("OTHER",1)


BACK = ((-0.25, 0.0), (-0.25, 0.3), (-0.25, -0.3))


class PlanAndSteer:
    name = "astar_online_dqn"

    def __init__(self, path: str | Path | Sequence[str | Path] | None = None, *, robots: int = 1, **options: Any) -> None:
        self.navigator = Navigator.load(path, robots=robots, **options)
        self.observer = self.navigator.observer
        self.observer.memory = Memory(robots, int(E('MEM',300)), seen_through=2, walkers=False)
        self._maps = [OnlineMap() for _ in range(robots)]
        self._scans = np.zeros(robots, np.intp)
        self._paths: list[np.ndarray | None] = [None] * robots
        speeds = [level / LEVELS for level in range(LEVELS + 1)]
        self._commands = tuple((s, r) for s in speeds for r in self.observer.turn_rates.tolist())
        self._table = arc_table(self._commands, GUARD_HORIZON, GMARGIN)
        self._window = DynamicWindow()
        self._back = arc_table(BACK, GUARD_HORIZON, 0.03)
        self._backing = np.zeros(robots, int)
        self.stats = {}

    def reset(self, robot: int, world: Any = None) -> None:
        self.navigator.reset(robot)
        self._maps[robot].reset()
        self._paths[robot] = None
        self._backing[robot] = 0
        self._scans[robot] = 0

    @torch.inference_mode()
    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        who = np.arange(self.observer.robots) if robots is None else robots
        goal = senses.goal.copy()
        poses = {}
        row, x, y, _ = self.observer.memory.near(senses.odometry[who], who)
        for number, robot in enumerate(who):
            known = self._maps[robot]
            pose = poses[robot] = known.place(senses.odometry[robot])
            scanned = pose if senses.scanned_from is None else known.place(senses.scanned_from[robot])
            known.add(scanned, senses.ranges[robot])
            target = goal_in_world(pose, goal[robot])
            if self._scans[robot] % REPLAN_EVERY == 0 or self._paths[robot] is None:
                points = self.observer.memory.points(robot) - known._origin
                self._paths[robot] = plan_graded(known, pose, target, points)
            self._scans[robot] += 1
            mine = row == number
            walls = from_robot(np.stack([x[mine], y[mine]], axis=1), pose)
            goal[robot] = self._waypoint(robot, pose, goal[robot], target, walls)
        observation = self.observer.observe(senses._replace(goal=goal), who)
        values = self.navigator.network(torch.from_numpy(observation).double()).numpy()
        row, x, y, _ = self.observer.memory.near(senses.odometry[who], who)
        out = self.observer.last.copy()
        for number, robot in enumerate(who):
            mine = row == number
            walls = np.stack([x[mine], y[mine]], axis=1)
            out[robot] = self._guarded(robot, poses[robot], walls, values[number], goal[robot])
        self.observer.last = out
        return out

    def _waypoint(self, robot: int, pose: np.ndarray, goal: np.ndarray, target: tuple[float, float], walls) -> tuple[float, float]:
        path = self._paths[robot]
        if path is None:
            return goal[0], goal[1]
        nearest = int(np.hypot(*(path - pose[:2]).T).argmin())
        path = path[nearest:]
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
        if goal[0] <= AHEAD and _free(pose[:2], np.array(target), walls):
            return goal[0], goal[1]
        last = int(np.searchsorted(along, AHEAD).clip(0, len(along) - 1))
        choice = path[min(len(path) - 1, 5)]
        for index in range(last, 5, -2):
            if _free(pose[:2], path[index], walls):
                choice = path[index]
                break
        x, y = to_robot(choice[None], pose)[0]
        remaining = max(goal[0], float(along[-1])) if DIST == "path" else float(np.hypot(x, y))
        if DIST == "goal": remaining = goal[0]
        return remaining, float(np.arctan2(y, x))

    def _guarded(self, robot, pose, walls, values, goal):
        observer, table = self.observer, self._table
        known = self._maps[robot]
        centers, evidence = known.near(pose, 1.6)
        unseen = to_robot(centers[(evidence == 0) & (np.hypot(*centers.T) > FREE_START)], pose)
        speeds = observer.speeds[robot]
        level = np.clip(np.rint(speeds * LEVELS), 0, LEVELS).astype(int)
        actions = level * observer.actions + np.arange(observer.actions)
        free, gap, stand = _arcs(table, walls)
        free_unseen, _, _ = _arcs(table, unseen)
        safe = (free[actions] >= ENOUGH) & (gap[actions] >= min(ROOM, stand)) & (free_unseen[actions] >= UNSEEN)
        action = int(np.argmax(np.where(safe, values, -np.inf)))
        if safe.any() and (OTHER or action == values.argmax()):
            self._backing[robot] = 0
            self._count('q' if action == values.argmax() else 'other')
            return float(speeds[action]), float(observer.turn_rates[action])
        step = 1.3
        target = (step * float(np.cos(goal[1])), step * float(np.sin(goal[1])))
        points = np.concatenate([walls, unseen]) if WITHU else walls
        speed, turn = self._window.choose(points, target, tuple(np.maximum(observer.last[robot], (0, -9))))
        if self._backing[robot] > 0 or (speed == 0 and turn == 0 and observer.last[robot, 0] <= 0):
            back_free, back_gap, _ = _arcs(self._back, walls)
            allowed = back_free >= 0.6
            if allowed.any() and stand < 0.18:
                self._backing[robot] = 1
                self._count('back')
                number = int(np.argmax(np.where(allowed, back_gap, -1)))
                return BACK[number]
            self._backing[robot] = 0
        self._count('dwa')
        return speed, turn

    def _count(self, name):
        self.stats[name] = self.stats.get(name, 0) + 1


def _arcs(table, points):
    near = (np.abs(points) < REACH).all(axis=1)
    if not near.any():
        return np.full(len(table.commands), GUARD_HORIZON), np.full(len(table.commands), 9.0), 9.0
    cells = np.unique(table.cells(points[near, 0], points[near, 1]))
    gap = table.gap[cells].min(axis=0) / 100
    return table.time[cells].min(axis=0) * STEP, gap, float(gap[2])


LEVELS_OF_COST = eval(os.environ.get("COSTS", "((0.25, np.inf), (0.35, 20.0), (0.42, 3.0), (0.5, 1.5))"))


def plan_graded(known, pose, goal, points):
    import cv2
    taken = known.evidence > 1
    taken[known.cells(points)] = True
    rows, columns = known._window(taken, tuple(pose[:2]), goal)
    taken = taken[rows, columns].astype(np.uint8)
    away = cv2.distanceTransform(1 - taken, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * RESOLUTION
    cost = np.ones(taken.shape)
    for below, value in reversed(LEVELS_OF_COST):
        cost[away < below - 1e-3] = value
    return shortest_path(cost, tuple(pose[:2]), goal, known.side, corner=(rows.start, columns.start))


def _free(start, end, walls) -> bool:
    if not len(walls):
        return True
    along = end - start
    length = float(np.hypot(*along))
    share = np.clip((walls - start) @ along / max(length**2, 1e-9), 0, 1)
    off = walls - start - share[:, None] * along
    return bool(np.hypot(*off.T).min() > SIDE_CLEAR)

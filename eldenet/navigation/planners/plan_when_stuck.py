"""Steer, and plan where stuck: the learned driver drives alone until it gets nowhere, then A* leads it out.

It is for the depth of a network. What that misjudges up close, a plan runs into, because its way-points lead
past things; so no map has a say while the driver comes nearer to the goal.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.navigation.observer import Senses
from eldenet.navigation.on_robot import OnRobot
from eldenet.navigation.planners.astar import REPLAN_EVERY, goal_in_world
from eldenet.navigation.planners.online_map import OnlineMap
from eldenet.navigation.planners.plan_and_steer import extend, is_circle, waypoint
from eldenet.navigation.policy import Driver, Navigator
from eldenet.simulation.robot import ROBOT

REACH = 2.0  # range up to which readings draw the map [m]: what is farther, a network often puts before it
NEARER, STUCK_FOR = 0.5, 8.0  # progress toward the goal [m]; without it for this time [s], it is stuck
OUT = 1.0  # once this much nearer to the goal than ever before it was stuck [m], it is out
#: Cost of a meter by clearance, as for PlanAndSteer. Noise narrows doors on the map, so little is closed.
COSTS = ((0.2, math.inf), (0.3, 20.0), (0.4, 5.0), (0.6, 1.5))
OTHER_GOAL = 0.5  # a goal that moves by more at once is another one [m]
_NO_POINTS = np.empty((0, 2))


class PlanWhenStuck(OnRobot):
    """The learned driver alone; where it is stuck, it drives to way-points of A* until it is out.

    It is stuck when it drives in a circle, or comes no nearer to the goal for 8 s. While it is not, it
    decides exactly as :class:`~eldenet.navigation.policy.Navigator` with the same ``slows_within``.

    Args:
        path: policy of the learned driver; None: the packaged one.
        slows_within: distance to the goal at which it slows down [m].
        walkers: track pedestrians; None: as in training.
        robots: number of robots.

    Attributes:
        navigator: the learned driver.
        rescues: how often each robot was stuck ``(robots,)``.
    """

    name = "plan_when_stuck"
    patience = 80.0

    def __init__(
        self,
        path: str | Path | Sequence[str | Path] | None = None,
        *,
        slows_within: float | None = 1.0,
        walkers: bool | None = None,
        robots: int = 1,
    ) -> None:
        super().__init__()
        self.navigator = Navigator.load(path, walkers=walkers, slows_within=slows_within, robots=robots)
        self.observer: Driver = self.navigator.observer
        self._maps = [OnlineMap(REACH) for _ in range(robots)]
        self._paths: list[np.ndarray | None] = [None] * robots
        self._trails: list[list[tuple[float, float, float]]] = [[] for _ in range(robots)]
        self._goals = np.full((robots, 2), np.nan)  # in the map's frame [m]
        self._nearest = np.full(robots, math.inf)  # that it has come to the goal [m]
        self._idle = np.zeros(robots, np.intp)  # control periods since its last progress
        self._stuck = np.full(robots, -1, np.intp)  # control periods since it is stuck; -1: it is not
        self._nearest_before = np.zeros(robots)  # that it had come to the goal when it got stuck [m]
        self.rescues = np.zeros(robots, np.intp)

    def reset(self, robot: int | slice = slice(None), world: Any = None) -> None:
        """Forget the map."""
        super().reset(robot, world)
        self.navigator.reset(robot)
        self.rescues[robot] = 0
        for number in np.atleast_1d(np.arange(len(self._maps))[robot]).tolist():
            self._restart(number)

    def _restart(self, robot: int) -> None:
        """Start a new map; the next goal counts as another one, so the rest starts anew with it."""
        self._maps[robot].reset()
        self._goals[robot] = np.nan

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``; only the rows of ``robots`` count."""
        goal = senses.goal.copy()
        for robot in (np.arange(self.observer.robots) if robots is None else robots).tolist():
            known = self._maps[robot]
            if not known.covers(senses.odometry[robot]):
                self._restart(robot)
            pose = known.place(senses.odometry[robot])
            known.add(
                pose if senses.scanned_from is None else known.place(senses.scanned_from[robot]),
                *senses.scan(robot),
            )
            at = goal_in_world(pose, goal[robot])
            self._judge(robot, pose, at, float(goal[robot, 0]))
            if self._stuck[robot] < 0:
                continue
            if self._stuck[robot] % REPLAN_EVERY == 0 or self._paths[robot] is None:
                self._paths[robot] = known.plan_by_costs(pose, at, COSTS, _NO_POINTS)
            _, x, y, _ = self.observer.memory.near(senses.odometry[robot, None], np.array([robot]))
            walls = np.stack([x, y], axis=1)
            goal[robot] = waypoint(self._paths[robot], pose, goal[robot], walls)
        return self.navigator.commands(senses._replace(goal=goal), robots)

    def _judge(self, robot: int, pose: np.ndarray, goal: tuple[float, float], distance: float) -> None:
        """Note whether the robot gets stuck at ``pose (3,)``, or comes out; once in each period."""
        trail = self._trails[robot]
        if not math.dist(goal, self._goals[robot]) < OTHER_GOAL:  # another one
            self._nearest[robot], self._idle[robot], self._stuck[robot] = math.inf, 0, -1
            trail.clear()
        self._goals[robot] = goal
        extend(trail, pose)
        self._idle[robot] += 1
        if distance < self._nearest[robot] - NEARER:
            self._nearest[robot], self._idle[robot] = distance, 0
        if self._stuck[robot] >= 0:
            self._stuck[robot] += 1
            if distance < self._nearest_before[robot] - OUT:
                self._stuck[robot], self._idle[robot] = -1, 0
                del trail[:-1]
        elif self._idle[robot] * ROBOT.period >= STUCK_FOR or is_circle(trail):
            self._stuck[robot], self._nearest_before[robot] = 0, self._nearest[robot]
            self._paths[robot] = None
            self.rescues[robot] += 1

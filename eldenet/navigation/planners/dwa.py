"""The dynamic window approach: of the arcs that can be driven next, the best that hits nothing.

Fox, Burgard, Thrun, "The dynamic window approach to collision avoidance", IEEE RAM 1997. The arcs' collision
times and clearances come from one table (:mod:`eldenet.navigation.collision_arcs`).
"""

from typing import Any

import numpy as np

from eldenet.navigation.collision_arcs import REACH, STEP, arc_table
from eldenet.navigation.observer import SECTORS, Observer, Senses
from eldenet.simulation.robot import ROBOT

SPEEDS = tuple(round(0.1 * step, 1) for step in range(11))  # [m/s]
TURNS = tuple(round(-1.2 + 0.2 * step, 1) for step in range(13))  # [rad/s]
COMMANDS = tuple((speed, turn) for speed in SPEEDS for turn in TURNS)
HORIZON = 1.6  # [s]
TURNING_GAP = 0.03  # between corners and points while it turns on the spot [m]
STOPPING_TIME = 0.6  # that an arc must stay free, and longer the faster it is [s]


class DynamicWindow:
    """Chooses a command towards a target among points, for one robot.

    Args:
        clearance: weight of the distance kept from obstacles, against progress to the target [1/m].
        room: clearance that every arc keeps [m]; with 0.10 the robot can turn on the spot wherever it gets to
            (its corners stick out).
        margin: added to the footprint on all sides [m].
        enough: clearance beyond which more is worth nothing [m].
        acceleration: bounds of the window [m/s2].
        turn_acceleration: bounds of the window [rad/s2].
    """

    def __init__(
        self,
        *,
        clearance: float = 0.8,
        room: float = 0.10,
        margin: float = 0.05,
        enough: float = 0.30,
        acceleration: float = 2.5,
        turn_acceleration: float = 6.0,
    ) -> None:
        self.clearance, self.room, self.enough = clearance, room, enough
        self.acceleration, self.turn_acceleration = acceleration, turn_acceleration
        self.table = arc_table(COMMANDS, HORIZON, margin)
        speed, turn = self.table.commands.T
        self.speed, self.turn = speed, turn
        self._standing = int(np.flatnonzero((speed == 0) & (turn == 0))[0])
        half = turn * HORIZON / 2
        chord = speed * HORIZON * np.sinc(half / np.pi)
        self.end = np.stack([chord * np.cos(half), chord * np.sin(half), 2 * half], axis=1)

    def choose(
        self, points: np.ndarray, target: tuple[float, float], last: tuple[float, float]
    ) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s].

        Args:
            points: ``(M, 2)`` obstacle points in the robot's frame [m].
            target: x ahead, y left [m].
            last: the command that is being driven.
        """
        near = (np.abs(points) < REACH).all(axis=1)
        cells = self.table.cells(points[near, 0], points[near, 1])
        if len(cells):
            cells = np.unique(cells)
            free = self.table.time[cells].min(axis=0) * STEP
            gap = self.table.gap[cells].min(axis=0) / 100.0
        else:
            free, gap = np.full(len(self.speed), HORIZON), np.full(len(self.speed), self.enough)
        window = (np.abs(self.speed - last[0]) <= self.acceleration * ROBOT.period + 1e-9) & (
            np.abs(self.turn - last[1]) <= self.turn_acceleration * ROBOT.period + 1e-9
        )
        x, y = target
        before = float(np.hypot(x, y))
        ahead = np.minimum(free, HORIZON)
        reached = np.hypot(x - self.end[:, 0], y - self.end[:, 1])
        bearing = np.arctan2(y - self.end[:, 1], x - self.end[:, 0]) - self.end[:, 2]
        turned = np.abs(np.arctan2(np.sin(bearing), np.cos(bearing)))
        # near the target its bearing means nothing
        turned *= np.clip(reached / 0.5, 0, 1)
        score = (before - reached) - 0.35 * turned + self.clearance * np.minimum(gap, self.enough)
        score += 0.15 * self.speed
        safe = ahead >= np.minimum(STOPPING_TIME + 0.8 * self.speed, HORIZON) - 1e-9
        # where it has less room already, no arc may take any more of it
        room = min(self.room, float(gap[self._standing]))
        allowed = safe & window & (self.speed > 0) & (gap >= room)
        if allowed.any():
            best = int(np.argmax(np.where(allowed, score, -np.inf)))
            return float(self.speed[best]), float(self.turn[best])
        return 0.0, self._turn_on_the_spot(gap, y, last)

    def _turn_on_the_spot(self, gap: np.ndarray, y: float, last: tuple[float, float]) -> float:
        """No way ahead is safe: turn, towards the target at first, and then on the same way round."""
        side = np.sign(last[1]) if last[0] == 0 and last[1] != 0 else (1.0 if y >= 0 else -1.0)
        for turn in (0.8 * side, -0.8 * side):
            command = int(np.flatnonzero((self.speed == 0) & (np.abs(self.turn - turn) < 1e-6))[0])
            if gap[command] >= TURNING_GAP:
                return float(turn)
        return 0.0


class LocalDWA:
    """The dynamic window with what the learnt driver has: sectors and remembered points; no map.

    Args:
        sight: "sectors" (the nearest point of each of the five), "columns" (all of them).
        memory: control periods that are remembered; 0: what is in view.
        robots: how many.
    """

    name = "dwa"

    def __init__(self, *, sight: str = "columns", memory: int = 60, robots: int = 1) -> None:
        if sight not in ("sectors", "columns"):
            raise ValueError(f"sight={sight!r}: choose sectors or columns")
        self.sight = sight
        self.window = DynamicWindow()
        self.observer = Observer(robots, memory=memory, bins=1, arcs=False)
        self.last = np.zeros((robots, 2))

    def reset(self, robot: int | slice = slice(None), world: Any = None) -> None:
        """Forget what a robot saw."""
        self.observer.reset(robot)
        self.last[robot] = 0.0

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        who = np.arange(len(self.last)) if robots is None else robots
        if self.sight == "sectors":  # all but the nearest column of each sector see nothing
            parts = senses.ranges.reshape(len(senses.ranges), SECTORS, -1)
            nearest = parts.argmin(axis=2)[..., None]
            kept = np.full_like(parts, ROBOT.far)
            np.put_along_axis(kept, nearest, np.take_along_axis(parts, nearest, axis=2), axis=2)
            senses = senses._replace(ranges=kept.reshape(senses.ranges.shape))
        self.observer.observe(senses, who)
        row, x, y, _ = self.observer.memory.near(senses.odometry[who], who)
        for number, robot in enumerate(who):
            distance, bearing = senses.goal[robot]
            mine = row == number
            points = np.stack([x[mine], y[mine]], axis=1)
            step = min(float(distance), 2.0)
            target = (step * float(np.cos(bearing)), step * float(np.sin(bearing)))
            self.last[robot] = self.window.choose(points, target, tuple(self.last[robot]))
        return self.last.copy()

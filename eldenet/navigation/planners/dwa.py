"""The dynamic window approach: the best collision-free arc among those that can be driven next.

Fox, Burgard, Thrun, "The dynamic window approach to collision avoidance", IEEE RAM 1997. The arcs' collision
times and clearances come from one table (:mod:`eldenet.navigation.collision_arcs`).
"""

from typing import Any

import numpy as np

from eldenet.navigation.collision_arcs import REACH, STEP, arc_table
from eldenet.navigation.observer import SECTORS, Observer, Senses
from eldenet.navigation.safety_margins import TURNING_GAP, WINDOW_MARGIN, WINDOW_ROOM
from eldenet.simulation.robot import ROBOT, front
from eldenet.system.checks import one_of

SPEEDS = tuple(round(0.1 * step, 1) for step in range(11))  # [m/s]
TURNS = tuple(round(-1.2 + 0.2 * step, 1) for step in range(13))  # [rad/s]
COMMANDS = tuple((speed, turn) for speed in SPEEDS for turn in TURNS)
HORIZON = 1.6  # [s]
STOPPING_TIME, PER_SPEED = 0.6, 0.8  # for which an arc must be free [s], and more of it per speed [s2/m]
CLEARANCE = 0.8  # weight of the clearance, relative to progress toward the target
ENOUGH = 0.30  # clearance above which more adds no score [m]
TURNED, SPEED = 0.35, 0.15  # weights of the target's bearing at the arc's end [m/rad] and of the speed [s]
CLOSE = 0.5  # distance to the target within which its bearing counts less [m]
SPOT_TURN = 0.8  # rate of a turn on the spot [rad/s]
ACCELERATION, TURN_ACCELERATION = 2.5, 6.0  # bounds of the window [m/s2], [rad/s2]
#: Of what the window chooses; stored episodes of planners name it. 1 braked harder than the window allows.
DWA_VERSION = 2


class DynamicWindow:
    """Chooses a command toward a target among obstacle points, for one robot.

    Args:
        slack: room that an arc may lose where the robot has little [m]: an arc away from a wall first
            brings the rear nearer to it.
    """

    def __init__(self, slack: float = 0.0) -> None:
        self.slack = slack
        self.table = arc_table(COMMANDS, HORIZON, WINDOW_MARGIN)
        speed, turn = self.table.commands.T
        self.speed, self.turn = speed, turn
        self._standing = int(np.flatnonzero((speed == 0) & (turn == 0))[0])
        half = turn * HORIZON / 2
        chord = speed * HORIZON * np.sinc(half / np.pi)
        self.end = np.stack([chord * np.cos(half), chord * np.sin(half), 2 * half], axis=1)

    def choose(
        self,
        points: np.ndarray,
        target: tuple[float, float],
        last: tuple[float, float],
        unseen: np.ndarray | None = None,
    ) -> tuple[float, float]:
        """Return speed [m/s] and turn rate [rad/s], both within the dynamic window around ``last``.

        Args:
            points: ``(M, 2)`` obstacle points in the robot's frame [m].
            target: x ahead, y left [m].
            last: the current command.
            unseen: ``(M, 2)`` points that nobody has seen [m]: arcs end there too, but need no room beside.
        """
        near = (np.abs(points) < REACH).all(axis=1)
        cells = self.table.cells(points[near, 0], points[near, 1])
        if len(cells):
            cells = np.unique(cells)
            free = self.table.time[cells].min(axis=0) * STEP
            gap = self.table.gap[cells].min(axis=0) / 100.0
        else:
            free, gap = np.full(len(self.speed), HORIZON), np.full(len(self.speed), ENOUGH)
        if unseen is not None and (near := (np.abs(unseen) < REACH).all(axis=1)).any():
            cells = np.unique(self.table.cells(unseen[near, 0], unseen[near, 1]))
            free = np.minimum(free, self.table.time[cells].min(axis=0) * STEP)
        window = (np.abs(self.speed - last[0]) <= ACCELERATION * ROBOT.period + 1e-9) & (
            np.abs(self.turn - last[1]) <= TURN_ACCELERATION * ROBOT.period + 1e-9
        )
        x, y = target
        before = float(np.hypot(x, y))
        reached = np.hypot(x - self.end[:, 0], y - self.end[:, 1])
        bearing = np.arctan2(y - self.end[:, 1], x - self.end[:, 0]) - self.end[:, 2]
        turned = np.abs(np.arctan2(np.sin(bearing), np.cos(bearing)))
        # at the target its bearing is meaningless
        turned *= np.clip(reached / CLOSE, 0, 1)
        score = (before - reached) - TURNED * turned + CLEARANCE * np.minimum(gap, ENOUGH)
        score += SPEED * self.speed
        safe = free >= np.minimum(STOPPING_TIME + PER_SPEED * self.speed, HORIZON) - 1e-9
        # with less room already, no arc may reduce it by more than the slack
        room = min(WINDOW_ROOM, max(float(gap[self._standing]) - self.slack, min(self.slack, 0.01)))
        allowed = safe & window & (self.speed > 0) & (gap >= room)
        if allowed.any():
            best = int(np.argmax(np.where(allowed, score, -np.inf)))
            return float(self.speed[best]), float(self.turn[best])
        # no safe arc: brake as hard as the window allows, and turn
        turn = self._turn_on_the_spot(gap, y, last)
        return _within(0.0, last[0], ACCELERATION), _within(turn, last[1], TURN_ACCELERATION)

    def _turn_on_the_spot(self, gap: np.ndarray, y: float, last: tuple[float, float]) -> float:
        """Rate of a turn on the spot [rad/s], to the side of the last or else of the target; 0 without room.

        ``gap (K,)`` [m] is the clearance of the commands, ``y`` [m] how far left the target is.
        """
        side = np.sign(last[1]) if last[0] == 0 and last[1] != 0 else (1.0 if y >= 0 else -1.0)
        for turn in (SPOT_TURN * side, -SPOT_TURN * side):
            command = int(np.flatnonzero((self.speed == 0) & (np.abs(self.turn - turn) < 1e-6))[0])
            if gap[command] >= TURNING_GAP:
                return float(turn)
        return 0.0


def _within(wanted: float, last: float, acceleration: float) -> float:
    """Return the value next to ``wanted`` that is reached within one control period."""
    change = acceleration * ROBOT.period
    return float(np.clip(wanted, last - change, last + change))


class LocalDWA:
    """The dynamic window with the inputs of the learned driver: ranges and remembered points, no map.

    Args:
        sight: "columns", or "sectors" for the nearest point of each of the five only.
        memory: control periods to remember; 0: the current view only.
        carrot: distance to the target on the straight line to the goal [m].
        robots: number of robots.
    """

    name = "dwa"

    def __init__(
        self, *, sight: str = "columns", memory: int = 60, carrot: float = 6.0, robots: int = 1
    ) -> None:
        one_of("sight", sight, ("sectors", "columns"))
        self.sight = sight
        self.carrot = carrot
        self.window = DynamicWindow()
        self.observer = Observer(robots, memory=memory, bins=0, arcs=False)
        self.last = np.zeros((robots, 2))

    def reset(self, robot: int | slice = slice(None), world: Any = None) -> None:
        """Forget what a robot saw."""
        self.observer.reset(robot)
        self.last[robot] = 0.0

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        who = np.arange(len(self.last)) if robots is None else robots
        if self.sight == "sectors":  # only the nearest column of each sector is kept
            parts = front(senses.ranges).reshape(len(senses.ranges), SECTORS, -1)
            nearest = parts.argmin(axis=2)[..., None]
            kept = np.full_like(parts, ROBOT.far)
            np.put_along_axis(kept, nearest, np.take_along_axis(parts, nearest, axis=2), axis=2)
            cautious = None if senses.cautious is None else front(senses.cautious)
            senses = senses._replace(ranges=kept.reshape(len(kept), -1), cautious=cautious)
        self.observer.observe(senses, who)
        row, x, y, _ = self.observer.memory.near(senses.odometry[who], who)
        for number, robot in enumerate(who):
            distance, bearing = senses.goal[robot]
            mine = row == number
            points = np.stack([x[mine], y[mine]], axis=1)
            step = min(float(distance), self.carrot)
            target = (step * float(np.cos(bearing)), step * float(np.sin(bearing)))
            self.last[robot] = self.window.choose(points, target, tuple(self.last[robot]))
        return self.last.copy()

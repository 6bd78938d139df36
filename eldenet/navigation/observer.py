"""Observations of a learned driver: five camera sectors, the goal, its last command, remembered obstacles.

Works on ``N`` robots at once; needs NumPy only, no simulator. The observation is ``(N, size)`` float32:

======================  ==============================================  =======================
columns                 meaning                                         range
======================  ==============================================  =======================
0-4                     nearest range per sector, right to left         sqrt(r / 10), 0.17 to 1
5                       goal distance                                   min(d / 20, 1)
6, 7                    sine and cosine of the goal's bearing           -1 to 1
8                       last turn rate, relative to the greatest        -1 to 1
9                       last speed, relative to the greatest            -1 to 1
next ``bins``           memory: least distance to a remembered point    min(d, 3) / 3
next, one per action    free time along the action's arc                t / 1.8 s, 0 to 1
======================  ==============================================  =======================
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eldenet.navigation.collision_arcs import REACH, STEP, arc_table
from eldenet.navigation.obstacle_memory import MEMORY_REACH, Memory
from eldenet.simulation.robot import ROBOT, front
from eldenet.system.checks import one_of

SECTORS = 5
HORIZON = 1.8  # duration of the arcs [s]
SPEED_LAWS = ("paper", "turn", "prox")
SLOWS_WITHIN, SLOWEST = 3.0, 0.25  # distance to the goal [m] within which speed falls, to this share of it
OBSTACLE_SLOWS_WITHIN, OBSTACLE_SLOWEST = 1.2, 0.15  # "prox": the same for an obstacle beyond ROBOT.near
_LEVELS = 20  # of speed in the table of arcs, per m/s


class Senses(NamedTuple):
    """What ``N`` robots sense at one time.

    Attributes:
        ranges: ``(N, columns)`` [m] from the camera, right to left: those of
            :data:`~eldenet.simulation.robot.ROBOT`, or a lidar's all round
            (:data:`~eldenet.simulation.robot.ALL_ROUND`).
        odometry: ``(N, 3)`` x, y [m], heading [rad] of the wheels, which drift.
        goal: ``(N, 2)`` distance [m] and bearing [rad, counter-clockwise from ahead] of the next way-point.
        cautious: ``(N, columns)`` [m] how near things may be, where a camera's network predicts its sigma; 0
            in columns that the camera does not see, whose ``ranges`` are the greatest; None: as ``ranges``.
        scanned_from: ``(N, 3)`` pose of the wheels at the scan, where ``odometry`` is that of a later time;
            None: the same.
    """

    ranges: np.ndarray
    odometry: np.ndarray
    goal: np.ndarray
    cautious: np.ndarray | None = None
    scanned_from: np.ndarray | None = None

    def of(self, robots: np.ndarray) -> "Senses":
        """The senses of some robots, whose numbers are ``(K,)``."""
        return Senses(*(None if values is None else values[robots] for values in self))  # type: ignore[arg-type]

    def scan(self, robot: int) -> tuple[np.ndarray, np.ndarray | None]:
        """``ranges`` and ``cautious`` of one robot ``(columns,)`` [m]."""
        return self.ranges[robot], None if self.cautious is None else self.cautious[robot]

    @property
    def not_finite(self) -> str | None:
        """Which of them are not finite, None if all are finite; do not steer by such senses."""
        known = {name: values for name, values in self._asdict().items() if values is not None}
        wrong = [name for name, values in known.items() if not np.isfinite(values).all()]
        return f"{' and '.join(wrong)} not finite" if wrong else None


class Observer:
    """Turns senses into observations and action numbers into commands.

    Args:
        turn_rates: of the actions [rad/s].
        turn_factors: relative speed of each action; 0 turns on the spot, below 0 backs up. Unused by
            speed="paper".
        speed: speed law. "paper": falls with the goal's distance, as in the paper's prose (by our choice
            within :data:`SLOWS_WITHIN`, to :data:`SLOWEST`), the same for all actions; "turn": times the
            action's factor; "prox": also slower near obstacles.
        memory: control periods to remember, of which every second scan is kept; 0: the last scan only.
        bins: bearings that the memory is divided into; 0: no memory columns.
        arcs: add the free time along each action's arc.
        seen_through: scans that must see through a remembered point before it is forgotten; 0: they do not
            matter.
        walkers: track pedestrians: forget where they were, remember where they will be.

    Raises:
        ValueError: an unknown speed law, or not one factor per turn rate.
    """

    def __init__(
        self,
        robots: int = 1,
        *,
        turn_rates: Sequence[float] = (1.2, 0.5, 0.0, -0.5, -1.2),
        turn_factors: Sequence[float] = (0.35, 0.75, 1.0, 0.75, 0.35),
        speed: str = "prox",
        memory: int = 60,
        bins: int = 24,
        arcs: bool = True,
        seen_through: int = 2,
        walkers: bool = False,
    ) -> None:
        one_of("speed", speed, SPEED_LAWS)
        if len(turn_rates) != len(turn_factors) or not turn_rates:
            raise ValueError(
                f"{len(turn_rates)} turn_rates and {len(turn_factors)} turn_factors: give one each"
            )
        self.robots, self.speed, self.bins, self.arcs = robots, speed, bins, arcs
        self.options = {
            "turn_rates": [float(rate) for rate in turn_rates],
            "turn_factors": [float(factor) for factor in turn_factors],
            "speed": speed,
            "memory": memory,
            "bins": bins,
            "arcs": arcs,
            "seen_through": seen_through,
            "walkers": walkers,
        }
        self.turn_rates = np.array(turn_rates, dtype=np.float64)
        self.turn_factors = np.array(turn_factors, dtype=np.float64)
        self.actions = len(self.turn_rates)
        self.size = 10 + bins + (self.actions if arcs else 0)
        self.memory = Memory(robots, memory, seen_through=seen_through, walkers=walkers)
        self.last = np.zeros((robots, 2))  # last command: speed [m/s], turn rate [rad/s]
        self.speeds = np.zeros((robots, self.actions))

    def reset(self, robot: int | slice = slice(None)) -> None:
        """Forget what one robot (or all) saw and did."""
        self.memory.reset(robot)
        self.last[robot] = 0.0

    def commands(self, actions: np.ndarray) -> np.ndarray:
        """Return speed [m/s] and turn rate [rad/s] ``(N, 2)`` of actions chosen for the last observation.

        They are stored as :attr:`last`; a caller that drives otherwise writes its own commands there.
        """
        self.last = np.stack([self.speeds[np.arange(self.robots), actions], self.turn_rates[actions]], axis=1)
        return self.last

    def observe(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Remember a scan and return observations ``(N, size)`` float32.

        Args:
            robots: numbers of the robots to observe; None: all.

        Raises:
            ValueError: a sense of these robots is not finite; nothing was remembered.
        """
        who = np.arange(self.robots) if robots is None else robots
        ranges, odometry, goal, cautious, scanned_from = seen = senses.of(who)
        if seen.not_finite:
            raise ValueError(f"{seen.not_finite}: stop the robot until they are")
        distance, bearing = goal.T
        nearest = np.maximum(front(ranges), ROBOT.near).reshape(len(who), SECTORS, -1).min(axis=2)
        cautious = ranges if cautious is None else np.minimum(cautious, ranges)
        least = front(np.where(cautious > 0, cautious, ranges)).min(axis=1)
        if scanned_from is None:
            scanned_from = odometry
        else:  # by then things may be nearer
            least = least - np.hypot(*(odometry - scanned_from)[:, :2].T)
        self.speeds[who] = self._speeds(distance, least)
        self.memory.add(who, ranges, scanned_from, cautious)
        columns = [
            np.sqrt(nearest / ROBOT.far),
            np.minimum(distance / 20.0, 1.0)[:, None],
            np.stack([np.sin(bearing), np.cos(bearing)], axis=1),
            self.last[who, 1:] / ROBOT.max_turn,
            self.last[who, :1] / ROBOT.max_speed,
        ]
        if self.bins or self.arcs:
            row, x, y, away = self.memory.near(odometry, robots)
            if self.bins:
                columns.append(self._by_bearing(len(who), row, x, y, away))
            if self.arcs:
                columns.append(self._free_times(who, row, x, y))
        return np.concatenate(columns, axis=1).astype(np.float32)

    def _speeds(self, distance: np.ndarray, nearest: np.ndarray) -> np.ndarray:
        """Speed of each action ``(N, actions)`` [m/s], by the distance to goal and obstacle ``(N,)`` [m]."""
        speed = speed_by_distance(distance)[:, None] * np.ones(self.actions)
        if self.speed != "paper":
            speed = speed * self.turn_factors
        if self.speed == "prox":
            share = np.clip((nearest - ROBOT.near) / OBSTACLE_SLOWS_WITHIN, OBSTACLE_SLOWEST, 1.0)
            speed = speed * share[:, None]
        return speed

    def _by_bearing(
        self, count: int, row: np.ndarray, x: np.ndarray, y: np.ndarray, away: np.ndarray
    ) -> np.ndarray:
        """Least distance per bearing, relative to 3 m ``(count, bins)``; the first bin starts behind."""
        width = np.float32(2 * math.pi / self.bins)
        bearing = np.arctan2(y, x) + np.float32(math.pi)
        bins = np.minimum((bearing / width).astype(np.intp), self.bins - 1)
        out = np.full(count * self.bins, MEMORY_REACH, np.float32)
        np.minimum.at(out, row * self.bins + bins, away)
        return out.reshape(count, self.bins) / np.float32(MEMORY_REACH)

    def _free_times(self, who: np.ndarray, row: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Free time along each action's arc, relative to the horizon ``(len(who), actions)``."""
        speeds = [level / _LEVELS for level in range(-_LEVELS, _LEVELS + 1)]
        commands = tuple((speed, rate) for speed in speeds for rate in self.turn_rates.tolist())
        table = arc_table(commands, HORIZON)
        inside = (np.abs(x) < REACH) & (np.abs(y) < REACH)
        row, cells = row[inside], table.cells(x[inside], y[inside])
        level = np.clip(np.rint(self.speeds[who] * _LEVELS), -_LEVELS, _LEVELS).astype(np.intp) + _LEVELS
        command = level * self.actions + np.arange(self.actions)
        out = np.full((len(who), self.actions), table.count, np.uint8)
        if len(row):
            first = np.flatnonzero(np.diff(row, prepend=-1))
            cells = cells * table.time.shape[1]
            for action in range(self.actions):
                times = table.time.ravel().take(cells + command[:, action].take(row))
                out[row[first], action] = np.minimum.reduceat(times, first)
        return out * np.float32(STEP / HORIZON)


def speed_by_distance(distance: np.ndarray) -> np.ndarray:
    """Greatest speed ``(N,)`` [m/s] at distances ``(N,)`` [m] to the goal."""
    return np.asarray(ROBOT.max_speed * np.clip(distance / SLOWS_WITHIN, SLOWEST, 1.0))

"""Drive with a delay: predict where the robot will be when its next command takes effect."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.navigation.observer import Senses
from eldenet.simulation.robot import ROBOT, arc

if TYPE_CHECKING:
    from eldenet.navigation.evaluation import Policy

MAX_LATENCY = 1.0  # [s]


def check_latency(latency: float) -> None:
    """Raise ``ValueError`` for a latency [s] out of range."""
    if not 0 <= latency <= MAX_LATENCY:
        hint = milliseconds_hint(latency)
        raise ValueError(f"latency={latency}: give seconds from 0 to {MAX_LATENCY:g}{hint}")


def milliseconds_hint(latency: float) -> str:
    """What a message adds where a latency [s] out of range looks like milliseconds."""
    fits = 5 * MAX_LATENCY <= latency <= 1000 * MAX_LATENCY
    return f"; {latency:g} looks like milliseconds: give {latency / 1000:g}" * fits


class Predictive:
    """A driver that decides for the pose at which its command will take effect.

    It knows the latency and its own last commands, which are still to be driven, and adds them to the
    odometry (dead reckoning). Obstacles are remembered from where they were seen; the speed laws take the way
    driven until then off the nearest range.

    Args:
        driver: one that heeds ``Senses.scanned_from``, as all here do but ``Straight``, which sees nothing.
        latency: from a scan until its command takes effect [s].
        robots: number of robots.
    """

    def __init__(self, driver: "Policy", latency: float, robots: int = 1) -> None:
        self.driver, self.latency = driver, latency
        self.name = driver.name
        self.navigator = getattr(driver, "navigator", driver)  # whose files are named beside the results
        self._sent: list[list[tuple[float, float]]] = [[] for _ in range(robots)]

    def reset(self, robot: int, world: Any = None) -> None:
        """Start an episode."""
        self._sent[robot] = []
        self.driver.reset(robot, world)

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        who = np.arange(len(self._sent)) if robots is None else robots
        odometry, goal = senses.odometry.copy(), senses.goal.copy()
        for robot in who:
            odometry[robot], goal[robot] = ahead(
                senses.odometry[robot], senses.goal[robot], self._sent[robot], self.latency
            )
        seen = senses._replace(odometry=odometry, goal=goal, scanned_from=senses.odometry)
        out = self.driver.commands(seen, robots)
        for robot in who:
            self._sent[robot].append((float(out[robot, 0]), float(out[robot, 1])))
        return out


def ahead(
    pose: np.ndarray, goal: np.ndarray, sent: Sequence[tuple[float, float]], latency: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return pose ``(3,)`` and goal ``(2,)`` once all commands that were sent have been driven.

    Args:
        pose: x, y [m], heading [rad] now.
        goal: distance [m] and bearing [rad] now.
        sent: all commands so far, the last one period ago.
        latency: [s].
    """
    count = math.ceil(latency / ROBOT.period - 1e-9)
    x, y, yaw = pose.tolist()
    at = (x + goal[0] * math.cos(yaw + goal[1]), y + goal[0] * math.sin(yaw + goal[1]))
    for number in range(count, 0, -1):
        # the oldest one has been driven for a part of its period already
        seconds = latency - (count - 1) * ROBOT.period if number == count else ROBOT.period
        speed, turn = sent[-number] if number <= len(sent) else (0.0, 0.0)
        x, y, yaw = arc(x, y, yaw, speed, turn, seconds)
    bearing = math.remainder(math.atan2(at[1] - y, at[0] - x) - yaw, 2 * math.pi)
    return np.array([x, y, yaw]), np.array([math.hypot(at[0] - x, at[1] - y), bearing])

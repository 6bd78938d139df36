"""Drive straight to the goal without looking: the baseline for every driver."""

from typing import Any

import numpy as np

from eldenet.navigation.observer import Senses, speed_by_distance
from eldenet.simulation.robot import ROBOT


class Straight:
    """Turns to the goal and drives there, more slowly while turning and near the goal."""

    name = "straight"

    def __init__(self, *, robots: int = 1) -> None:
        self.robots = robots

    def reset(self, robot: int | slice = slice(None), world: Any = None) -> None:
        """Do nothing: there is no memory."""

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        distance, bearing = senses.goal.T
        turn = np.clip(bearing / ROBOT.period / 2, -ROBOT.max_turn, ROBOT.max_turn)
        speed = speed_by_distance(distance) * np.clip(np.cos(bearing), 0.05, 1.0)
        return np.stack([speed, turn], axis=1)

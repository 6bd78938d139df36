"""Transitions that a learner learns from: the replay memory, and the windows that fill it."""

from typing import Any

import numpy as np
import torch
from torch import Tensor


class Replay:
    """The last ``capacity`` transitions; observations as float16, which keeps three digits of [-1, 1]."""

    def __init__(self, capacity: int, inputs: int) -> None:
        self.capacity, self.added = capacity, 0
        self.obs = torch.zeros(capacity, inputs, dtype=torch.float16)
        self.next_obs = torch.zeros(capacity, inputs, dtype=torch.float16)
        self.action = torch.zeros(capacity, dtype=torch.int64)
        self.value = torch.zeros(capacity)  # discounted sum of the rewards on the way
        self.discount = torch.zeros(capacity)  # of what comes after; 0 where the episode has ended

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(self, obs: Any, action: Any, value: Any, next_obs: Any, discount: Any) -> None:
        """Write a batch of transitions over the oldest ones."""
        rows = torch.arange(self.added, self.added + len(action)) % self.capacity
        self.obs[rows] = torch.from_numpy(obs).half()
        self.next_obs[rows] = torch.from_numpy(next_obs).half()
        self.action[rows] = torch.from_numpy(action)
        self.value[rows] = torch.from_numpy(value).float()
        self.discount[rows] = torch.from_numpy(discount).float()
        self.added += len(action)

    def sample(self, rng: np.random.Generator, count: int) -> tuple[Tensor, ...]:
        """Transitions drawn evenly, with replacement."""
        rows = torch.from_numpy(rng.integers(0, len(self), count))
        columns = (self.obs, self.action, self.value, self.next_obs, self.discount)
        return tuple(
            column[rows].float() if column.is_floating_point() else column[rows] for column in columns
        )

    def state_dict(self) -> dict[str, Any]:
        """What has been written so far."""
        names = ("obs", "next_obs", "action", "value", "discount")
        return {"added": self.added} | {name: getattr(self, name)[: len(self)].clone() for name in names}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over what :meth:`state_dict` wrote."""
        self.added = state.pop("added")
        for name, rows in state.items():
            getattr(self, name)[: len(rows)] = rows


class Windows:
    """The last ``n`` steps of every robot, made n-step transitions that never cross an episode's end."""

    def __init__(self, n: int, robots: int, gamma: float, replay: Replay) -> None:
        self.n, self.gamma, self.replay = n, gamma, replay
        self.steps: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []  # oldest first
        self.length = np.zeros(robots, np.intp)  # steps of the running episode that are in the window

    def push(
        self,
        obs: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        next_obs: np.ndarray,
        terminated: np.ndarray,
        ended: np.ndarray,
    ) -> None:
        """Add a step; ``next_obs`` is the episode's own last observation where it ended."""
        self.steps = (
            [*self.steps[-self.n + 1 :], (obs, action, reward)] if self.n > 1 else [(obs, action, reward)]
        )
        self.length = np.minimum(self.length + 1, self.n)
        value = np.zeros(len(action))
        for back in range(1, len(self.steps) + 1):  # windows that begin `back` steps ago
            first_obs, first_action, first_reward = self.steps[-back]
            value = first_reward + self.gamma * value
            # a window is complete when it is n long; an end completes the shorter ones
            whole = (self.length >= back) & (ended | (back == self.n))
            if whole.any():
                discount = self.gamma**back * ~terminated[whole]
                self.replay.add(
                    first_obs[whole], first_action[whole], value[whole], next_obs[whole], discount
                )
        self.length[ended] = 0

"""Deep Q-learning; with the right settings the paper's Algorithm 2 as we read its prose.

``policy_dqn`` acts and learns; ``target_dqn`` gives the targets. With ``n_step=1``, ``double=False`` and
``target_update_interval`` above 0 this is that algorithm: replay buffer, mean squared error, Adam, hard
copies into the target network. The default uses five-step returns, double targets and soft updates: with
one-step targets the driver hardly learned at five decisions per second.
"""

import copy
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eldenet.backbones.weights import read_torch
from eldenet.navigation.qnetwork import QNetwork
from eldenet.system.errors import reading
from eldenet.training.checkpoint import save_checkpoint

CHECKPOINT = "dqn.pt"
REPORT_EVERY = 5_000  # environment steps


@dataclass(frozen=True)
class DQNSettings:
    """Hyperparameters, named as in Stable-Baselines3 where it has them.

    Attributes:
        total_timesteps: environment steps of all robots together.
        n_step: rewards added up before the target network's value.
        double: let ``policy_dqn`` choose the action that ``target_dqn`` values.
        tau: share of ``policy_dqn`` that is mixed into ``target_dqn`` after each gradient step.
        target_update_interval: gradient steps (in Stable-Baselines3 environment steps) between hard copies
            instead; 0: soft updates with ``tau``.
        gamma: discount per step.
        learning_rate: of Adam at the start.
        learning_rate_end: final learning rate, relative to the first; it falls linearly. 1: constant.
        batch_size: transitions per gradient step.
        buffer_size: transitions in the replay buffer.
        learning_starts: environment steps before the first gradient step.
        train_freq: environment steps of all robots together (in Stable-Baselines3 of each one) per gradient
            step.
        exploration_fraction: part of the training in which the rate of random actions falls from 1 to
            ``exploration_final_eps``.
        exploration_final_eps: rate of random actions after that.
        max_grad_norm: gradient norm to clip at; 0: no clipping.
        hidden: widths of the network's layers.
        checkpoint_interval: environment steps between checkpoints.
        seed: of everything.

    Raises:
        ValueError: a setting is out of range.
    """

    total_timesteps: int = 600_000
    n_step: int = 5
    double: bool = True
    tau: float = 0.005
    target_update_interval: int = 0
    gamma: float = 0.98
    learning_rate: float = 5e-4
    learning_rate_end: float = 0.1
    batch_size: int = 256
    buffer_size: int = 400_000
    learning_starts: int = 5_000
    train_freq: int = 8
    exploration_fraction: float = 0.3
    exploration_final_eps: float = 0.03
    max_grad_norm: float = 10.0
    hidden: tuple[int, ...] = (128, 128)
    checkpoint_interval: int = 100_000
    seed: int = 0

    def __post_init__(self) -> None:
        counts = ("n_step", "batch_size", "buffer_size", "train_freq", "checkpoint_interval")
        shares = ("tau", "learning_rate_end", "exploration_final_eps")
        may_be_0 = ("learning_starts", "target_update_interval", "max_grad_norm")
        for names, fits, advice in (
            (("total_timesteps", *counts), lambda value: value >= 1, "1 or more"),
            ((*may_be_0, "exploration_fraction"), lambda value: value >= 0, "0 or more"),
            (shares, lambda value: 0 <= value <= 1, "from 0 to 1"),
            (("gamma",), lambda value: 0 < value < 1, "a number between 0 and 1"),
            (("learning_rate",), lambda value: 0 < value < math.inf, "a finite number above 0"),
        ):
            for name in names:
                if not fits(getattr(self, name)):
                    raise ValueError(f"learner.{name}={getattr(self, name)}: give {advice}")
        if self.learning_starts >= self.total_timesteps:
            raise ValueError(
                f"learner.learning_starts={self.learning_starts}: nothing is learned within "
                f"learner.total_timesteps={self.total_timesteps}; give less"
            )


class DQN:
    """Trains a :class:`~eldenet.navigation.qnetwork.QNetwork` on a vector environment.

    After each checkpoint all episodes restart with their own random numbers, so a resumed training is
    bit for bit the same as an uninterrupted one.

    Args:
        env: :class:`~eldenet.navigation.env.ArenaNavVectorEnv`, or any with the same autoreset mode.
    """

    def __init__(self, env: Any, settings: DQNSettings = DQNSettings()) -> None:
        self.env, self.settings = env, settings
        inputs, actions = env.single_observation_space.shape[0], int(env.single_action_space.n)
        torch.manual_seed(settings.seed)
        self.policy_dqn = QNetwork(inputs, actions, tuple(settings.hidden))
        self.target_dqn = copy.deepcopy(self.policy_dqn)
        self.optimizer = torch.optim.Adam(self.policy_dqn.parameters(), lr=settings.learning_rate, fused=True)
        self.replay = ReplayBuffer(settings.buffer_size, inputs)
        self.num_timesteps = 0  # environment steps so far
        self.updates = 0  # gradient steps so far

    @property
    def finished(self) -> bool:
        """Whether all environment steps are done."""
        return self.num_timesteps >= self.settings.total_timesteps

    def learn(
        self,
        *,
        folder: Path | None = None,
        report: Callable[[int, dict[str, float]], None] = lambda step, values: None,
        at_checkpoint: Callable[["DQN"], None] = lambda dqn: None,
    ) -> None:
        """Train to the end, from :attr:`num_timesteps` on.

        Args:
            folder: of the checkpoint; None: none is written.
            report: called about every :data:`REPORT_EVERY` steps with the number of steps so far and the rate
                of each outcome, loss and value since the last report.
            at_checkpoint: called before each checkpoint is written.
        """
        while not self.finished:
            self._train_to_checkpoint(report)
            at_checkpoint(self)
            if folder is not None:
                self.save(folder / CHECKPOINT)

    def _train_to_checkpoint(self, report: Callable[[int, dict[str, float]], None]) -> None:
        env, robots, settings = self.env, self.env.num_envs, self.settings
        number = self.num_timesteps // settings.checkpoint_interval
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence((settings.seed, number))))
        windows = NStepWindows(settings.n_step, robots, settings.gamma, self.replay)
        obs, _ = env.reset(seed=int(rng.integers(2**31)))
        end = min(settings.total_timesteps, (number + 1) * settings.checkpoint_interval)
        ends, losses, values = np.zeros(4), [], []
        next_report = self.num_timesteps + REPORT_EVERY
        while self.num_timesteps < end:
            action = self.act(obs, rng)
            next_obs, reward, terminated, truncated, info = env.step(action)
            ended = terminated | truncated
            last_obs = np.where(ended[:, None], info["final_obs"], next_obs) if ended.any() else next_obs
            windows.push(obs, action, reward, last_obs, terminated, ended)
            ends += np.bincount(info["event"][ended], minlength=4)
            obs = next_obs
            before, self.num_timesteps = self.num_timesteps, self.num_timesteps + robots
            if self.num_timesteps >= settings.learning_starts and len(self.replay):
                for _ in range(self.num_timesteps // settings.train_freq - before // settings.train_freq):
                    loss, value = self.update(rng)
                    losses.append(loss)
                    values.append(value)
            if self.num_timesteps >= next_report and losses:
                total = max(ends.sum(), 1)
                rates = dict(zip(("success", "collision", "timeout"), ends[1:] / total, strict=True))
                means = {"loss": float(np.mean(losses)), "value": float(np.mean(values))}
                report(self.num_timesteps, rates | means)
                ends, losses, values, next_report = np.zeros(4), [], [], self.num_timesteps + REPORT_EVERY

    @property
    def epsilon(self) -> float:
        """Current rate of random actions."""
        final, exploration = self.settings.exploration_final_eps, self.settings.exploration_fraction
        steps = max(exploration * self.settings.total_timesteps, 1)
        return max(final, 1 - (1 - final) * self.num_timesteps / steps)

    @torch.inference_mode()
    def act(self, obs: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Epsilon-greedy actions ``(N,)``."""
        greedy: np.ndarray = self.policy_dqn(torch.from_numpy(obs)).argmax(1).numpy()
        random = rng.integers(0, self.policy_dqn.actions, len(obs))
        return np.where(rng.random(len(obs)) < self.epsilon, random, greedy)

    def update(self, rng: np.random.Generator) -> tuple[float, float]:
        """Take one gradient step; return the loss and the mean value."""
        settings = self.settings
        loss, value = self.loss(*self.replay.sample(rng, settings.batch_size))
        done = min(1.0, self.num_timesteps / settings.total_timesteps)
        for group in self.optimizer.param_groups:
            group["lr"] = settings.learning_rate * (1 - (1 - settings.learning_rate_end) * done)
        self.optimizer.zero_grad()
        loss.backward()
        if settings.max_grad_norm:
            nn.utils.clip_grad_norm_(self.policy_dqn.parameters(), settings.max_grad_norm)
        self.optimizer.step()
        self.updates += 1
        if settings.target_update_interval == 0:
            target: list[Tensor] = list(self.target_dqn.parameters())
            policy: list[Tensor] = list(self.policy_dqn.parameters())
            with torch.no_grad():
                torch._foreach_lerp_(target, policy, settings.tau)
        elif self.updates % settings.target_update_interval == 0:
            self.target_dqn.load_state_dict(self.policy_dqn.state_dict())
        return float(loss.detach()), value

    def loss(
        self, obs: Tensor, action: Tensor, value: Tensor, next_obs: Tensor, discount: Tensor
    ) -> tuple[Tensor, float]:
        """Mean squared error of the taken actions of ``B`` transitions, and their mean value.

        ``obs`` and ``next_obs`` are ``(B, inputs)``, the others ``(B,)``.
        """
        rows = torch.arange(len(obs))
        with torch.no_grad():
            chooser = self.policy_dqn if self.settings.double else self.target_dqn
            target = value + discount * self.target_dqn(next_obs)[rows, chooser(next_obs).argmax(1)]
        q = self.policy_dqn(obs)[rows, action]
        return nn.functional.mse_loss(q, target), float(q.detach().mean())

    def save(self, path: Path) -> None:
        """Write a checkpoint; a kill during the write leaves the previous one whole."""
        state = {
            "policy_dqn": self.policy_dqn.state_dict(),
            "target_dqn": self.target_dqn.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "replay": self.replay.state_dict(),
            "num_timesteps": self.num_timesteps,
            "updates": self.updates,
        }
        save_checkpoint(path, state)

    def restore(self, path: Path) -> None:
        """Load a checkpoint.

        Raises:
            ValueError: it is damaged, or belongs to another training.
        """
        state = read_torch(path)
        with reading(path, "checkpoint of this training", "remove it and train again"):
            self.policy_dqn.load_state_dict(state["policy_dqn"])
            self.target_dqn.load_state_dict(state["target_dqn"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.replay.load_state_dict(state["replay"])
            self.num_timesteps, self.updates = state["num_timesteps"], state["updates"]


class ReplayBuffer:
    """The last ``capacity`` transitions, with observations as float16 (three digits in [-1, 1])."""

    def __init__(self, capacity: int, inputs: int) -> None:
        self.capacity, self.added = capacity, 0
        self.obs = torch.zeros(capacity, inputs, dtype=torch.float16)
        self.next_obs = torch.zeros(capacity, inputs, dtype=torch.float16)
        self.action = torch.zeros(capacity, dtype=torch.int64)
        self.value = torch.zeros(capacity)  # discounted sum of the rewards
        self.discount = torch.zeros(capacity)  # of the next value; 0 at the end of an episode

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
        """Return transitions ``(count, ...)`` drawn with replacement, as :meth:`DQN.loss` takes them."""
        rows = torch.from_numpy(rng.integers(0, len(self), count))
        columns = (self.obs, self.action, self.value, self.next_obs, self.discount)
        return tuple(
            column[rows].float() if column.is_floating_point() else column[rows] for column in columns
        )

    def state_dict(self) -> dict[str, Any]:
        """Return all written transitions."""
        names = ("obs", "next_obs", "action", "value", "discount")
        return {"added": self.added} | {name: getattr(self, name)[: len(self)].clone() for name in names}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Load what :meth:`state_dict` returned."""
        self.added = state.pop("added")
        for name, rows in state.items():
            getattr(self, name)[: len(rows)] = rows


class NStepWindows:
    """The last ``n`` steps of every robot, turned into n-step transitions within one episode."""

    def __init__(self, n: int, robots: int, gamma: float, replay: ReplayBuffer) -> None:
        self.n, self.gamma, self.replay = n, gamma, replay
        self.steps: deque[tuple[np.ndarray, np.ndarray, np.ndarray]] = deque(maxlen=n)  # oldest first
        self.length = np.zeros(robots, np.intp)  # steps of the current episode in the window

    def push(
        self,
        obs: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        next_obs: np.ndarray,
        terminated: np.ndarray,
        ended: np.ndarray,
    ) -> None:
        """Add a step of ``N`` robots; where an episode ended, ``next_obs`` is its own last observation.

        ``obs`` and ``next_obs`` are ``(N, inputs)``, the others ``(N,)``.
        """
        self.steps.append((obs, action, reward))
        self.length = np.minimum(self.length + 1, self.n)
        value = np.zeros(len(action))
        for back in range(1, len(self.steps) + 1):  # the window of the last `back` steps
            first_obs, first_action, first_reward = self.steps[-back]
            value = first_reward + self.gamma * value
            # a window is complete after n steps; the end of an episode completes shorter ones
            whole = (self.length >= back) & (ended | (back == self.n))
            if whole.any():
                discount = self.gamma**back * ~terminated[whole]
                self.replay.add(
                    first_obs[whole], first_action[whole], value[whole], next_obs[whole], discount
                )
        self.length[ended] = 0

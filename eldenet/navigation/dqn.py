"""Deep Q-learning for the arena environment, as the paper's Algorithm 2 names it, in one file.

``policy_dqn`` acts and learns; ``target_dqn`` gives the targets. With ``n_step=1``, ``double=False`` and
``target_every`` set, this is Algorithm 2 as written: replay, mean squared error, Adam, and a hard copy into
the target network. The default takes five-step returns, double targets and a soft update: one-step
targets hardly learned at five decisions a second.
"""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eldenet.navigation.qnetwork import QNetwork

CHECKPOINT = "dqn.pt"


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


class DQN:
    """Learns a :class:`~eldenet.navigation.qnetwork.QNetwork` on a vector environment.

    Training goes in legs; each begins all episodes anew, with random numbers of its own, and ends with a
    checkpoint. So a training that is resumed equals, bit for bit, one that never stopped.

    Args:
        env: :class:`~eldenet.navigation.env.ArenaNavVectorEnv`, or any with the same autoreset mode.
        steps: of the environment, all robots together.
        n_step: rewards that a target adds up before it asks the target network.
        double: let ``policy_dqn`` choose the action that ``target_dqn`` values.
        tau: share of ``policy_dqn`` that goes into ``target_dqn`` after every gradient step.
        target_every: gradient steps between hard copies instead; 0: soft updates with ``tau``.
        gamma: discount a step.
        learning_rate: Adam's at the start.
        learning_rate_end: share of it to which it falls linearly; 1: it stays.
        batch_size: transitions in a gradient step.
        replay: transitions that are kept.
        warmup: environment steps before the first gradient step.
        gradient_every: environment steps (all robots) for each gradient step.
        exploration: share of the training in which random actions fall from all to ``exploration_end``.
        exploration_end: share of random actions afterwards.
        gradient_clip: greatest norm of the gradient; 0: any.
        hidden: widths of the network's layers.
        leg: environment steps between checkpoints.
        seed: of everything.

    Raises:
        ValueError: a setting is out of its range.
    """

    def __init__(
        self,
        env: Any,
        *,
        steps: int = 600_000,
        n_step: int = 5,
        double: bool = True,
        tau: float = 0.005,
        target_every: int = 0,
        gamma: float = 0.98,
        learning_rate: float = 5e-4,
        learning_rate_end: float = 0.1,
        batch_size: int = 256,
        replay: int = 400_000,
        warmup: int = 5_000,
        gradient_every: int = 8,
        exploration: float = 0.3,
        exploration_end: float = 0.03,
        gradient_clip: float = 10.0,
        hidden: tuple[int, ...] = (128, 128),
        leg: int = 100_000,
        seed: int = 0,
    ) -> None:
        if (
            min(steps, n_step, batch_size, replay, gradient_every, leg) < 1
            or not 0 < gamma < 1
            or target_every < 0
        ):
            raise ValueError(
                f"steps={steps}, n_step={n_step}, batch_size={batch_size}, replay={replay}, leg={leg}, "
                f"gradient_every={gradient_every}, gamma={gamma}: give 1 or more, and gamma in (0, 1)"
            )
        self.env, self.steps, self.n_step, self.double, self.tau = env, steps, n_step, double, tau
        self.target_every, self.gamma, self.learning_rate = target_every, gamma, learning_rate
        self.learning_rate_end = learning_rate_end
        self.batch_size, self.warmup, self.gradient_every = batch_size, warmup, gradient_every
        self.exploration, self.exploration_end, self.gradient_clip = (
            exploration,
            exploration_end,
            gradient_clip,
        )
        self.leg, self.seed = leg, seed
        inputs, actions = env.single_observation_space.shape[0], int(env.single_action_space.n)
        torch.manual_seed(seed)
        self.policy_dqn = QNetwork(inputs, actions, tuple(hidden))
        self.target_dqn = copy.deepcopy(self.policy_dqn)
        self.optimizer = torch.optim.Adam(self.policy_dqn.parameters(), lr=learning_rate, fused=True)
        self.replay = Replay(replay, inputs)
        self.done = 0  # environment steps
        self.updates = 0  # gradient steps

    def learn(
        self,
        *,
        folder: Path | None = None,
        report: Callable[[int, dict[str, float]], None] = lambda step, values: None,
        after_leg: Callable[["DQN"], None] = lambda dqn: None,
    ) -> None:
        """Train to the end, from wherever the last checkpoint left off.

        Args:
            folder: where the checkpoint is; None: none is written.
            report: called about every 5,000 steps with the share of each outcome, loss and value.
            after_leg: called after every leg, before its checkpoint is written.
        """
        while self.done < self.steps:
            self._leg(report)
            after_leg(self)
            if folder is not None:
                self.save(folder / CHECKPOINT)

    def _leg(self, report: Callable[[int, dict[str, float]], None]) -> None:
        env, robots = self.env, self.env.num_envs
        number = self.done // self.leg
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence((self.seed, number))))
        windows = Windows(self.n_step, robots, self.gamma, self.replay)
        obs, _ = env.reset(seed=int(rng.integers(2**31)))
        end = min(self.steps, (number + 1) * self.leg)
        ends, losses, values = np.zeros(4), [], []
        next_report = self.done + 5_000
        while self.done < end:
            action = self.act(obs, rng)
            next_obs, reward, terminated, truncated, info = env.step(action)
            ended = terminated | truncated
            last_obs = np.where(ended[:, None], info["final_obs"], next_obs) if ended.any() else next_obs
            windows.push(obs, action, reward, last_obs, terminated, ended)
            ends += np.bincount(info["event"][ended], minlength=4)
            obs = next_obs
            before, self.done = self.done, self.done + robots
            if self.done >= self.warmup:
                for _ in range(self.done // self.gradient_every - before // self.gradient_every):
                    loss, value = self.update(rng)
                    losses.append(loss)
                    values.append(value)
            if self.done >= next_report and losses:
                total = max(ends.sum(), 1)
                shares = dict(zip(("success", "collision", "timeout"), ends[1:] / total, strict=True))
                report(self.done, shares | {"loss": float(np.mean(losses)), "value": float(np.mean(values))})
                ends, losses, values, next_report = np.zeros(4), [], [], self.done + 5_000

    @property
    def epsilon(self) -> float:
        """Share of random actions now."""
        return max(
            self.exploration_end, 1 - (1 - self.exploration_end) * self.done / (self.exploration * self.steps)
        )

    @torch.inference_mode()
    def act(self, obs: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Epsilon-greedy actions ``(N,)``."""
        greedy: np.ndarray = self.policy_dqn(torch.from_numpy(obs)).argmax(1).numpy()
        random = rng.integers(0, self.policy_dqn.actions, len(obs))
        return np.where(rng.random(len(obs)) < self.epsilon, random, greedy)

    def update(self, rng: np.random.Generator) -> tuple[float, float]:
        """One gradient step; returns the loss and the mean value."""
        obs, action, value, next_obs, discount = self.replay.sample(rng, self.batch_size)
        with torch.no_grad():
            next_q = self.target_dqn(next_obs)
            best = (self.policy_dqn(next_obs) if self.double else next_q).argmax(1, keepdim=True)
            target = value + discount * next_q.gather(1, best).squeeze(1)
        q = self.policy_dqn(obs).gather(1, action[:, None]).squeeze(1)
        loss = nn.functional.mse_loss(q, target)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate * (
                1 - (1 - self.learning_rate_end) * min(1.0, self.done / self.steps)
            )
        self.optimizer.zero_grad()
        loss.backward()
        if self.gradient_clip:
            nn.utils.clip_grad_norm_(self.policy_dqn.parameters(), self.gradient_clip)
        self.optimizer.step()
        self.updates += 1
        if self.target_every == 0:
            with torch.no_grad():
                torch._foreach_lerp_(
                    list(self.target_dqn.parameters()), list(self.policy_dqn.parameters()), self.tau
                )
        elif self.updates % self.target_every == 0:
            self.target_dqn.load_state_dict(self.policy_dqn.state_dict())
        return float(loss.detach()), float(q.detach().mean())

    def save(self, path: Path) -> None:
        """Write all that the next leg needs; at once, so that a kill leaves the last checkpoint whole."""
        path.parent.mkdir(parents=True, exist_ok=True)
        state = {
            "policy_dqn": self.policy_dqn.state_dict(),
            "target_dqn": self.target_dqn.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "replay": self.replay.state_dict(),
            "done": self.done,
            "updates": self.updates,
        }
        unfinished = path.with_name(f".{path.name}.part")
        torch.save(state, unfinished)
        unfinished.replace(path)

    def restore(self, path: Path) -> None:
        """Go on from a checkpoint.

        Raises:
            FileNotFoundError: there is none.
        """
        if not path.is_file():
            raise FileNotFoundError(f"no checkpoint at {path}: training has not finished its first leg")
        state = torch.load(path, weights_only=True)
        self.policy_dqn.load_state_dict(state["policy_dqn"])
        self.target_dqn.load_state_dict(state["target_dqn"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.replay.load_state_dict(state["replay"])
        self.done, self.updates = state["done"], state["updates"]

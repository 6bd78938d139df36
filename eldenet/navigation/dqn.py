"""Deep Q-learning for the arena environment, as the paper's Algorithm 2 names it.

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
from eldenet.navigation.replay import Replay, Windows

CHECKPOINT = "dqn.pt"


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
        quantiles: of every action's return that are learnt, as a documented variant; 0: its mean alone.
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
        quantiles: int = 0,
        leg: int = 100_000,
        seed: int = 0,
    ) -> None:
        if (
            min(steps, n_step, batch_size, replay, gradient_every, leg) < 1
            or not 0 < gamma < 1
            or min(target_every, quantiles) < 0
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
        self.quantiles, self.leg, self.seed = quantiles, leg, seed
        inputs, actions = env.single_observation_space.shape[0], int(env.single_action_space.n)
        torch.manual_seed(seed)
        self.policy_dqn = QNetwork(inputs, actions, tuple(hidden), max(1, quantiles))
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
        # how far the training is: for arenas that grow harder
        progress = {"progress": self.done / self.steps}
        obs, _ = env.reset(seed=int(rng.integers(2**31)), options=progress)
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
        loss, value = self.loss(*self.replay.sample(rng, self.batch_size))
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
        return float(loss.detach()), value

    def loss(
        self, obs: Tensor, action: Tensor, value: Tensor, next_obs: Tensor, discount: Tensor
    ) -> tuple[Tensor, float]:
        """Of the actions taken: mean squared error or quantile regression; and their mean value."""
        rows = torch.arange(len(obs))
        with torch.no_grad():
            chooser = self.policy_dqn if self.double else self.target_dqn
            after = self.target_dqn.spread(next_obs)[rows, chooser(next_obs).argmax(1)]
            target = value[:, None] + discount[:, None] * after
        q = self.policy_dqn.spread(obs)[rows, action]
        loss = quantile_loss(q, target) if self.quantiles else nn.functional.mse_loss(q, target)
        return loss, float(q.detach().mean())

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


def quantile_loss(predicted: Tensor, target: Tensor) -> Tensor:
    """Quantile regression, with Huber's kappa 1.

    Dabney et al., "Distributional reinforcement learning with quantile regression", AAAI 2018, eq. 10.

    Args:
        predicted: ``(N, Q)`` at the middles of ``Q`` equal shares.
        target: samples ``(N, S)``.
    """
    count = predicted.shape[1]
    share = (torch.arange(count, dtype=predicted.dtype) + 0.5) / count
    error = target[:, None, :] - predicted[:, :, None]
    huber = torch.where(error.abs() < 1, 0.5 * error.square(), error.abs() - 0.5)
    weight = (share[:, None] - (error.detach() < 0).to(predicted.dtype)).abs()
    return (weight * huber).mean(2).sum(1).mean()

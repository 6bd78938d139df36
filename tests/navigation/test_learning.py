"""Deep Q-learning: returns, updates, checkpoints, settings."""

import math

import numpy as np
import pytest
import torch

from eldenet.navigation.dqn import CHECKPOINT, DQN, DQNSettings, NStepWindows, ReplayBuffer
from eldenet.navigation.tasks import TrainingArenas

gym = pytest.importorskip("gymnasium")
from eldenet.navigation.env import ArenaNavVectorEnv  # noqa: E402


def rounded(*values: float) -> tuple[float, ...]:
    return tuple(round(float(value), 3) for value in values)


def test_windows_make_n_step_returns_within_an_episode():
    rng = np.random.default_rng(0)
    replay = ReplayBuffer(10_000, 1)
    windows = NStepWindows(3, 2, 0.9, replay)
    episodes: list[list[list[tuple]]] = [[[]], [[]]]
    for step in range(60):
        obs = np.array([[step / 100], [step / 100 + 0.5]], np.float32)
        values, ended = rng.normal(size=2), rng.random(2) < 0.15
        terminated = ended & (rng.random(2) < 0.5)
        windows.push(obs, np.array([step % 5, step % 3]), values, obs + 0.01, terminated, ended)
        for robot in range(2):
            episodes[robot][-1].append(
                (obs[robot, 0], values[robot], obs[robot, 0] + 0.01, terminated[robot])
            )
            if ended[robot]:
                episodes[robot].append([])
    expected = set()
    for robot in range(2):
        for number, episode in enumerate(episodes[robot]):
            for start in range(len(episode)):
                part = episode[start : start + 3]
                if len(part) < 3 and number == len(episodes[robot]) - 1:
                    continue  # its end is not known yet
                value = sum(0.9**k * row[1] for k, row in enumerate(part))
                discount = 0.9 ** len(part) * (not part[-1][3])
                expected.add(rounded(part[0][0], value, part[-1][2], discount))
    count = len(replay)
    columns = replay.obs[:count, 0], replay.value, replay.next_obs[:, 0], replay.discount
    assert {rounded(*row) for row in zip(*columns, strict=False)} == expected


def tiny(steps: int, **options) -> DQN:
    settings = {
        "total_timesteps": steps, "checkpoint_interval": 400, "learning_starts": 100, "batch_size": 16,
        "hidden": (16,), "seed": 3,
    } | options  # fmt: skip
    return DQN(ArenaNavVectorEnv(4, arenas=TrainingArenas((0, 5))), DQNSettings(**settings))


@pytest.mark.parametrize("options", [{"learning_starts": 0}, {"exploration_fraction": 0.0}])
def test_a_training_may_learn_or_be_greedy_from_the_first_step(options):
    learner = tiny(400, **options)
    learner.learn()
    assert learner.finished
    assert learner.updates


def test_a_resumed_training_equals_an_uninterrupted_one(tmp_path):
    whole, first, second = (tiny(1200) for _ in range(3))
    whole.learn()

    def stop(dqn: DQN) -> None:
        if dqn.num_timesteps >= 800:
            dqn.save(tmp_path / CHECKPOINT)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        first.learn(at_checkpoint=stop)
    second.restore(tmp_path / CHECKPOINT)
    assert second.num_timesteps == 800
    second.learn()
    assert second.updates == whole.updates > 100
    for name, weights in whole.policy_dqn.state_dict().items():
        torch.testing.assert_close(second.policy_dqn.state_dict()[name], weights, rtol=0, atol=0)


def test_algorithm_2_copies_hard_and_the_default_softly():
    def equal(dqn: DQN) -> bool:
        pairs = zip(dqn.policy_dqn.parameters(), dqn.target_dqn.parameters(), strict=True)
        return all(torch.equal(policy, target) for policy, target in pairs)

    rng = np.random.default_rng(0)
    hard = tiny(400, n_step=1, double=False, target_update_interval=10)
    hard.learn()
    while hard.updates % 10:
        hard.update(rng)
    assert equal(hard)
    hard.update(rng)
    assert not equal(hard)
    soft = tiny(400, tau=0.25)
    soft.learn()
    before = [p.clone() for p in soft.target_dqn.parameters()]
    soft.update(rng)
    parameters = soft.target_dqn.parameters(), before, soft.policy_dqn.parameters()
    for target, old, policy in zip(*parameters, strict=True):
        torch.testing.assert_close(target, 0.75 * old + 0.25 * policy, rtol=1e-5, atol=1e-7)


class Corridor:
    """Ten cells, left or right; the values of the optimal policy are known."""

    num_envs = 8
    single_observation_space = gym.spaces.Box(-1, 1, (10,), np.float32)
    single_action_space = gym.spaces.Discrete(2)

    def _obs(self):
        return np.eye(10, dtype=np.float32)[self.at]

    def reset(self, *, seed=None, options=None):
        self.rng = np.random.default_rng(seed)
        self.at = self.rng.integers(0, 9, 8)
        return self._obs(), {}

    def step(self, action):
        self.at = np.clip(self.at + np.where(action == 1, 1, -1), 0, 9)
        done, obs = self.at == 9, self._obs()
        info = {"event": done.astype(int), "final_obs": obs}
        self.at = np.where(done, self.rng.integers(0, 9, 8), self.at)
        return self._obs(), done.astype(float), done, np.zeros(8, bool), info


@pytest.mark.slow
def test_the_network_learns_the_known_values_of_a_corridor():
    settings = DQNSettings(
        total_timesteps=8_000, checkpoint_interval=8_000, learning_starts=200, gamma=0.9, batch_size=64,
        hidden=(32,), buffer_size=4000, learning_rate=3e-3, tau=0.02, exploration_final_eps=0.3,
    )  # fmt: skip
    learner = DQN(Corridor(), settings)
    learner.learn()
    with torch.no_grad():
        values = learner.policy_dqn(torch.eye(10))[:9]
    assert (values.argmax(1) == 1).all()
    assert values[:, 1].numpy() == pytest.approx([0.9 ** (8 - cell) for cell in range(9)], abs=0.12)


def test_gradients_are_clipped_and_learning_rates_fall_as_set():
    rates = []
    for options in ({}, {"learning_rate_end": 1.0, "max_grad_norm": 0.0}, {"max_grad_norm": 1e-6}):
        learner = tiny(400, **options)
        learner.learn()
        rates.append(learner.optimizer.param_groups[0]["lr"])
        norm = torch.cat([p.grad.flatten() for p in learner.policy_dqn.parameters()]).norm()
        assert (norm <= 1.001e-6) == (options.get("max_grad_norm") == 1e-6)
    assert rates == pytest.approx([5e-5, 5e-4, 5e-5], rel=0.1)


@pytest.mark.parametrize(
    ("name", "value", "advice"),
    [
        ("gamma", 1.0, "a number between 0 and 1"),
        ("total_timesteps", 0, "1 or more"),
        ("train_freq", 0, "1 or more"),
        ("tau", 5.0, "from 0 to 1"),
        ("learning_rate", math.nan, "a finite number above 0"),
        ("exploration_fraction", -1.0, "0 or more"),
    ],
)
def test_settings_out_of_range_are_refused(name, value, advice):
    with pytest.raises(ValueError, match=rf"^learner\.{name}={value}: give {advice}$"):
        DQNSettings(**{name: value})


def test_a_training_too_short_to_learn_is_refused():
    with pytest.raises(ValueError, match=r"nothing is learned within learner\.total_timesteps=2000"):
        DQNSettings(total_timesteps=2000)

"""Compare our DQN with Stable-Baselines3's on the same environment.

python experiments/dqn_crosscheck/run.py        300,000 steps each, then 100 validation arenas per density

Both have the same observation, steps, discount, n-step returns, batch, replay and network. Stable-Baselines3
differs in its loss (Huber, the only one that it offers), its targets (not double), and its target network,
which is updated once per step of all robots.
"""

from argparse import ArgumentParser
from pathlib import Path

import numpy as np
import stable_baselines3
import torch
from stable_baselines3 import DQN as ReferenceDQN
from stable_baselines3.common.env_util import make_vec_env

from eldenet.navigation.dqn import DQN, DQNSettings
from eldenet.navigation.env import ArenaNavEnv, ArenaNavVectorEnv
from eldenet.navigation.evaluation import run_episodes, summarize
from eldenet.navigation.observer import Observer
from eldenet.navigation.policy import Navigator
from eldenet.navigation.qnetwork import QNetwork
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import frozen_arenas
from eldenet.results.run_record import environment

ROBOTS = 16


def train_reference(steps: int, seed: int) -> QNetwork:
    """Train Stable-Baselines3's DQN and return its network as one of ours."""
    env = make_vec_env(ArenaNavEnv, n_envs=ROBOTS, seed=seed)
    model = ReferenceDQN(
        "MlpPolicy", env, learning_rate=lambda left: 5e-4 * (0.1 + 0.9 * left), buffer_size=400_000,
        learning_starts=5_000, batch_size=256, tau=0.005, gamma=0.98, train_freq=1,
        gradient_steps=ROBOTS // 8,
        target_update_interval=1, exploration_fraction=0.3, exploration_final_eps=0.03, n_steps=5,
        policy_kwargs={"net_arch": [128, 128]}, seed=seed, device="cpu",
    )  # fmt: skip
    model.learn(steps, progress_bar=False)
    network = QNetwork(Observer().size, Observer().actions)
    weights = model.policy.q_net.q_net.state_dict()
    network.layers.load_state_dict(weights)
    observation = torch.from_numpy(env.reset())
    expected, _ = model.predict(observation.numpy(), deterministic=True)
    assert (network(observation).argmax(1).numpy() == np.asarray(expected)).all(), "the networks differ"
    return network


def train_ours(steps: int, seed: int) -> QNetwork:
    """Train our DQN on as many robots and return its network."""
    learner = DQN(ArenaNavVectorEnv(ROBOTS), DQNSettings(total_timesteps=steps, seed=seed))
    learner.learn()
    return learner.policy_dqn


def main() -> None:
    parser = ArgumentParser()
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--worlds", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/dqn_crosscheck.md"))
    args = parser.parse_args()
    where = environment()
    lines = [
        f"{args.steps:,} steps, seed {args.seed}, {ROBOTS} robots; success [%] on {args.worlds} "
        "validation arenas, kinematic, sensor ranges.",
        "",
        "| learner | 20 obstacles | 80 obstacles |",
        "|---|---:|---:|",
    ]
    for name, train in (("Stable-Baselines3", train_reference), ("ours", train_ours)):
        network = train(args.steps, args.seed)
        shown = []
        for density in (20, 80):
            arenas = frozen_arenas(density, args.worlds, split="val")
            rows = run_episodes(arenas, lambda robots, n=network: Navigator(n, {}, robots=robots), Ranges())
            s = summarize(rows)
            shown.append(f"{s['success']:.1f} [{s['success_low']:.1f}, {s['success_high']:.1f}]")
        lines.append(f"| {name} | {shown[0]} | {shown[1]} |")
        print(lines[-1], flush=True)
    lines += [
        "",
        f"{where['hardware']['processor']}, stable-baselines3 {stable_baselines3.__version__}, "
        f"torch {where['versions']['torch']}, mujoco {where['versions']['mujoco']}, {where['date']}; "
        f"`python experiments/dqn_crosscheck/{where['command']}`.",
    ]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

"""How many steps a second the training environment makes: steps.md.

python experiments/table6_time/steps.py        one thread; a few minutes

The packaged driver chooses the actions, so that episodes are as long as in training; its network's time is
not counted, episodes that end and new arenas are. Figures count processor time, so that a busy machine does
not spoil them; on two free cores two trainings run at this rate each.
"""

import time
from pathlib import Path

import torch

from eldenet.navigation.env import ArenaNavVectorEnv
from eldenet.navigation.noise import NoisyRanges
from eldenet.navigation.policy import Navigator
from eldenet.navigation.sensors import Ranges, Sensor
from eldenet.navigation.tasks import TrainingArenas
from eldenet.record import environment

HERE = Path(__file__).parent
ROBOTS, ROUNDS = 64, 450  # about four episodes of every robot: each arena is crossed four times in training
ROWS: tuple[tuple[str, str, Sensor], ...] = (
    ("kinematic, true ranges", "kinematic", Ranges()),
    ("kinematic, measured errors", "kinematic", NoisyRanges(errors="packaged")),
    ("wheels, true ranges", "wheels", Ranges()),
)


def main() -> None:
    where = environment()
    lines = [
        "# Steps of the environment a second of processor time",
        "",
        f"{ROBOTS} robots of the packaged driver, one thread, {ROUNDS} steps of all (wheels: a quarter); new "
        "arenas are counted, the network is not.",
        "",
        "| environment | 5 obstacles | 80 obstacles |",
        "|---|---:|---:|",
    ]
    for name, physics, sensor in ROWS:
        rates = [f"{rate(density, physics, sensor):,.0f}" for density in (5, 80)]
        lines.append(f"| {name} | {' | '.join(rates)} |")
        print(lines[-1], flush=True)
    lines += [
        "",
        f"{where['hardware']['processor']}, mujoco {where['versions']['mujoco']}, {where['date']}, "
        f"commit {(where['git'] or {}).get('commit')}.",
        f"Made by `python experiments/table6_time/{where['command']}`.",
    ]
    (HERE / "steps.md").write_text("\n".join(lines) + "\n")


def rate(density: int, physics: str, sensor: Sensor) -> float:
    """Steps of one robot a second of processor time."""
    driver = Navigator.load()
    env = ArenaNavVectorEnv(
        ROBOTS, sensor=sensor, physics=physics, arenas=TrainingArenas((density, density)),
        **driver.observer.options,
    )  # fmt: skip
    observation, _ = env.reset(seed=0)
    rounds, spent = ROUNDS if physics == "kinematic" else ROUNDS // 4, 0.0
    with torch.inference_mode():
        for _ in range(rounds):
            actions = driver.network(torch.from_numpy(observation).double()).argmax(1).numpy()
            started = time.process_time()
            observation = env.step(actions)[0]
            spent += time.process_time() - started
    return rounds * ROBOTS / spent


if __name__ == "__main__":
    main()

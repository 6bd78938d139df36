"""Measure the steps per second of the training environment.

python experiments/table6_time/steps.py        a few minutes, on an idle machine

The packaged driver chooses the actions, so that episodes are as long as in training. The time of its network
is not counted; ends of episodes and new arenas are.
"""

import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import torch

from eldenet.navigation.env import ArenaNavVectorEnv
from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.policy import Navigator
from eldenet.navigation.sensors import Ranges, Sensor
from eldenet.navigation.tasks import TrainingArenas
from eldenet.results.run_record import environment

ROBOTS, ROUNDS = 64, 450  # about four episodes a robot, as often as training crosses each arena
PROCESSES = (1, 2)  # side by side, with one thread each
ROWS: tuple[tuple[str, str, Sensor], ...] = (
    ("kinematic, true ranges", "kinematic", Ranges()),
    ("kinematic, measured errors", "kinematic", NoisyRanges(errors="packaged")),
    ("wheels, true ranges", "wheels", Ranges()),
)


def main() -> None:
    where = environment()
    titles = [f"{density} obstacles, {count} at once" for density in (5, 80) for count in PROCESSES]
    lines = [
        "# Steps of the environment a second",
        "",
        f"{ROBOTS} robots of the packaged driver in one or two processes of one thread each, {ROUNDS} steps "
        "of all (wheels: a quarter), wall clock, all processes together; new arenas are counted, the network "
        "is not.",
        "",
        f"| environment | {' | '.join(titles)} |",
        f"|---|{'---:|' * len(titles)}",
    ]
    for name, physics, sensor in ROWS:
        rates = [
            f"{together(count, density, physics, sensor):,.0f}" for density in (5, 80) for count in PROCESSES
        ]
        lines.append(f"| {name} | {' | '.join(rates)} |")
    hardware = where["hardware"]
    lines += [
        "",
        f"{hardware['processor']}, {hardware['cores']} cores, mujoco {where['versions']['mujoco']}, "
        f"{where['date']}, commit {(where['git'] or {}).get('commit')}.",
        f"Made by `python experiments/table6_time/{where['command']}`.",
    ]
    print("\n".join(lines))


def together(processes: int, density: int, physics: str, sensor: Sensor) -> float:
    """Return the steps per second of several processes at once, in sum."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(rate, density, physics, sensor) for _ in range(processes)]
        return sum(job.result() for job in jobs)


def rate(density: int, physics: str, sensor: Sensor) -> float:
    """Return the steps per second of one process, all robots together."""
    torch.set_num_threads(1)
    driver = Navigator.load()
    env = ArenaNavVectorEnv(
        ROBOTS, sensor=sensor, physics=physics, arenas=TrainingArenas((density, density)),
        **driver.observer.trained_with,
    )  # fmt: skip
    observation, _ = env.reset(seed=0)
    rounds, spent = ROUNDS if physics == "kinematic" else ROUNDS // 4, 0.0
    with torch.inference_mode():
        for _ in range(rounds):
            actions = driver.network(torch.from_numpy(observation).double()).argmax(1).numpy()
            started = time.perf_counter()
            observation = env.step(actions)[0]
            spent += time.perf_counter() - started
    return rounds * ROBOTS / spent


if __name__ == "__main__":
    main()

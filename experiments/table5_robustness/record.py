"""Record pictures and their depth along drives through training arenas, as a robot's depth camera would.

python experiments/table5_robustness/record.py runs/recorded    # for eldenet adapt

Every second drive goes straight to the goal until it touches something: a network must also learn what is
near.
"""

from argparse import ArgumentParser
from pathlib import Path

import numpy as np

from eldenet.navigation.cameras import camera
from eldenet.navigation.episodes import Episodes, EpisodeSettings
from eldenet.navigation.planners.straight import Straight
from eldenet.navigation.policy import Navigator
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.arena_view import robot_intrinsics
from eldenet.simulation.robot import ROBOT
from eldenet.visualization import write_picture

SIZE = (240, 320)  # of a picture [px]
EVERY = 4  # control periods


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--arenas", type=int, default=40)
    args = parser.parse_args()
    episodes = Episodes(1, camera(size=SIZE), EpisodeSettings("wheels"))
    drivers = Navigator.load(), Straight()
    count = 0
    for arena in frozen_arenas(20, args.arenas, split="train"):
        driver = drivers[arena.index % 2]
        episodes.start(0, arena, (arena.index,))
        driver.reset()
        event, period = 0, 0
        while event == 0:
            senses = episodes.sense()
            if period % EVERY == 0:
                seen = episodes.scans[0]
                millimeters = np.round(np.minimum(seen.depth, ROBOT.far) * 1000).astype(np.uint16)
                millimeters[seen.depth > ROBOT.far] = 0  # beyond the camera's reach
                write_picture(args.folder / f"images/{count:04d}.png", seen.image)
                write_picture(args.folder / f"depths/{count:04d}.png", millimeters)
                count += 1
            _, events = episodes.step(driver.commands(senses))
            event, period = int(events[0]), period + 1
    focal, (height, width) = robot_intrinsics(SIZE)[0, 0], SIZE
    lens = f"[{focal:.1f},{focal:.1f},{(width - 1) / 2},{(height - 1) / 2}]"
    print(f"{count} frames; intrinsics={lens}")


if __name__ == "__main__":
    main()

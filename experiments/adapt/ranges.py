"""How far a network's ranges are from the true ones in arenas with 80 obstacles, by true range.

python experiments/adapt/ranges.py NAME=WEIGHTS@PITCH ...    # adds rows to ranges.csv

PITCH is the camera's below the horizon [degrees]. There are ten views in each of 12 ``val`` arenas, half of
them close to something.
"""

import csv
import math
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from eldenet.deploy.predictor import for_camera
from eldenet.navigation.cameras import depth_network
from eldenet.navigation.ranges import depth_to_ranges
from eldenet.simulation.arena_view import ArenaView, camera_pose, robot_intrinsics
from eldenet.simulation.arenas import cell_center, clearance_map, generate_arena
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.uncertainty import as_estimate

ARENAS, VIEWS, SIZE = 12, 10, (96, 128)
EDGES = (0.3, 0.5, 0.8, 1.2, 2, 3, 4.5)  # of true ranges [m]
TABLE = Path(__file__).parent / "ranges.csv"


def poses(arena: int) -> list[tuple[float, float, float]]:
    """Draw where a robot stands, half the time within 0.8 m of something."""
    draw = Draw((77, arena))
    clearance = clearance_map(generate_arena("val", 80, arena).obstacles)
    found = []
    for view in range(VIEWS):
        places = np.argwhere((clearance >= 0.3) & (clearance < (0.8 if view % 2 else np.inf)))
        x, y = cell_center(*places[int(draw.unit() * len(places))])
        found.append((x, y, draw.uniform(-math.pi, math.pi)))
    return found


def main() -> None:
    torch.set_num_threads(1)
    intrinsics = robot_intrinsics(SIZE)
    bins = list(pairwise(EDGES))
    new = not TABLE.is_file()
    with TABLE.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([["weights", "pitch", *(f"{low:g}_{high:g}" for low, high in bins)]] if new else [])
        for word in sys.argv[1:]:
            name, _, where = word.partition("=")
            weights, _, degrees = where.rpartition("@")
            network = depth_network(weights)
            assert network is not None
            predict = for_camera(network, intrinsics)
            pitch = math.radians(float(degrees))
            truths, guesses = [], []
            for number in range(ARENAS):
                view = ArenaView(generate_arena("val", 80, number), SIZE)
                for noise, pose in enumerate(poses(number)):
                    photo = view.photo(pose, 0.0, noise, camera=camera_pose(pose, pitch))
                    for depth, into in (
                        (photo.depth, truths),
                        (as_estimate(predict(photo.image)).depth, guesses),
                    ):
                        into.append(depth_to_ranges(depth, intrinsics, tilt=(pitch, 0.0)))
            truth, ratio = np.concatenate(truths), np.concatenate(guesses) / np.concatenate(truths)
            medians = [np.nanmedian(ratio[(truth >= low) & (truth < high)]) for low, high in bins]
            row = [name, degrees, *(f"{median:.3f}" for median in medians)]
            writer.writerow(row)
            print(*row, flush=True)


if __name__ == "__main__":
    main()

"""Compare weights tuned on drives of ``arena_robot`` in six arenas that no drive went through.

python experiments/adapt/unseen.py NAME=WEIGHTS ...    # rows of AbsRel and predicted / true depth
"""

import csv
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import cv2
import drives
import numpy as np
import torch

import eldenet
from eldenet.data.io import read_image
from eldenet.deploy.predictor import DepthPredictor, for_camera
from eldenet.geometry import pinhole

ARENAS = range(30, 36)
EDGES = (0.3, 0.5, 0.8, 1.2, 2, 3, 5, 10)  # of true depth [m]


def main() -> None:
    torch.set_num_threads(1)
    folder = Path(tempfile.mkdtemp())
    for part in ("pictures", "truth"):
        (folder / part).mkdir()
    drives.render("arena_robot", ARENAS, folder, 0, 8)
    pictures = sorted((folder / "pictures").iterdir())
    height, width = drives.SIZE
    focal = drives.RENDERED["arena_robot"].focal * width
    camera = pinhole(focal, focal, (width - 1) / 2, (height - 1) / 2)
    table = Path(__file__).parent / "unseen.csv"
    header = ["weights", "pictures", "abs_rel", *(f"ratio_{low:g}_{high:g}" for low, high in bins())]
    new = not table.is_file()
    with table.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([header] if new else [])
        for word in sys.argv[1:]:
            name, weights = word.split("=", 1)
            predict = for_camera(DepthPredictor(eldenet.load(weights), steady=False), camera)
            guesses, truths = [], []
            for picture in pictures:
                truth = drives.meters(folder / "truth" / picture.name)
                guess = np.asarray(predict(read_image(picture)))
                if truth.shape != guess.shape:
                    truth = cv2.resize(truth, guess.shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
                known = (truth > 0.1) & (truth < 10)
                guesses.append(guess[known])
                truths.append(truth[known])
            truth = np.concatenate(truths)
            ratio = np.concatenate(guesses) / truth
            medians = [np.median(ratio[(truth >= low) & (truth < high)]) for low, high in bins()]
            row = [name, len(pictures), *(f"{value:.3f}" for value in (np.abs(ratio - 1).mean(), *medians))]
            writer.writerow(row)
            print(*row, flush=True)


def bins() -> list[tuple[float, float]]:
    """Ranges of true depth [m]."""
    return list(pairwise(EDGES))


if __name__ == "__main__":
    main()

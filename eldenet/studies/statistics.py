"""What the runs of a study say together: paired differences with their intervals, speed and steadiness."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from eldenet.bootstrap import bootstrap_interval

DRAWS, LEVEL = 10_000, 0.95


def per_image(files: Sequence[Path], metric: str) -> dict[str, float]:
    """``metric`` of every image, mean over the runs (seeds) whose ``per_image.csv`` these are.

    Raises:
        ValueError: the runs scored different images.
    """
    found: list[dict[str, float]] = []
    for file in files:
        with file.open(newline="") as lines:
            found.append({row["name"]: float(row[metric]) for row in csv.DictReader(lines)})
        if found[-1].keys() != found[0].keys():
            raise ValueError(f"{file} and {files[0]} scored different images: they can't be paired")
    return {name: float(np.mean([values[name] for values in found])) for name in found[0]}


def paired_interval(
    ours: Mapping[str, float], theirs: Mapping[str, float], *, seed: int = 0
) -> tuple[float, float, float]:
    """Mean difference ``ours - theirs`` and its 95 % interval: paired percentile bootstrap over the images.

    It speaks of the choice of images, not of the chance in a training: that is what several seeds are for.

    Raises:
        ValueError: the two scored different images.
    """
    if ours.keys() != theirs.keys():
        raise ValueError("the two rows scored different images: they can't be paired")
    difference = np.array([ours[name] - theirs[name] for name in ours])
    difference = difference[np.isfinite(difference)]
    low, high = bootstrap_interval(
        lambda chosen: float(difference[chosen].mean()), len(difference), draws=DRAWS, share=LEVEL, seed=seed
    )
    return float(difference.mean()), low, high

"""Differences between two trainings, frame by frame, with 95 % bootstrap intervals over scenes.

``python experiments/renders/paired.py val detail today`` reads the frames of ``val`` that ``score.py``
stored.
"""

import sys
from pathlib import Path

import numpy as np

from eldenet.evaluation.bootstrap import bootstrap_interval, scenes_of
from eldenet.system.files import read_table

METRICS = ("delta1", "abs_rel", "delta1_median_aligned", "abs_rel_median_aligned")


def read(split: str, name: str) -> dict[str, list[float]]:
    """Return the metrics of each frame."""
    rows = read_table(Path(__file__).with_name("frames.csv.gz"), ["weights", "split", "name", *METRICS])
    mine = [row for row in rows if (row["weights"], row["split"]) == (name, split)]
    return {row["name"]: [float(row[metric]) for metric in METRICS] for row in mine}


def main(split: str, ours: str, theirs: str) -> None:
    """Print the mean difference and interval of each metric."""
    first, second = read(split, ours), read(split, theirs)
    difference = np.array([np.subtract(first[name], second[name]) for name in first])
    for metric, values in zip(METRICS, difference.T, strict=True):
        low, high = bootstrap_interval(
            lambda drawn, values=values: float(values[drawn].mean()), scenes_of(list(first))
        )
        print(f"{metric}: {values.mean():+.3f} [{low:+.3f}, {high:+.3f}] of {len(values)} frames")


if __name__ == "__main__":
    main(*sys.argv[1:])

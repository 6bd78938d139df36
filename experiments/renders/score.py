"""Scores weights that saw no real frame on NYU's frames, and compares them frame by frame.

``python experiments/renders/score.py dev today=runs/today detail=runs/detail`` measures these run folders on
the frames of split ``dev``, puts them into ``frames.csv.xz`` and prints the table of all that it holds.
``val`` are the 130 frames of other scenes, for the end. ``score.py paired val detail today`` prints the
differences of two of them, with 95 % bootstrap intervals over scenes.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import eldenet
from eldenet.compose import compose
from eldenet.evaluation.bootstrap import mean_interval, scenes_of
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, evaluate
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.results.tables import to_markdown
from eldenet.system.files import read_table, write_rows
from eldenet.train import TrainSettings

FRAMES = Path(__file__).with_name("frames.csv.xz")
METRICS = ("delta1", "abs_rel", "delta1_median_aligned", "abs_rel_median_aligned")
COLUMNS = ("weights", "split", "name", *METRICS)


def score(name: str, source: str, split: str) -> list[list[str]]:
    """Rows of NYU's frames of a split: delta1 and AbsRel, unaligned, then median-aligned."""
    model = eldenet.load(source)
    size = list(model.info["input_size"])
    config = compose(
        TrainSettings, ["data=nyu_labelled", f"data.input_size={size}", f"data.val.split={split}"]
    )
    protocol = chosen_protocol(config.data, config.protocol)
    frames = open_split(config.data, "val", protocol)
    rows = [[name, split, frame] for frame in frames.names]
    columns = [PER_IMAGE_HEADER.index(metric) for metric in METRICS[:2]]
    for scale in ("metric", "median"):
        result = evaluate(model, frames, replace(protocol, scale=scale), device=torch.device("cpu"))
        for cells, row in zip(rows, result.rows, strict=True):
            cells += [f"{row[column]:.4f}" for column in columns]
    return rows


def stored() -> dict[tuple[str, str], dict[str, list[float]]]:
    """Metrics of the stored frames of each network and split, by the frame's name."""
    found: dict[tuple[str, str], dict[str, list[float]]] = {}
    for row in read_table(FRAMES, COLUMNS):
        frames = found.setdefault((row["weights"], row["split"]), {})
        frames[row["name"]] = [float(row[metric]) for metric in METRICS]
    return found


def compare(split: str, ours: str, theirs: str) -> None:
    """Print the mean difference and interval of each metric."""
    first, second = stored()[ours, split], stored()[theirs, split]
    difference = np.array([np.subtract(first[name], second[name]) for name in first])
    for metric, values in zip(METRICS, difference.T, strict=True):
        low, high = mean_interval(values, scenes_of(list(first)))
        print(f"{metric}: {values.mean():+.3f} [{low:+.3f}, {high:+.3f}] of {len(values)} frames")


def main(split: str, sources: list[str]) -> None:
    """Measure ``sources``, store their frames, and print the table."""
    torch.set_num_threads(1)
    for source in sources:
        name, _, folder = source.rpartition("=")
        rows = score(name or folder, folder, split)
        others = [list(row.values()) for row in read_table(FRAMES, COLUMNS)] if FRAMES.exists() else []
        write_rows(FRAMES, COLUMNS, [row for row in others if row[:2] != rows[0][:2]] + rows)
    means = {key: np.mean(list(frames.values()), axis=0) for key, frames in stored().items()}
    lines = [[*key, *(f"{value:.3f}" for value in values)] for key, values in means.items()]
    print(to_markdown(("weights", "split", *METRICS), lines, []))


if __name__ == "__main__":
    if sys.argv[1] == "paired":
        compare(*sys.argv[2:])
    else:
        main(sys.argv[1], sys.argv[2:])

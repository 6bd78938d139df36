"""What each source of pictures gives with other cameras, frame by frame, with intervals.

``python experiments/sources/cameras.py runs/sources`` scores every run there on the places of
``$ELDENET_DATA/other_cameras``, writes ``cameras.csv.xz`` and prints the table in Markdown.
"""

import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import eldenet
from eldenet.evaluation.bootstrap import mean_interval
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, evaluate
from eldenet.system.files import read_table, write_rows

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "indoor"))
from other_cameras import ASPECTS, frames_of  # noqa: E402

STORED = HERE / "cameras.csv.xz"
COLUMNS = ("row", "seed", "place", "frame", "delta1", "delta1_median_aligned")
REFERENCE = "all"


def measure(folder: Path) -> None:
    """Score each frame by each run below ``folder``."""
    torch.set_num_threads(1)
    column = PER_IMAGE_HEADER.index("delta1")
    rows = []
    for run in sorted(folder.glob("*/seed*")):
        model = eldenet.load(run)
        for place in ASPECTS:
            protocol, frames = frames_of(place, model.info["input_size"][0])
            scores = [
                [row[column] for row in evaluate(model, frames, each, device=torch.device("cpu")).rows]
                for each in (protocol, replace(protocol, scale="median"))
            ]
            rows += [
                [run.parent.name, run.name, place, name, f"{metric:.4f}", f"{aligned:.4f}"]
                for name, metric, aligned in zip(frames.names, *scores, strict=True)
            ]
            write_rows(STORED, COLUMNS, rows)


def show() -> None:
    """Print the means of each row, and how far they lie above those of ``REFERENCE``."""
    values: dict[tuple[str, str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in read_table(STORED, COLUMNS):
        for metric in COLUMNS[4:]:
            values[row["place"], metric, row["row"]][row["frame"]].append(float(row[metric]))
    print("| place | metric | row | mean | change from `all` [95 %] |\n|---|---|---|---:|---|")
    for (place, metric, name), frames in values.items():
        means = np.array([np.mean(scores) for scores in frames.values()])
        change = means - [np.mean(scores) for scores in values[place, metric, REFERENCE].values()]
        low, high = mean_interval(change)
        text = "" if name == REFERENCE else f"{change.mean():+.3f} [{low:+.3f}, {high:+.3f}]"
        print(f"| {place} | {metric} | `{name}` | {means.mean():.3f} | {text} |")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        measure(Path(sys.argv[1]))
    show()

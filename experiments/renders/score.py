"""Scores weights that saw no real frame on real ones: NYU's, and those of two other cameras.

``python experiments/renders/score.py dev today=runs/today detail=runs/detail`` measures these run folders on
NYU's frames of split ``dev``, puts their rows into ``scores.csv`` and prints the table. ``val`` are the 130
frames of other scenes, for the end; ``cameras`` are the places of ``$ELDENET_DATA/other_cameras``.
"""

import sys
from dataclasses import replace
from pathlib import Path

import torch

import eldenet
from eldenet.compose import compose
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, evaluate
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.system.files import read_table, write_rows
from eldenet.train import TrainSettings

HERE = Path(__file__).parent
STORED = HERE / "scores.csv"
FRAMES = HERE / "frames.csv.gz"
COLUMNS = ("weights", "frames", "delta1", "abs_rel", "delta1_median_aligned", "abs_rel_median_aligned")
FRAME_COLUMNS = ("weights", "split", "name", *COLUMNS[2:])


def score(name: str, source: str, split: str) -> list[float]:
    """Return delta1 and AbsRel on NYU's frames of a split, unaligned, then median-aligned.

    Those of each frame go into ``frames.csv.gz``, for ``paired.py``.
    """
    model = eldenet.load(source)
    size = list(model.info["input_size"])
    config = compose(
        TrainSettings, ["data=nyu_labelled", f"data.input_size={size}", f"data.val.split={split}"]
    )
    protocol = chosen_protocol(config.data, config.protocol)
    frames, found = open_split(config.data, "val", protocol), []
    per_frame = [[name, split, frame] for frame in frames.names]
    columns = [PER_IMAGE_HEADER.index(metric) for metric in ("delta1", "abs_rel")]
    for scale in ("metric", "median"):
        result = evaluate(model, frames, replace(protocol, scale=scale), device=torch.device("cpu"))
        found += [result.metrics["delta1"], result.metrics["abs_rel"]]
        for cells, row in zip(per_frame, result.rows, strict=True):
            cells += [f"{row[column]:.4f}" for column in columns]
    stored = [list(row.values()) for row in read_table(FRAMES, FRAME_COLUMNS)] if FRAMES.exists() else []
    others = [row for row in stored if row[:2] != [name, split]]
    write_rows(FRAMES, FRAME_COLUMNS, others + per_frame)
    return found


def main(split: str, sources: list[str]) -> None:
    """Measure ``sources``, store their rows, and print the table."""
    torch.set_num_threads(1)
    rows = {}
    if STORED.exists():
        rows = {(row["weights"], row["frames"]): row for row in read_table(STORED, COLUMNS)}
    for source in sources:
        name, _, folder = source.rpartition("=")
        if split == "cameras":
            sys.path.insert(0, str(HERE.parent / "indoor"))
            import other_cameras

            found = {place: other_cameras.score(folder, place) for place in other_cameras.PLACES}
        else:
            found = {f"nyu_{split}": score(name or folder, folder, split)}
        for frames, figures in found.items():
            values = [name or folder, frames, *(f"{figure:.3f}" for figure in figures)]
            rows[values[0], frames] = dict(zip(COLUMNS, values, strict=True))
            write_rows(STORED, COLUMNS, [[row[column] for column in COLUMNS] for row in rows.values()])
    print("| " + " | ".join(COLUMNS) + " |\n|---|---|---:|---:|---:|---:|")
    for row in rows.values():
        print("| " + " | ".join(row[column] for column in COLUMNS) + " |")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])

"""Scores weights on the places of other cameras, unaligned with the focal length given and median-aligned.

``python experiments/indoor/other_cameras.py eldenet_indoor eldenet_rooms`` measures these weights, puts their
rows into ``other_cameras.csv`` and prints the whole table in Markdown. ``stage2=runs/indoor_tuned`` gives the
weights of a folder a row of that name. Frames are those of ``$ELDENET_DATA/other_cameras``.
"""

import sys
from dataclasses import replace
from pathlib import Path

import torch

import eldenet
from eldenet.data.base import DepthDataset
from eldenet.evaluation.evaluator import evaluate
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.system.files import read_table, write_rows

sys.path.insert(0, str(Path(__file__).parents[1]))
from places import camera_split

STORED = Path(__file__).with_name("other_cameras.csv")
FIGURES = ("delta1", "abs_rel", "delta1_median_aligned", "abs_rel_median_aligned")
COLUMNS = ("weights", "place", *FIGURES)
#: Place -> width / height of its pictures.
ASPECTS = {"hololens_office": 3 / 2, "tum_fr3_cabinet": 4 / 3}


def frames_of(place: str, rows: int) -> tuple[EvalProtocol, DepthDataset]:
    """Return the protocol and the frames of a place, as a network of ``rows`` rows of pixels sees them."""
    return camera_split(place, (rows, round(rows * ASPECTS[place])))


def score(source: str, place: str) -> list[float]:
    """Return delta1 and AbsRel unaligned, then delta1 and AbsRel median-aligned."""
    model = eldenet.load(source)
    protocol, frames = frames_of(place, model.info["input_size"][0])
    found = []
    for scale in ("metric", "median"):
        result = evaluate(model, frames, replace(protocol, scale=scale), device=torch.device("cpu"))
        found += [result.metrics["delta1"], result.metrics["abs_rel"]]
    return found


def main(sources: list[str]) -> None:
    """Measure ``sources``, store their rows, and print the table."""
    torch.set_num_threads(1)
    rows = (
        {(row["weights"], row["place"]): row for row in read_table(STORED, COLUMNS)}
        if STORED.exists()
        else {}
    )
    for given in sources:
        name, _, source = given.rpartition("=")
        for place in ASPECTS:
            figures = zip(FIGURES, score(source, place), strict=True)
            named = {"weights": name or source, "place": place}
            rows[name or source, place] = named | {title: f"{value:.4f}" for title, value in figures}
            write_rows(STORED, COLUMNS, [[row[column] for column in COLUMNS] for row in rows.values()])
    print("| weights | place | δ1 unaligned | AbsRel unaligned | δ1 median-aligned | AbsRel median-aligned |")
    print("|---|---|---:|---:|---:|---:|")
    for row in rows.values():
        cells = " | ".join(f"{float(row[title]):.3f}" for title in FIGURES)
        print(f"| {row['weights']} | {row['place']} | {cells} |")


if __name__ == "__main__":
    main(sys.argv[1:])

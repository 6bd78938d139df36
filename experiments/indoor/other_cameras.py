"""Scores weights on the places of other cameras, unaligned with the focal length given and median-aligned.

``python experiments/indoor/other_cameras.py eldenet_indoor eldenet_rooms`` measures these weights, puts their
rows into ``other_cameras.csv`` and prints the whole table in Markdown. ``stage2=runs/indoor_tuned`` gives the
weights of a folder a row of that name. Frames are those of ``$ELDENET_DATA/other_cameras``.
"""

import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import torch

import eldenet
from eldenet.compose import compose
from eldenet.data.base import DepthDataset
from eldenet.evaluation.evaluator import evaluate
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.system.files import read_table, write_rows
from eldenet.train import TrainSettings

STORED = Path(__file__).with_name("other_cameras.csv")
FIGURES = ("delta1", "abs_rel", "delta1_median_aligned", "abs_rel_median_aligned")
COLUMNS = ("weights", "place", *FIGURES)
#: Place -> intrinsics at the pictures' size [px], and the pictures' width / height.
PLACES = {
    "hololens_office": ([440.5, 440.4, 239.6, 150.4], 3 / 2),
    "tum_fr3_cabinet": ([401.6, 404.4, 240.1, 185.7], 4 / 3),
}


def frames_of(place: str, rows: int) -> tuple[DepthDataset, EvalProtocol]:
    """Return the frames of a place, ``rows`` pixels high in their own aspect, and how they are scored."""
    root = Path(os.environ["ELDENET_DATA"]) / "other_cameras"
    lines = [line for line in (root / "pairs.csv").read_text().splitlines() if line.startswith(place)]
    intrinsics, aspect = PLACES[place]
    size = [rows, round(rows * aspect)]
    with tempfile.NamedTemporaryFile("w", suffix=".csv") as table:
        table.write("\n".join(",".join(line.split(",")[:2]) for line in lines))
        table.flush()
        data = ["data=folder", f"data.root={root}", f"data.csv={table.name}", f"data.intrinsics={intrinsics}"]
        config = compose(
            TrainSettings, [*data, f"data.input_size={size}", "data.val_fraction=0.5", "data.blocks=2"]
        )
        protocol = chosen_protocol(config.data, config.protocol)
        config.data["val"]["split"] = "all"
        return open_split(config.data, "val", protocol), protocol


def score(source: str, place: str) -> list[float]:
    """Return delta1 and AbsRel unaligned, then delta1 and AbsRel median-aligned."""
    model = eldenet.load(source)
    frames, protocol = frames_of(place, model.info["input_size"][0])
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
        for place in PLACES:
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

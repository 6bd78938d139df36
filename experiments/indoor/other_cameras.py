"""Scores weights on the places of other cameras, unaligned with the focal length given and median-aligned.

``python experiments/indoor/other_cameras.py eldenet_indoor eldenet_rooms`` prints a table in Markdown. Frames
are those of ``$ELDENET_DATA/other_cameras``.
"""

import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import torch

import eldenet
from eldenet.config import build_protocol, build_split, compose
from eldenet.evaluation.evaluator import evaluate

#: Place -> intrinsics at the pictures' size [px], and the pictures' width / height.
PLACES = {
    "hololens_office": ([440.5, 440.4, 239.6, 150.4], 3 / 2),
    "tum_fr3_cabinet": ([401.6, 404.4, 240.1, 185.7], 4 / 3),
}


def score(source: str, place: str) -> tuple[float, float, float, float]:
    """Return delta1 and AbsRel unaligned, then delta1 and AbsRel median-aligned."""
    root = Path(os.environ["ELDENET_DATA"]) / "other_cameras"
    lines = [line for line in (root / "pairs.csv").read_text().splitlines() if line.startswith(place)]
    intrinsics, aspect = PLACES[place]
    model = eldenet.load(source)
    rows = model.info["input_size"][0]
    size = [rows, round(rows * aspect)]
    with tempfile.NamedTemporaryFile("w", suffix=".csv") as table:
        table.write("\n".join(",".join(line.split(",")[:2]) for line in lines))
        table.flush()
        data = ["data=folder", f"data.root={root}", f"data.csv={table.name}", f"data.intrinsics={intrinsics}"]
        config = compose(
            "train", [*data, f"data.input_size={size}", "data.val_fraction=0.5", "data.blocks=2"]
        )
        protocol = build_protocol(config)
        config.data.val.split = "all"
        frames = build_split(config, "val", protocol)
        found: list[float] = []
        for scale in ("metric", "median"):
            result = evaluate(model, frames, replace(protocol, scale=scale), device=torch.device("cpu"))
            found += [result.metrics["delta1"], result.metrics["abs_rel"]]
    return found[0], found[1], found[2], found[3]


def main(sources: list[str]) -> None:
    """Print the table of ``sources``."""
    torch.set_num_threads(1)
    print("| weights | place | δ1 unaligned | AbsRel unaligned | δ1 median-aligned | AbsRel median-aligned |")
    print("|---|---|---:|---:|---:|---:|")
    for source in sources:
        for place in PLACES:
            cells = " | ".join(f"{value:.3f}" for value in score(source, place))
            print(f"| {source} | {place} | {cells} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

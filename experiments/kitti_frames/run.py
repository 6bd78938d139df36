"""Score depth networks on a few real KITTI frames, unaligned and median-aligned.

``python experiments/kitti_frames/run.py meter_xxs_kitti=meter_xxs_kitti.pth eldenet_streets=runs/streets``
scores these weights and a constant predictor, puts their frames into ``frames.csv`` and writes
``results.md`` from it; without arguments it only writes ``results.md``. Weights are anything that
:func:`eldenet.load` opens, or a ``.pth`` file of METER-XXS's published KITTI weights. Frames are those of
``$ELDENET_DATA/kitti``.
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

import eldenet
from eldenet.compose import compose
from eldenet.evaluate import EvaluateSettings
from eldenet.evaluation.bootstrap import mean_interval, scenes_of
from eldenet.evaluation.constant_baseline import fit_constant_predictor
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, evaluate
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.results.tables import to_markdown
from eldenet.system.files import read_table, write_rows

HERE = Path(__file__).parent
STORED = HERE / "frames.csv"
FIGURES = ("abs_rel", "rmse", "delta1")
COLUMNS = ("weights", "set", "scale", "frame", *FIGURES)
CONSTANT = "constant"
TITLES = ("AbsRel ↓", "RMSE [m] ↓", "δ1 ↑")
SCALES = ("metric", "median")  # meters as predicted; each prediction times median(truth) / median(prediction)
ENOUGH = 10  # frames of a set for an interval


@dataclass(frozen=True)
class Frames:
    """One kind of frames at hand.

    Attributes:
        title: what they are.
        overrides: data set and protocol; ``{root}`` is ``$ELDENET_DATA/kitti``.
        split: which frames of the data set.
    """

    title: str
    overrides: tuple[str, ...]
    split: str | None = None


SETS = {
    "devkit": Frames(
        "frames of the depth devkit's `train`, ground truth of eleven scans; protocol "
        "`kitti_eigen_garg_improved`",
        ("data=kitti", "data.root={root}/depth", "protocol=kitti_eigen_garg_improved"),
        "all",
    ),
    "selection": Frames(
        "frame of `val_selection_cropped`, ground truth of eleven scans; protocol `kitti_adabins`, "
        "whose crop is Garg's within 352 x 1216",
        (
            *("data=kitti_selection", "data.selection_root={root}/depth_selection", "data.frames=null"),
            *("data.calibration=optional", "data.on_error=skip", "protocol=kitti_adabins"),
        ),
    ),
    "object": Frames(
        "frames of the object data set, each with one scan; protocol `kitti_eigen_garg_raw`",
        (
            *("data=folder", "data.root={root}", "data.images=object/training/image_2"),
            *("data.depths=depth_derived/object/training", "data.encoding=kitti", "data.ground_truth=sparse"),
            *(
                "data.min_depth=0.001",
                "data.max_depth=80",
                "data.on_error=skip",
                "protocol=kitti_eigen_garg_raw",
            ),
        ),
        "all",
    ),
    "drive": Frames(
        "frames of one slow drive, each with one scan; protocol `kitti_eigen_garg_raw`",
        (
            *("data=kitti", "data.root={root}/depth_derived", "data.raw_root={root}/raw"),
            *("data.depth=velodyne_raw", "protocol=kitti_eigen_garg_raw"),
        ),
        "all",
    ),
}


def load(source: str) -> eldenet.DepthNet:
    """Return the network of a run folder, a saved model, packaged weights or METER's published file."""
    if not source.endswith(".pth"):
        return eldenet.load(source)
    model = eldenet.load(
        "meter_xxs",
        overrides=[  # docs/networks.md, "METER's published weights"
            *(f"model.network.weights={source}", "model/head=scaled", "model.head.scale=0.1"),
            *("model.head.max_depth=80", "+model.mean=[0,0,0]", "+model.std=[1,1,1]"),
        ],
    )
    model.info["input_size"] = [192, 640]
    return model


def mean_street() -> nn.Module:
    """Return the constant predictor: the mean depth map of rendered streets, `data=streets`."""
    config = compose(EvaluateSettings, ["checkpoint=none", "data=streets"])
    return fit_constant_predictor(
        open_split(config.data, "train", chosen_protocol(config.data, config.protocol), frames=512)
    )


def score(model: nn.Module, frames: Frames, size: Sequence[int], scale: str) -> list[list[str]]:
    """Return the name and the figures of each frame.

    Args:
        model: predicts meters, or canonical depth.
        frames: what to score.
        size: ``(height, width)`` [px] that the network sees.
        scale: one of ``SCALES``.
    """
    root = Path(os.environ["ELDENET_DATA"]) / "kitti"
    overrides = [override.format(root=root) for override in frames.overrides]
    config = compose(EvaluateSettings, ["checkpoint=none", *overrides, f"data.input_size={list(size)}"])
    protocol = chosen_protocol(config.data, config.protocol)
    if frames.split is not None:
        config.data["test"]["split"] = frames.split
    found = evaluate(
        model,
        open_split(config.data, "test", protocol, score=True),
        replace(protocol, scale=scale),
        batch_size=1,
    )
    places = [PER_IMAGE_HEADER.index(name) for name in FIGURES]
    return [[str(row[0]), *(f"{row[place]:.5f}" for place in places)] for row in found.rows]


def page(rows: Sequence[Mapping[str, str]]) -> str:
    """Return ``results.md`` of the stored frames."""
    text = ["# kitti_frames\n"]
    for name, frames in SETS.items():
        own = [row for row in rows if row["set"] == name]
        count = len({row["frame"] for row in own})
        text.append(f"\n## {name}: {count} {frames.title}\n")
        lines = []
        for weights in dict.fromkeys(row["weights"] for row in own):
            cells = [
                cell([row for row in own if (row["weights"], row["scale"]) == (weights, scale)], figure)
                for scale in SCALES
                for figure in FIGURES
            ]
            lines.append([weights, *cells])
        header = [f"{figure}{note}" for note in ("", ", median-aligned") for figure in TITLES]
        text.append("\n" + to_markdown(["weights", *header], lines, []))
    text.append(
        f"\nMeans over the frames; from {ENOUGH} frames on with the 95 % interval of a bootstrap over them. "
        "Median-aligned: each prediction times median(truth) / median(prediction). "
        "Made by `python experiments/kitti_frames/run.py`.\n"
    )
    return "".join(text)


def cell(rows: Sequence[Mapping[str, str]], figure: str) -> str:
    """Return the mean of a figure, with its interval where there are enough frames."""
    values = np.array([float(row[figure]) for row in rows])
    mean = f"{values.mean():.3f}"
    if len(values) < ENOUGH:
        return mean
    low, high = mean_interval(values, scenes_of([row["frame"] for row in rows]))
    return f"{mean} [{low:.3f}, {high:.3f}]"


def main(sources: Sequence[str]) -> None:
    """Score ``sources`` and a constant predictor, store their frames, and write the page."""
    torch.set_num_threads(1)
    stored = [dict(row) for row in read_table(STORED, COLUMNS)] if STORED.exists() else []
    networks: dict[str, Callable[[], nn.Module]] = {}
    for given in sources:
        name, _, source = given.rpartition("=")
        networks[name or source] = lambda source=source: load(source)
    if sources:
        networks[CONSTANT] = mean_street
    for name, make in networks.items():
        model = make()
        size = getattr(model, "info", {}).get("input_size", (96, 320))
        stored = [row for row in stored if row["weights"] != name]
        for place, frames in SETS.items():
            for scale in SCALES:
                for values in score(model, frames, size, scale):
                    stored.append(dict(zip(COLUMNS, [name, place, scale, *values], strict=True)))
        write_rows(STORED, COLUMNS, [[row[column] for column in COLUMNS] for row in stored])
    (HERE / "results.md").write_text(page(stored))


if __name__ == "__main__":
    main(sys.argv[1:])

"""Measures what sharpening changes: accuracy of all pixels, and of those near edges of the true depth.

``python experiments/indoor/sharp.py eldenet_l_indoor`` writes ``sharp.md``. Frames are two of three held-out
NYU frames (the others chose the constants), and those of ``$ELDENET_DATA/other_cameras``.
"""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import torch
from other_cameras import PLACES

import eldenet
from eldenet.compose import compose
from eldenet.data.io import read_depth, read_image
from eldenet.deploy.predictor import DepthPredictor
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.results.paired_intervals import Scores, paired_interval
from eldenet.results.run_record import environment
from eldenet.results.tables import to_markdown
from eldenet.train import TrainSettings

EDGE = 1.15  # ratio of neighboring depths at an edge
NEAR = 9  # side of the square around an edge [px]

# photo, true depth [m], (fx, fy, cx, cy) [px]
Shot = tuple[np.ndarray, np.ndarray, tuple[float, ...]]


def nyu() -> Iterator[Shot]:
    """Two of three held-out frames; the others chose the constants of sharpening."""
    config = compose(TrainSettings, ["data=nyu_labelled"])
    frames = open_split(config.data, "val", chosen_protocol(config.data, config.protocol))
    for index in range(len(frames)):
        if index % 3:
            frame = frames.load_frame(index)
            k = frame.intrinsics
            assert k is not None
            yield frame.image, frame.depth, (k[0, 0], k[1, 1], k[0, 2], k[1, 2])


def place(name: str) -> Iterator[Shot]:
    """The frames of another camera."""
    for path in sorted((Path(os.environ["ELDENET_DATA"]) / "other_cameras" / name).glob("*.jpg")):
        truth = read_depth(path.with_suffix(".png"), "mm")
        yield read_image(path), truth, tuple(PLACES[name][0])


def near_edges(truth: np.ndarray) -> np.ndarray:
    """Pixels with known depth near a step of it ``(H, W)``."""
    known, square = truth > 0, np.ones((3, 3))
    far = cv2.dilate(truth, square)
    near = cv2.erode(np.where(known, truth, np.float32(1e3)), square)
    edges = ((far > EDGE * near) & known).astype(np.uint8)
    return known & (cv2.dilate(edges, np.ones((NEAR, NEAR))) > 0)


def delta1(depth: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Share of the masked pixels within a factor of 1.25, aligned by the median of all known pixels."""
    depth = depth * (np.median(truth[truth > 0]) / np.median(depth[truth > 0]))
    ratio = depth[mask] / truth[mask]
    return float((np.maximum(ratio, 1 / ratio) < 1.25).mean()) if mask.any() else float("nan")


def main(source: str) -> None:
    """Measure and write the table."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    model = eldenet.load(source)
    plain, sharp = (DepthPredictor(model, steady=False, sharp=on) for on in (False, True))
    rows = []
    for name, shots in {"NYU": nyu(), **{name: place(name) for name in PLACES}}.items():
        figures: list[list[float]] = []
        seconds: list[float] = []
        for photo, truth, camera in shots:
            before = plain(photo, intrinsics=camera)
            start = time.perf_counter()
            after = sharp(photo, intrinsics=camera)
            seconds.append(time.perf_counter() - start)
            masks = truth > 0, near_edges(truth)
            figures.append([delta1(depth, truth, mask) for mask in masks for depth in (before, after)])
        images = tuple(map(str, range(len(figures))))
        scores = [Scores(images, np.array([column])) for column in zip(*figures, strict=True)]
        cells = [name, str(len(figures))]
        for without, with_it in (scores[:2], scores[2:]):
            mean, low, high = paired_interval(with_it, without, draw_seeds=False)
            cells += [f"{np.nanmean(without.values):.3f}", f"{np.nanmean(with_it.values):.3f}"]
            cells += [f"{mean:+.3f} [{low:+.3f}, {high:+.3f}]"]
        rows.append([*cells, f"{np.median(seconds):.2f}"])
        print(*rows[-1], flush=True)
    header = ["frames", "number", "δ1", "sharp", "difference", "δ1 near edges", "sharp", "difference"]
    notes = [
        f"{source}, focal length given, median-aligned; near edges: within {NEAR // 2} px of a step of the "
        f"true depth by a factor of {EDGE}",
        "difference: paired, over images, with the 95 % interval of the bootstrap",
        f"{environment()['hardware']['processor']}, 1 thread; python experiments/indoor/sharp.py {source}",
    ]
    Path(__file__).with_name("sharp.md").write_text(
        to_markdown([*header, "network and sharpening [s]"], rows, notes)
    )


if __name__ == "__main__":
    main(sys.argv[1])

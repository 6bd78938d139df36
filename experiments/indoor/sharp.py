"""Measures what sharpening changes: accuracy of all pixels, and of those near edges of the true depth.

``python experiments/indoor/sharp.py eldenet_l_indoor`` prints the table. Frames are two of three held-out
NYU frames (the others chose the constants), and those of ``$ELDENET_DATA/other_cameras``.
"""

import sys
import time
from pathlib import Path

import cv2
import numpy as np
import torch

import eldenet
from eldenet.deploy.predictor import DepthPredictor
from eldenet.results.paired_intervals import Scores, paired_interval
from eldenet.results.run_record import environment
from eldenet.results.tables import to_markdown
from eldenet.types import Frame

sys.path.insert(0, str(Path(__file__).parents[1]))
from places import OTHER_CAMERAS, camera_frames, split_frames

EDGE = 1.15  # ratio of neighboring depths at an edge
NEAR = 9  # side of the square around an edge [px]


def frames_of(place: str) -> list[Frame]:
    """Two of three held-out frames of NYU (the others chose the constants), all of another camera."""
    if place == "NYU":
        frames = split_frames(["data=nyu_labelled"])[1]
        return [frame for index, frame in enumerate(frames) if index % 3]
    return camera_frames(place)[1]


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
    """Measure and print the table."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    model = eldenet.load(source)
    plain, sharp = (DepthPredictor(model, steady=False, sharp=on) for on in (False, True))
    rows = []
    for name in ("NYU", *OTHER_CAMERAS):
        figures: list[list[float]] = []
        seconds: list[float] = []
        for photo, truth, camera, *_ in frames_of(name):
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
    print(to_markdown([*header, "network and sharpening [s]"], rows, notes))


if __name__ == "__main__":
    main(sys.argv[1])

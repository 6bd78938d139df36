"""Compare the depth of rendered rooms with NYU's in a few numbers, and draw ``rooms.jpg``, some of the rooms.

python experiments/renders/beside_nyu.py        (NYU's row needs ELDENET_DATA, see docs/data.md)
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from eldenet.data.base import DepthDataset
from eldenet.data.nyu import NYULabelled
from eldenet.data.rooms import Rooms
from eldenet.visualization import color_depth, stack_rows

HERE = Path(__file__).parent
COLUMNS = ("p5", "median", "p95", "frame_median", "frame_median_std", "frame_range", "gradient")
TITLES = ("5 % [m]", "median [m]", "95 % [m]", "frame median [m]", "± over frames", "95 % / 5 %", "gradient")


class DepthStatistics(NamedTuple):
    """Depth of a data set over a sample of its frames.

    Attributes:
        frames: how many frames were looked at.
        p5: 5th percentile of all known pixels [m].
        median: [m].
        p95: [m].
        mean: [m].
        frame_median: mean over frames of the frame's median [m].
        frame_median_std: its standard deviation over frames [m].
        frame_range: mean over frames of p95 / p5 within the frame.
        gradient: mean absolute difference of pixels 1/40 of the width apart, relative to their depth.
        known: share of pixels with depth.
    """

    frames: int
    p5: float
    median: float
    p95: float
    mean: float
    frame_median: float
    frame_median_std: float
    frame_range: float
    gradient: float
    known: float


def depth_statistics(dataset: DepthDataset, frames: int = 256) -> DepthStatistics:
    """Measure evenly spaced frames, without augmentation, one at a time.

    The gradient is taken across 1/40 of the width, so that data sets of different resolution compare.

    Args:
        dataset: any adapter.
        frames: at most this many frames are read.

    Raises:
        ValueError: ``frames`` below 1, or no known depth in any frame.
    """
    if frames < 1:
        raise ValueError(f"frames={frames}: give at least 1")
    bins = int(np.ceil(dataset.max_depth * 100)) + 1  # of 1 cm: exact enough, and no pixel is kept
    histogram = np.zeros(bins, np.int64)
    medians, ranges, gradients, known = [], [], [], []
    for index in np.unique(np.linspace(0, len(dataset) - 1, min(frames, len(dataset))).astype(int)):
        depth = dataset.load_frame(int(index)).depth
        valid = (depth > 0) & (depth >= dataset.min_depth) & (depth <= dataset.max_depth)
        known.append(float(valid.mean()))
        if not valid.any():
            continue
        values = depth[valid]
        histogram += np.bincount((values * 100).astype(int), minlength=bins) * 1000000 // values.size
        low, middle, high = np.percentile(values, (5, 50, 95))
        medians.append(float(middle))
        ranges.append(float(high / low))
        gradients.append(_gradient(depth, valid))
    if not medians:
        raise ValueError(
            "no frame has a depth within min_depth..max_depth: check the data set's encoding and range"
        )
    share = np.cumsum(histogram) / histogram.sum()
    p5, median, p95 = ((np.searchsorted(share, q) + 0.5) / 100 for q in (0.05, 0.5, 0.95))
    mean = float((histogram * (np.arange(bins) + 0.5)).sum() / histogram.sum() / 100)
    return DepthStatistics(
        frames=len(known),
        p5=float(p5),
        median=float(median),
        p95=float(p95),
        mean=mean,
        frame_median=float(np.mean(medians)),
        frame_median_std=float(np.std(medians)),
        frame_range=float(np.mean(ranges)),
        gradient=float(np.mean(gradients)),
        known=float(np.mean(known)),
    )


def _gradient(depth: np.ndarray, valid: np.ndarray) -> float:
    step = max(1, depth.shape[1] // 40)
    total, count = 0.0, 0
    for a, b in ((np.s_[:, step:], np.s_[:, :-step]), (np.s_[step:], np.s_[:-step])):
        both = valid[a] & valid[b]
        difference = np.abs(depth[a] - depth[b])[both] / np.minimum(depth[a], depth[b])[both]
        total, count = total + float(difference.sum()), count + int(both.sum())
    return total / max(count, 1)


def contact_sheet(rooms: Rooms, across: int = 6, down: int = 3) -> np.ndarray:
    """Return evenly spaced frames, each image above its depth: ``(H, W, 3)`` uint8."""
    rows = []
    indices = iter(np.linspace(0, len(rooms) - 1, across * down).astype(int))
    for _ in range(down):
        frames = [rooms.load_frame(int(next(indices))) for _ in range(across)]
        rows.append(np.concatenate([frame.image for frame in frames], axis=1))
        rows.append(np.concatenate([color_depth(frame.depth, 0.5, 7.0) for frame in frames], axis=1))
    return stack_rows(rows)


def main() -> None:
    rooms = Rooms("test", 512, size=(120, 160))
    sets = {"rooms (test)": rooms}
    try:
        sets["NYU labeled (795 training frames)"] = NYULabelled(split="all", min_depth=0.1)
    except FileNotFoundError as error:
        print(f"NYU is left out: {error}")
    lines = [f"| data | {' | '.join(TITLES)} |", "|---|" + "---:|" * len(TITLES)]
    for name, dataset in sets.items():
        values = depth_statistics(dataset, 256)._asdict()
        lines.append(f"| {name} | " + " | ".join(f"{values[column]:.3f}" for column in COLUMNS) + " |")
    Image.fromarray(contact_sheet(rooms)).save(HERE / "rooms.jpg", quality=80)
    print("\n".join(lines))


if __name__ == "__main__":
    main()

"""What the depth and the colors of a data set look like, in a few numbers."""

from typing import NamedTuple

import numpy as np

from eldenet.data.base import DepthDataset


class ChannelSums:
    """Mean and standard deviation per channel over pictures that are added one by one."""

    def __init__(self) -> None:
        self.pixels = 0
        self.sums, self.squares = np.zeros(3), np.zeros(3)

    def add(self, image: np.ndarray) -> None:
        """Count a picture ``(H, W, 3)`` uint8: every sixteenth pixel says as much as all."""
        some = image[::4, ::4].reshape(-1, 3) / 255.0
        self.pixels += len(some)
        self.sums += some.sum(0)
        self.squares += np.square(some).sum(0)

    @property
    def mean(self) -> list[float]:
        """Per channel, RGB in [0, 1]; empty where nothing was added."""
        return (self.sums / self.pixels).tolist() if self.pixels else []

    @property
    def std(self) -> list[float]:
        """Likewise."""
        if not self.pixels:
            return []
        mean = self.sums / self.pixels
        return np.sqrt(np.maximum(self.squares / self.pixels - mean**2, 0)).tolist()


def channel_statistics(dataset: DepthDataset, *, frames: int = 512, seed: int = 0) -> ChannelSums:
    """Colors of at most ``frames`` frames as they lie on disk, drawn by ``seed``; nothing is augmented.

    Raises:
        ValueError: ``frames`` below 1, or a channel never changes: dividing by its deviation makes no sense.
    """
    if frames < 1:
        raise ValueError(f"frames={frames}: give at least 1")
    found = ChannelSums()
    for index in sorted(np.random.default_rng(seed).permutation(len(dataset))[:frames].tolist()):
        found.add(dataset.load_frame(index).image)
    if not min(found.std) > 1e-4:  # of one color, but for rounding
        raise ValueError(
            f"a color channel never changes in {min(frames, len(dataset))} frames (std {found.std}): "
            "are the pictures all of one color? Take normalization=imagenet"
        )
    return found


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

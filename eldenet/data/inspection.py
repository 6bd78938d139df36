"""Going through a data set before anything is trained on it: what is there, and what it looks like."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from eldenet.data.base import DepthDataset

# Bins of 1 % from 1 mm to 1 km: percentiles to half a per cent without keeping a pixel.
_EDGES = np.geomspace(1e-3, 1e3, 1390)
_PERCENTILES = (1, 5, 25, 50, 75, 95, 99)
HISTOGRAM_BINS = 20


@dataclass
class SplitCheck:
    """What one split of a data set holds.

    Attributes:
        split: its name.
        names: of the frames whose files are there.
        identities: of the same frames, see :func:`identities`.
        split_hash: of these names, as in ``run.json``.
        missing: name -> files that are not there.
        looked_at: how many frames were read.
        unreadable: name -> what is wrong with the file.
        without_depth: frames without one known depth.
        sizes: "H x W" of image and depth -> frames.
        histogram: ``(20,)`` pixels in equal steps of depth from 0 to ``max_depth``.
        percentiles: of known depth within the range [m].
        min_depth: nearest depth that counts [m].
        max_depth: farthest depth that counts [m].
        valid: share of pixels with depth within the range.
        outside: share of pixels whose depth is known but outside the range.
        with_intrinsics: frames read that have intrinsics.
        intrinsics: ``[fx, fy, cx, cy]`` of the first one [px].
        mean: of the images, per channel (RGB in [0, 1]).
        std: likewise.
        fault: why the split could not be opened at all.
    """

    split: str
    names: list[str] = field(default_factory=list)
    identities: dict[str, str] = field(default_factory=dict)
    split_hash: str = ""
    missing: dict[str, str] = field(default_factory=dict)
    looked_at: int = 0
    unreadable: dict[str, str] = field(default_factory=dict)
    without_depth: list[str] = field(default_factory=list)
    sizes: dict[str, int] = field(default_factory=dict)
    histogram: list[int] = field(default_factory=list)
    percentiles: dict[str, float] = field(default_factory=dict)
    min_depth: float = 0.0
    max_depth: float = 0.0
    valid: float = 0.0
    outside: float = 0.0
    with_intrinsics: int = 0
    intrinsics: list[float] | None = None
    mean: list[float] = field(default_factory=list)
    std: list[float] = field(default_factory=list)
    fault: str = ""

    @property
    def faults(self) -> list[str]:
        """What is wrong, a line each: ten names and how many there are."""
        lines = [f"{self.split}: {self.fault}"] if self.fault else []
        lines += _listed(self.split, "frames without all of their files", list(self.missing.values()))
        lines += _listed(self.split, "frames that cannot be read", list(self.unreadable.values()))
        lines += _listed(self.split, "frames without any depth in the range", self.without_depth)
        return lines

    def as_dict(self) -> dict[str, Any]:
        """For ``check.json``; the names are in the hash."""
        return {key: value for key, value in vars(self).items() if key not in ("names", "identities")} | {
            "frames": len(self.names),
            "faults": self.faults,
        }


def _listed(split: str, what: str, entries: Sequence[str], most: int = 10) -> list[str]:
    if not entries:
        return []
    more = [f"  ... and {len(entries) - most} more"] if len(entries) > most else []
    return [f"{split}: {len(entries)} {what}:", *(f"  {entry}" for entry in entries[:most]), *more]


def spread(count: int, wanted: int | None) -> list[int]:
    """At most ``wanted`` indices, evenly spread over ``count``; all of them for None."""
    wanted = count if wanted is None else min(wanted, count)
    return [int(i) for i in np.unique(np.linspace(0, count - 1, wanted).round())]


def check_split(
    split: str,
    dataset: DepthDataset,
    *,
    frames: int | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> SplitCheck:
    """Read a split from end to end, without augmentation, and note what is found; nothing stops it.

    Args:
        split: its name, for reports.
        dataset: built with ``on_error="skip"``, so that missing files are noted and not raised.
        frames: read at most this many, evenly spread; None reads all.
        advance: called with 1 per frame, for a progress bar.
    """
    found = SplitCheck(
        split, list(dataset.names), identities(dataset), dataset.split_hash, dict(dataset.skipped)
    )
    found.min_depth, found.max_depth = dataset.min_depth, dataset.max_depth
    sizes: Counter[str] = Counter()
    fine = np.zeros(len(_EDGES) - 1, np.int64)
    coarse = np.zeros(HISTOGRAM_BINS, np.int64)
    pixels = valid = outside = 0
    colors = ChannelSums()
    for index in spread(len(dataset), frames):
        advance(1)
        found.looked_at += 1
        try:
            image, depth, intrinsics, name, _ = dataset.load_frame(index)
        except (ValueError, OSError) as error:
            found.unreadable[dataset.names[index]] = str(error)
            continue
        sizes[f"{image.shape[0]} x {image.shape[1]}" + _other(depth.shape, image.shape)] += 1
        known = np.isfinite(depth) & (depth > 0)
        values = depth[known & (depth >= dataset.min_depth) & (depth <= dataset.max_depth)]
        if not values.size:
            found.without_depth.append(name)
        pixels, valid = pixels + depth.size, valid + values.size
        outside += int(known.sum()) - values.size
        fine += np.histogram(values, _EDGES)[0]
        coarse += np.histogram(values, HISTOGRAM_BINS, (0.0, dataset.max_depth))[0]
        colors.add(image)
        if intrinsics is not None:
            found.with_intrinsics += 1
            if found.intrinsics is None:
                found.intrinsics = [float(intrinsics[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]
    found.sizes = dict(sizes.most_common())
    found.histogram = coarse.tolist()
    found.valid, found.outside = valid / max(pixels, 1), outside / max(pixels, 1)
    if valid:
        share = np.cumsum(fine) / fine.sum()
        middles = np.sqrt(_EDGES[:-1] * _EDGES[1:])
        found.percentiles = {f"p{q}": float(middles[np.argmax(share >= q / 100)]) for q in _PERCENTILES}
    found.mean, found.std = colors.mean, colors.std
    return found


def _other(depth: tuple[int, ...], image: tuple[int, ...]) -> str:
    return "" if depth == image[:2] else f" (depth {depth[0]} x {depth[1]})"


def identities(dataset: DepthDataset) -> dict[str, str]:
    """What tells each frame from those of other splits -> its name: two folders may hold frames of one name.

    That is the name with the files that the frame is read from, where its adapter says them.
    """
    found = {}
    for index, name in enumerate(dataset.names):
        try:
            files = dataset.frame_files(index)
        except ValueError:
            files = ()
        found["\n".join([name, *map(str, files)])] = name
    return found


def shared_frames(checks: Sequence[SplitCheck]) -> list[str]:
    """Splits that share frames, and which ones: the first ten of each pair."""
    lines = []
    for one, other in combinations(checks, 2):
        both = sorted(one.identities[key] for key in one.identities.keys() & other.identities.keys())
        lines += _listed(f"{one.split} and {other.split}", "frames are in both", both)
    return lines


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

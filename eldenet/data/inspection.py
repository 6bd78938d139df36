"""Going through a data set before anything is trained on it: what is there, and what it looks like."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from eldenet.data.base import DepthDataset
from eldenet.data.statistics import ChannelSums

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

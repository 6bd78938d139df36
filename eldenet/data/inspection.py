"""Inspect a data set before training on it: what is there, what is wrong, and what it looks like."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from eldenet.configurable import instantiate
from eldenet.data.base import DepthDataset
from eldenet.data.io import ENCODINGS, Encoding, depth_encoding
from eldenet.data.mix import Mix
from eldenet.data.splits import SPLITS, evenly_spaced, same_splits, subset_of
from eldenet.geometry import four_numbers

PLAUSIBLE = (0.3, 60.0)  # median depth of a data set [m]: a desk, a street
ENOUGH_ALONE = 20  # frames of a split; fewer, which follow each other, prove nothing
LEAST_FRAMES, MOST_FARTHER = 5, 0.6  # frames; share of them that is farther below (real depth: up to 0.25)
# Bins of 1 % from 1 mm to 1 km: percentiles to half a percent without keeping a pixel.
_EDGES = np.geomspace(1e-3, 1e3, 1390)
_PERCENTILES = (1, 5, 25, 50, 75, 95, 99)
HISTOGRAM_BINS = 16
Bar = Callable[[str, int], AbstractContextManager[Any]]


@dataclass
class SplitCheck:
    """What one split of a data set holds."""

    split: str
    names: list[str] = field(default_factory=list)  # of the frames whose files exist
    identities: dict[str, str] = field(default_factory=dict)  # of the same frames, see identities()
    split_hash: str = ""  # of these names, as in run.json
    missing: dict[str, str] = field(default_factory=dict)  # name -> missing files
    looked_at: int = 0  # how many frames were read
    unreadable: dict[str, str] = field(default_factory=dict)  # name -> what is wrong with the file
    without_depth: list[str] = field(default_factory=list)  # frames without any known depth
    sizes: dict[str, int] = field(default_factory=dict)  # "H x W" of image and depth -> number of frames
    # (HISTOGRAM_BINS,) pixels in equal steps of depth from 0 to max_depth
    histogram: list[int] = field(default_factory=list)
    percentiles: dict[str, float] = field(default_factory=dict)  # of known depth within the range [m]
    median: float | None = None  # of all depth, also of what lies outside the range [m]; None: there is none
    # of the frames with depth at the top and at the bottom, how many are farther at the bottom, and how many
    # are not
    farther_below: list[int] = field(default_factory=lambda: [0, 0])
    min_depth: float = 0.0  # nearest depth that counts as known [m]
    max_depth: float = 0.0  # farthest depth that counts as known [m]
    valid: float = 0.0  # share of pixels with depth within the range
    outside: float = 0.0  # share of pixels with depth outside the range
    with_intrinsics: int = 0  # how many of the frames read have intrinsics
    intrinsics: list[float] | None = None  # [fx, fy, cx, cy] of the first one [px]
    mean: list[float] = field(default_factory=list)  # of the images, per channel (RGB in [0, 1])
    std: list[float] = field(default_factory=list)  # of the images, per channel
    fault: str = ""  # why the split could not be opened at all

    @property
    def faults(self) -> list[str]:
        """What is wrong, one line each: up to ten names and how many there are."""
        lines = [f"{self.split}: {self.fault}"] if self.fault else []
        lines += _listed(self.split, "frames without all of their files", list(self.missing.values()))
        lines += _listed(self.split, "frames that cannot be read", list(self.unreadable.values()))
        lines += _listed(self.split, "frames without any depth in the range", self.without_depth)
        return lines

    def as_dict(self) -> dict[str, Any]:
        """Return the fields for ``check.json``, without the names, which the hash covers."""
        return {key: value for key, value in vars(self).items() if key not in ("names", "identities")} | {
            "frames": len(self.names),
            "faults": self.faults,
        }


@dataclass
class DataCheck:
    """What :func:`check_data` found."""

    splits: list[SplitCheck] = field(default_factory=list)  # one check each
    faults: list[str] = field(default_factory=list)  # everything that is wrong, one line each
    # titled pictures for a contact sheet: image over depth
    panels: list[tuple[str, np.ndarray]] = field(default_factory=list)


def check_splits(
    data: Mapping[str, Any],
    check_ground_truth: Callable[[str], None],
    bar: Bar,
    *,
    frames: int | None = None,
    samples: int = 0,
) -> DataCheck:
    """Read every split and note what is wrong, without stopping at a fault.

    Args:
        data: settings of the data set; splits with the same settings are read once.
        check_ground_truth: raises ValueError if the protocol cannot score this kind of ground truth.
        bar: opens a progress bar with a title and a total; its ``advance`` is called with 1 per frame.
        frames: read at most this many frames of each split, evenly spread; None: all.
        samples: frames of each split on the contact sheet.
    """
    found, refused, same = DataCheck(), [], same_splits(data)
    for split in (name for name in SPLITS if data.get(name) is not None and name not in same):
        try:
            dataset = _open(data, split)
        except (ValueError, OSError) as error:
            found.splits.append(SplitCheck(split, fault=str(error)))
            continue
        total = len(evenly_spaced(len(dataset.names), frames))
        with bar(f"checking {split}", total) as progress:
            check = check_split(split, dataset, frames=frames, advance=progress.advance)
        found.splits.append(check)
        found.panels += _samples(dataset, samples, check)
        if split != "train":
            try:
                check_ground_truth(dataset.ground_truth)
            except ValueError as error:
                refused.append(f"{split}: {error}")
    found.faults = [line for check in found.splits for line in check.faults]
    found.faults += refused + shared_frames(found.splits)
    return found


def _open(data: Mapping[str, Any], split: str) -> DepthDataset:
    """Open a split as it is on disk; what cannot be read is listed, not refused."""
    settings, subset = data[split], subset_of(data).get(split)
    changes = {"on_error": "skip"} if "on_error" in settings else {}
    dataset: DepthDataset = instantiate(settings, f"data.{split}", **changes)
    if subset is not None:
        dataset.draw_subset(subset, data.get("subset_seed", 0))
    return dataset


def _samples(dataset: DepthDataset, wanted: int, found: SplitCheck) -> list[tuple[str, np.ndarray]]:
    """Titled pictures of evenly spread frames that can be read."""
    from eldenet.visualization import image_over_depth

    readable = [i for i, name in enumerate(dataset.names) if name not in found.unreadable]
    panels = []
    for at in evenly_spaced(len(readable), wanted) if readable and wanted else []:
        try:
            frame = dataset.load_frame(readable[at])
        except (ValueError, OSError):  # with frames=..., not every frame was tried before
            continue
        picture = image_over_depth(frame.image, frame.depth, dataset.max_depth)
        panels.append((f"{found.split}  {frame.name}", picture))
    return panels


def _listed(split: str, what: str, entries: Sequence[str]) -> list[str]:
    """Return a title line and the first ten entries, one line each; nothing without entries."""
    if not entries:
        return []
    more = [f"  ... and {len(entries) - 10} more"] if len(entries) > 10 else []
    return [f"{split}: {len(entries)} {what}:", *(f"  {entry}" for entry in entries[:10]), *more]


def check_split(
    split: str,
    dataset: DepthDataset,
    *,
    frames: int | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> SplitCheck:
    """Read a split without augmentation and note what it holds; no fault stops it.

    ``dataset`` is built with ``on_error="skip"``, so that missing files are noted and raise no error.
    ``frames`` is that of :func:`check_splits`; ``advance`` is called with 1 per frame.
    """
    found = SplitCheck(
        split, list(dataset.names), identities(dataset), dataset.split_hash, dict(dataset.skipped)
    )
    found.min_depth, found.max_depth = dataset.min_depth, dataset.max_depth
    sizes: Counter[str] = Counter()
    fine, all_known = np.zeros((2, len(_EDGES) - 1), np.int64)
    coarse = np.zeros(HISTOGRAM_BINS, np.int64)
    pixels = valid = outside = 0
    colors = ChannelSums()
    for index in evenly_spaced(len(dataset.names), frames):
        advance(1)
        found.looked_at += 1
        try:
            image, depth, intrinsics, name, _ = dataset.read_frame(index)
        except (ValueError, OSError) as error:
            found.unreadable[dataset.names[index]] = str(error)
            continue
        other = "" if depth.shape == image.shape[:2] else f" (depth {depth.shape[0]} x {depth.shape[1]})"
        sizes[f"{image.shape[0]} x {image.shape[1]}{other}"] += 1
        known = np.isfinite(depth) & (depth > 0)
        values = depth[known & (depth >= dataset.min_depth) & (depth <= dataset.max_depth)]
        if not values.size:
            found.without_depth.append(name)
        if (below := is_farther_below(depth)) is not None:
            found.farther_below[0 if below else 1] += 1
        pixels, valid = pixels + depth.size, valid + values.size
        outside += int(known.sum()) - values.size
        fine += np.histogram(values, _EDGES)[0]
        all_known += np.histogram(depth[known], _EDGES)[0]
        coarse += np.histogram(values, HISTOGRAM_BINS, (0.0, dataset.max_depth))[0]
        colors.add(image)
        if intrinsics is not None:
            found.with_intrinsics += 1
            if found.intrinsics is None:
                found.intrinsics = four_numbers(intrinsics)
    found.sizes = dict(sizes.most_common())
    found.histogram = coarse.tolist()
    found.valid, found.outside = valid / max(pixels, 1), outside / max(pixels, 1)
    middles = np.sqrt(_EDGES[:-1] * _EDGES[1:])
    if all_known.any():
        found.median = float(middles[np.argmax(np.cumsum(all_known) >= all_known.sum() / 2)])
    if valid:
        share = np.cumsum(fine) / fine.sum()
        found.percentiles = {f"p{q}": float(middles[np.argmax(share >= q / 100)]) for q in _PERCENTILES}
    found.mean, found.std = colors.mean, colors.std
    return found


def encoding_of(encoding: Encoding, split: str) -> Encoding:
    """The encoding of a split, where a data set has one for training frames and one for test frames."""
    if isinstance(encoding, Mapping) and "train" in encoding:
        return str(encoding["test" if split == "test" else "train"])
    return encoding


def unit_doubts(median: float, encoding: Encoding) -> tuple[str, bool]:
    """What a median depth [m] would be in other encodings, as a line, and whether it is implausible."""
    own = depth_encoding(encoding)
    others = {
        row.name: median * row.scale / own.scale
        for row in ENCODINGS.values()
        if row.dtype == own.dtype == "uint16" and row.decode is None and row.scale != own.scale
    }
    implausible = not PLAUSIBLE[0] <= median <= PLAUSIBLE[1]
    line = f"half of all depth is nearer than {median:.3g} m, read as encoding={own.name}"
    if implausible:
        others = {name: at for name, at in others.items() if PLAUSIBLE[0] <= at <= PLAUSIBLE[1]}
        line += ", which few cameras see"
    if others:
        line += "; it would be " + ", ".join(f"{at:.3g} m as {name}" for name, at in others.items())
    return line, implausible


def is_farther_below(depth: np.ndarray) -> bool | None:
    """Whether the bottom third of a map ``(H, W)`` is farther than its top third; None: one has no depth."""
    third = depth.shape[0] // 3
    top, bottom = (part[np.isfinite(part) & (part > 0)] for part in (depth[:third], depth[-third:]))
    return bool(np.median(bottom) > np.median(top)) if top.size and bottom.size else None


def inverse_doubts(counts: Mapping[str, Sequence[int]]) -> list[str]:
    """Return the lines of :func:`inverse_doubt` about splits of enough frames, or else about all together.

    ``counts`` has the numbers of frames that are farther below, and that are not, by split.
    """
    large = {name: count for name, count in counts.items() if sum(count) >= ENOUGH_ALONE}
    together = {
        "all splits": (sum(each[0] for each in counts.values()), sum(each[1] for each in counts.values()))
    }
    lines = {name: inverse_doubt(*count) for name, count in (large or together).items()}
    return [f"{name}: {line}" for name, line in lines.items() if line]


def inverse_doubt(farther: int, others: int) -> str:
    """Return a line if most frames are farther at the bottom, where a camera sees the floor; else ""."""
    if farther + others < LEAST_FRAMES or farther < MOST_FARTHER * (farther + others):
        return ""
    return (
        f"in {farther} of {farther + others} frames the bottom is farther than the top: is it inverse depth "
        "or disparity? Convert it to depth first"
    )


def identities(dataset: DepthDataset) -> dict[str, str]:
    """Return a key for each frame -> its name. Frames with one key are the same frame, in any split.

    The key is the name and, if the adapter knows them, the files: two folders may use the same names.
    """
    if isinstance(dataset, Mix):
        parts = [identities(source.dataset) for source in dataset.sources.values()]
        return {key: name for part in parts for key, name in part.items()}
    found = {}
    for index, name in enumerate(dataset.names):
        try:
            files = dataset.frame_files(index)
        except ValueError:
            files = ()
        found["\n".join([name, *map(str, files)])] = name
    return found


def shared_frames(checks: Sequence[SplitCheck]) -> list[str]:
    """Name the splits that share frames, and the first ten frames of each pair."""
    lines = []
    for one, other in combinations(checks, 2):
        both = sorted(one.identities[key] for key in one.identities.keys() & other.identities.keys())
        lines += _listed(f"{one.split} and {other.split}", "frames are in both", both)
    return lines


class ChannelSums:
    """Mean and standard deviation per channel over pictures added one by one."""

    def __init__(self) -> None:
        self.pixels = 0
        self.sums, self.squares = np.zeros(3), np.zeros(3)

    def add(self, image: np.ndarray) -> None:
        """Add a picture ``(H, W, 3)`` uint8; every sixteenth pixel is enough."""
        some = image[::4, ::4].reshape(-1, 3) / 255.0
        self.pixels += len(some)
        self.sums += some.sum(0)
        self.squares += np.square(some).sum(0)

    @property
    def mean(self) -> list[float]:
        """Per channel, RGB in [0, 1]; empty if nothing was added."""
        return (self.sums / self.pixels).tolist() if self.pixels else []

    @property
    def std(self) -> list[float]:
        """Per channel, RGB in [0, 1]; empty if nothing was added."""
        if not self.pixels:
            return []
        mean = self.sums / self.pixels
        return np.sqrt(np.maximum(self.squares / self.pixels - mean**2, 0)).tolist()


def channel_statistics(dataset: DepthDataset, *, frames: int = 512) -> ChannelSums:
    """Measure the colors of at most ``frames`` frames on disk, always the same; nothing is augmented.

    Raises:
        ValueError: a channel is constant, so images cannot be divided by its std.
    """
    found, count = ChannelSums(), len(dataset.names)
    for index in sorted(np.random.default_rng(0).permutation(count)[:frames].tolist()):
        found.add(dataset.load_frame(index).image)
    if not min(found.std) > 1e-4:  # constant but for rounding
        raise ValueError(
            f"a color channel is constant over {min(frames, count)} frames (std {found.std}): check "
            "the pictures, or set normalization=imagenet"
        )
    return found

"""The parts of a data set: their settings, and validation frames held out of a training part.

Whole scenes are held out, the same ones on every machine: neighboring frames of a recording look nearly the
same, so a frame-by-frame split would validate on what was trained.
"""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from eldenet.data.paths import natural_order
from eldenet.system.digests import digest_of

SPLITS = ("train", "val", "test")
VAL_SHARE = 0.05


def scene_of(name: str) -> str:
    """Return the scene of a frame's name: its folder, without suffixes that do not change the place.

    ``kitchen_0001a/rgb_00012``, ``train/kitchen_0001b/00001`` and ``kitchen_0001a_out/12`` all belong to
    ``kitchen_0001``: NYU's letters number the recordings of one place, DenseDepth adds ``_out``. KITTI's
    scenes are its drives, ``2011_09_26_drive_0001_sync``.
    """
    if drive := re.match(r"\d{4}_\d\d_\d\d_drive_\d+_\w+", name):
        return drive[0]
    folder = PurePosixPath(name).parent.name.removesuffix("_out")
    return re.sub(r"(?<=\d)[a-z]$", "", folder)


def hold_out(names: Sequence[str], split: str) -> list[int]:
    """Return the indices of the frames of ``split``: "train" and "val" share no scene, others take all.

    A scene is for validation if the first 64 bits of its name's SHA-256 are below 5 % of their range. So all
    layouts of one data set hold out the same scenes. If that leaves one side empty (few scenes), the scene
    nearest to the threshold changes sides.

    Raises:
        ValueError: there is only one scene to split.
    """
    if split not in ("train", "val"):
        return list(range(len(names)))
    scenes = [scene_of(name) for name in names]
    place = {one: _place(one) for one in scenes}
    if len(place) == 1:
        raise ValueError(
            f"all {len(names)} frames come from the scene {scenes[0]!r}, so none can be held out: use the "
            "split that takes every frame"
        )
    chosen = {one for one in place if place[one] < VAL_SHARE}
    if place and not chosen:
        chosen = {min(place, key=place.__getitem__)}
    elif place and len(chosen) == len(place):
        chosen.remove(max(place, key=place.__getitem__))
    return [index for index, one in enumerate(scenes) if (one in chosen) == (split == "val")]


def _place(scene: str) -> float:
    """A number in [0, 1) that depends on the name alone."""
    return int(digest_of(scene)[:16], 16) / 2**64


def val_blocks(count: int, fraction: float, blocks: int, gap: int, seed: int) -> tuple[list[int], list[int]]:
    """Return the numbers of ``count`` frames for validation, and of those beside them that are in no part.

    Frames are in the order of time; the settings are those of :class:`~eldenet.data.folder.FolderDataset`.

    Raises:
        ValueError: the settings are out of range, or there is one frame.
    """
    if not 0.0 < fraction < 1.0 or blocks < 2 or gap < 0:
        raise ValueError(
            f"val_fraction={fraction}, blocks={blocks}, gap={gap}: give a fraction between 0 and 1, at least "
            "2 blocks and a gap of at least 0"
        )
    if count < 2:
        raise ValueError(
            f"{count} frame cannot be split: give more for a training, or score it with data.test_split=all"
        )
    parts = np.array_split(np.arange(count), min(blocks, count))
    val = {int(i) for part in _drawn(len(parts), fraction, seed) for i in parts[part]}
    beside = {i + step for i in val for step in range(-gap, gap + 1)} - val
    return sorted(val), sorted(i for i in beside if 0 <= i < count)


def val_scenes(scenes: Sequence[str], fraction: float, seed: int) -> list[int]:
    """Return the numbers of frames for validation, whole scenes; none if there are not several scenes.

    ``scenes`` are those of each frame, "" if not known; whole ones are drawn by ``seed``.
    """
    kinds = sorted(set(scenes), key=natural_order)
    if len(kinds) < 2 or not 0.0 < fraction < 1.0:
        return []
    val = {kinds[i] for i in _drawn(len(kinds), fraction, seed)}
    return [i for i, scene in enumerate(scenes) if scene in val]


def _drawn(count: int, fraction: float, seed: int) -> list[int]:
    """The numbers of the parts for validation: at least one, not all."""
    drawn = np.random.default_rng(seed).permutation(count)
    return sorted(drawn[: min(max(1, round(fraction * count)), count - 1)].tolist())


def evenly_spaced(count: int, wanted: int | None) -> list[int]:
    """Return at most ``wanted`` of ``count`` indices, first and last among them; all of them for None."""
    wanted = count if wanted is None else min(wanted, count)
    return [int(i) for i in np.unique(np.linspace(0, count - 1, wanted).round())]


def split_settings(data: Mapping[str, Any], split: str) -> Mapping[str, Any]:
    """Return the settings of one part of a data set, with its class as ``_target_``.

    Raises:
        ValueError: the data set has no such part.
    """
    settings = data.get(split)
    if not isinstance(settings, Mapping):
        raise ValueError(f"data={data['name']} has no split '{split}': choose train, val or test")
    if "_target_" not in settings:  # a part of ${data.val} was overridden, so nothing else is left
        raise ValueError(
            f"data.{split} in data={data['name']} refers to another split's settings: override "
            f"those (data.val...), or give every setting of data.{split}"
        )
    return settings


def subset_of(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return how many frames of each split are used; a split without an entry uses all.

    Raises:
        ValueError: ``data.subset`` is no table.
    """
    subset = data.get("subset") or {}
    if not isinstance(subset, Mapping):
        raise ValueError(f"data.subset={subset}: give it per split, data.subset.train={subset}")
    return subset


def same_splits(data: Mapping[str, Any]) -> dict[str, str]:
    """Return each split that is an earlier one again -> that one: "test" -> "val" without a third part."""
    subset = subset_of(data)
    same: dict[str, str] = {}
    for place, split in enumerate(SPLITS):
        for first in SPLITS[:place]:
            if data.get(split) is not None and (data.get(first), subset.get(first)) == (
                data[split],
                subset.get(split),
            ):
                same.setdefault(split, first)
    return same


def check_folders(data: Mapping[str, Any]) -> None:
    """Raise FileNotFoundError if no split's folder exists: a mistake in ``data.root`` then costs no imports.

    Rendered data sets, which have no ``on_error``, make their folder themselves.
    """
    splits = [data.get(split) for split in SPLITS]
    roots = [part.get("root") for part in splits if isinstance(part, Mapping) and "on_error" in part]
    if not roots or any(root is not None and Path(root).expanduser().is_dir() for root in roots):
        return
    sources = data.get("sources", {})  # of a mix, whose first data set on disk has these splits
    on_disk = [f"data.sources.{name}.data.root" for name in sources if "on_error" in sources[name]["data"]]
    setting = [*on_disk, "data.root"][0]
    if roots[0] is not None:
        raise FileNotFoundError(f"{roots[0]} is not a folder: set {setting} to the data set's folder")
    if not os.environ.get("ELDENET_DATA"):
        raise FileNotFoundError(f"no folder given for the data set: set {setting}, or ELDENET_DATA")

"""Validation frames held out of a training part by whole scenes, the same ones on every machine.

Neighboring frames of a recording look nearly the same: a frame-by-frame split would validate on what was
trained.
"""

import hashlib
import re
from collections.abc import Callable, Sequence
from pathlib import PurePosixPath

import numpy as np

VAL_SHARE = 0.05


def scene_of(name: str) -> str:
    """Return the scene of a frame's name: its folder, without suffixes that do not change the place.

    ``kitchen_0001a/rgb_00012``, ``train/kitchen_0001b/00001`` and ``kitchen_0001a_out/12`` all belong to
    ``kitchen_0001``: NYU's letters number the recordings of one place, DenseDepth adds ``_out``.
    """
    folder = PurePosixPath(name).parent.name.removesuffix("_out")
    return re.sub(r"(?<=\d)[a-z]$", "", folder)


def hold_out(names: Sequence[str], split: str, scene: Callable[[str], str] = scene_of) -> list[int]:
    """Return the indices of the frames of ``split``: "train" and "val" share no scene, others take all.

    A scene is for validation if the first 64 bits of its name's SHA-256 are below 5 % of their range. So all
    layouts of one data set hold out the same scenes. If that leaves one side empty (few scenes), the scene
    nearest to the threshold changes sides.

    Args:
        names: of the frames.
        split: "train", "val" or anything else.
        scene: returns the scene of a frame's name.

    Raises:
        ValueError: there is only one scene to split.
    """
    if split not in ("train", "val"):
        return list(range(len(names)))
    scenes = [scene(name) for name in names]
    place = {one: _place(one) for one in scenes}
    if len(place) == 1:
        raise ValueError(
            f"all {len(names)} frames come from the scene {scenes[0]!r}, so none can be held out: use "
            "the split "
            "that takes every frame"
        )
    chosen = {one for one in place if place[one] < VAL_SHARE}
    if place and not chosen:
        chosen = {min(place, key=place.__getitem__)}
    elif place and len(chosen) == len(place):
        chosen.remove(max(place, key=place.__getitem__))
    return [index for index, one in enumerate(scenes) if (one in chosen) == (split == "val")]


def _place(scene: str) -> float:
    """A number in [0, 1) that depends on the name alone."""
    return int.from_bytes(hashlib.sha256(scene.encode()).digest()[:8], "big") / 2**64


def evenly_spaced(count: int, wanted: int | None) -> list[int]:
    """Return at most ``wanted`` of ``count`` indices, first and last among them; all of them for None."""
    wanted = count if wanted is None else min(wanted, count)
    return [int(i) for i in np.unique(np.linspace(0, count - 1, wanted).round())]

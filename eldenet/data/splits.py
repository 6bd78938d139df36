"""Validation frames held out of a training part by whole scenes, the same ones on every machine.

Neighbors in a recording show nearly the same: a frame-by-frame split would validate on what was trained.
"""

import hashlib
import re
from collections.abc import Callable, Sequence
from pathlib import PurePosixPath

VAL_SHARE = 0.05


def scene_of(name: str) -> str:
    """The scene that a frame's name belongs to: its folder, without what does not change the place.

    ``kitchen_0001a/rgb_00012``, ``train/kitchen_0001b/00001`` and ``kitchen_0001a_out/12`` are all of
    ``kitchen_0001``: NYU's letters number the recordings of one place, DenseDepth adds ``_out``.
    """
    folder = PurePosixPath(name).parent.name.removesuffix("_out")
    return re.sub(r"(?<=\d)[a-z]$", "", folder)


def hold_out(names: Sequence[str], split: str, scene: Callable[[str], str] = scene_of) -> list[int]:
    """Indices of the frames of ``split`` ("train" or "val"); no scene is in both.

    A scene is for validation if the first 64 bits of its name's SHA-256 are below 5 % of their range. So it
    depends on nothing else, and the layouts of one data set hold out the same scenes. Where that would
    leave one side empty (a few scenes only), the scene nearest to the threshold changes sides.
    ``scene`` gives a name's scene where the folder's name does not.

    Raises:
        ValueError: there is but one scene.
    """
    scenes = [scene(name) for name in names]
    place = {one: _place(one) for one in scenes}
    if len(place) == 1:
        raise ValueError(
            f"all {len(names)} frames are of the scene {scenes[0]!r}, so none can be held out: use the split "
            "that takes every frame"
        )
    chosen = {one for one in place if place[one] < VAL_SHARE}
    if place and not chosen:
        chosen = {min(place, key=place.__getitem__)}
    elif place and len(chosen) == len(place):
        chosen.remove(max(place, key=place.__getitem__))
    return [index for index, one in enumerate(scenes) if (one in chosen) == (split == "val")]


def _place(scene: str) -> float:
    """A number in [0, 1) that only the name decides."""
    return int.from_bytes(hashlib.sha256(scene.encode()).digest()[:8], "big") / 2**64

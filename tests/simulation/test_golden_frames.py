"""Rendered frames change only together with their version, on any machine.

After an intended change: raise the version beside the generator, then write the new golden files with
``python tests/simulation/test_golden_frames.py`` and look at them. It leaves existing files alone.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.scripts import load_scripts

from eldenet.data.arenas import Arenas
from eldenet.data.rooms import Rooms
from eldenet.data.scene_store import encode_depth
from eldenet.data.streets import Streets
from eldenet.simulation.arena_view import render_arena
from eldenet.simulation.furnished_rooms.render import render_room
from eldenet.simulation.street_views import STREETS_VERSION, render_street

GOLDEN = Path(__file__).parent / "golden"
SIZE = (96, 128)  # (height, width)
Frames = dict[str, np.ndarray]


def rooms(detail: bool = False) -> Frames:
    names = (("train", 0), ("test", 7))
    views = [render_room(split, index, SIZE, 2, detail=detail) for split, index in names]
    return stacked([view.image for view in views], [view.depth for view in views])


def arenas(detail: bool = False) -> Frames:
    names = (("train", 1), ("test", 3))
    views = [render_arena(split, index, SIZE, 2, detail=detail) for split, index in names]
    return stacked([view.image for view in views], [view.depth for view in views])


def streets(detail: bool = False) -> Frames:
    kinds = ((0, "street"), (1, "hall"))
    views = [render_street("test", index, (96, 312), kind, detail=detail) for index, kind in kinds]
    frames = stacked([view.image[None] for view in views], [view.depth[None] for view in views])
    if detail:
        return frames
    (views_of_objects,) = load_scripts("detector", "object_views")
    return frames | {"room_image": views_of_objects.render_objects("test", 2, (96, 312), "room").image[None]}


def stacked(images: list[np.ndarray], depths: list[np.ndarray]) -> Frames:
    return {"image": np.concatenate(images), "depth": encode_depth(np.minimum(np.concatenate(depths), 13.0))}


GENERATORS: dict[str, tuple[int, Callable[[], Frames]]] = {
    "rooms": (Rooms.generator.version, rooms),
    "arenas": (Arenas.generator.version, arenas),
    "streets": (STREETS_VERSION, streets),
    "rooms-detail": (Rooms.detailed.version, partial(rooms, detail=True)),
    "arenas-detail": (Arenas.detailed.version, partial(arenas, detail=True)),
    "streets-detail": (Streets.detailed.version, partial(streets, detail=True)),
}


@pytest.mark.parametrize("name", GENERATORS)
def test_frames_change_only_together_with_their_version(name: str) -> None:
    version, render = GENERATORS[name]
    golden, frames = np.load(GOLDEN / f"{name}-v{version}.npz"), render()
    assert set(golden) == set(frames)
    for key, wanted in golden.items():
        difference = np.abs(frames[key].astype(int) - wanted.astype(int))
        limit = 10 if key == "depth" else 2  # 2 mm; 2 of 255 gray levels
        # a ray that grazes an edge may hit or miss it by the last digit of a float
        share = (difference > limit).mean()
        assert share < 0.005, f"{share:.1%} of {name}'s {key} values changed: raise the version (see above)"


if __name__ == "__main__":
    for generator, (version, render) in GENERATORS.items():
        if (GOLDEN / f"{generator}-v{version}.npz").exists():
            continue
        np.savez_compressed(GOLDEN / f"{generator}-v{version}.npz", **render())

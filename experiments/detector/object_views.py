"""Rendered images of any kind of scene with the 2D boxes of their objects, for a detector."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.geometry import extent_of
from eldenet.simulation.arena_view import arena_photos, simulated_detections
from eldenet.simulation.furnished_rooms.render import KINECT, choose_pose, draw_intrinsics
from eldenet.simulation.furnished_rooms.rooms import SPLITS, generate_room
from eldenet.simulation.rendering.camera import RayCamera
from eldenet.simulation.rendering.camera_noise import develop
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import CompiledRoom
from eldenet.simulation.street_views import BOX_NAMES, render_street
from eldenet.system.checks import one_of

#: Kinds of scenes for a 2D detector, and what it finds there.
OBJECTS = {
    "street": ("car", "van", "truck", "person", "pillar"),
    "crossing": ("car", "van", "truck", "person", "pillar", "cyclist"),
    "hall": ("person", "box", "pillar"),
    "room": ("person", "furniture"),
    "arena": ("cylinder", "person", "box", "vehicle"),
}
_ROOM_STREAM = 8  # of the cameras in rooms; streets and halls have their own
_MIN_PIXELS_ROOM = 60
_MIN_VISIBLE = 0.25  # share of an object that a 2D detector can learn from
_MIN_SIDE = 6.0  # of its box [px]


def names_of(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return the names of all objects in some kinds of scenes.

    Raises:
        ValueError: an unknown kind.
    """
    for kind in kinds:
        one_of("kinds", kind, OBJECTS)
    found = {name for kind in kinds for name in OBJECTS[kind]}
    return tuple(name for name in (*BOX_NAMES, "cylinder", "vehicle") if name in found)


class ObjectView(NamedTuple):
    """One frame for a 2D detector.

    Attributes:
        image: ``(H, W, 3)`` uint8 RGB.
        detections: boxes around the visible pixels of the objects.
    """

    image: np.ndarray
    detections: Detections2D


def render_objects(
    split: str, index: int, size: tuple[int, int], kind: str, *, focal: tuple[float, float] | None = None
) -> ObjectView:
    """Render frame ``index`` of a split and kind at ``(height, width)`` [px] for a 2D detector.

    Objects that are mostly hidden or smaller than a few pixels are left out. Classes are those of
    ``OBJECTS``; everything but people is "furniture" in a room. ``focal`` is a range of
    fx [widths], of which each frame draws its own; None: the lens of its kind. Arenas are always seen by the
    robot's own camera.
    """
    if kind == "arena":
        arena, _, photo = next(arena_photos(split, index, size, 1))
        return ObjectView(photo.image, _large_enough(simulated_detections(photo, arena)))
    if kind == "room":
        return _render_room(split, index, size, focal or KINECT)
    view = render_street(split, index, size, kind, focal=focal)
    return ObjectView(view.image, _large_enough(view.detections.select(view.visible >= _MIN_VISIBLE)))


def _render_room(split: str, index: int, size: tuple[int, int], focal: tuple[float, float]) -> ObjectView:
    room = CompiledRoom(generate_room(split, index))
    draw = Draw((_ROOM_STREAM, SPLITS[split], index))
    camera = RayCamera(size, draw_intrinsics(draw, size, focal))
    linear, hits = room.photograph(camera, *choose_pose(room, camera, draw))
    image = develop(linear, draw, (_ROOM_STREAM, SPLITS[split], index, 1))
    body = np.append(room.model.geom_bodyid, 0)[hits.geom].reshape(size)  # -1 is the last: nothing was met
    boxes, labels = [], []
    for number, maker in room.room.pieces.items():
        rows, columns = np.nonzero(body == number)
        if len(rows) >= _MIN_PIXELS_ROOM:
            boxes.append(extent_of(rows, columns))
            labels.append(OBJECTS["room"].index("person" if maker == "person" else "furniture"))
    xyxy, label = np.array(boxes, float).reshape(-1, 4), np.array(labels, np.int64)
    return ObjectView(image, _large_enough(Detections2D(xyxy, np.ones(len(xyxy)), label, OBJECTS["room"])))


def _large_enough(found: Detections2D) -> Detections2D:
    """Return the boxes without the smallest."""
    return found.select((found.xyxy[:, 2:] - found.xyxy[:, :2] >= _MIN_SIDE).all(1))

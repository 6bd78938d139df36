"""Pictures of streets, halls and rooms with the 2D box of every object: what a detector learns from."""

from typing import NamedTuple

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.geometry import extent_of
from eldenet.simulation.furnished_rooms.render import choose_pose, draw_intrinsics
from eldenet.simulation.furnished_rooms.rooms import SPLITS, generate_room
from eldenet.simulation.rendering.camera import RayCamera
from eldenet.simulation.rendering.camera_noise import develop
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import Surfaces, shade
from eldenet.simulation.street_views import render_street
from eldenet.simulation.streets import NAMES as STREET_NAMES

KINDS = ("street", "hall", "room")
NAMES = (*STREET_NAMES, "furniture")
STREAM = 8  # of the rooms' cameras here; streets and halls have their own
_LEAST_VISIBLE = 0.25  # share of an object that must be seen
_LEAST_SIDE = 6.0  # [px]
_LEAST_PIXELS = 60


class ObjectView(NamedTuple):
    """One picture.

    Attributes:
        image: ``(H, W, 3)`` uint8 RGB.
        detections: the objects, boxes around what is seen of them.
    """

    image: np.ndarray
    detections: Detections2D


def render_objects(split: str, index: int, size: tuple[int, int], kind: str) -> ObjectView:
    """Picture ``index`` of a split and kind at ``(height, width)`` [px].

    Objects that are nearly hidden or smaller than a few pixels are left out. The shared classes keep the
    numbers they have in streets; everything else that stands in a room is "furniture".

    Raises:
        ValueError: unknown kind or split.
    """
    if kind not in KINDS:
        raise ValueError(f"kind={kind!r}: give one of {KINDS}")
    if kind == "room":
        return _room(split, index, size)
    view = render_street(split, index, size, kind)
    found = view.detections.select(view.visible >= _LEAST_VISIBLE)
    return ObjectView(view.image, _large_enough(found.xyxy, found.label))


def _room(split: str, index: int, size: tuple[int, int]) -> ObjectView:
    """A furnished room from one place in it."""
    import mujoco

    room = generate_room(split, index)
    model = mujoco.MjModel.from_xml_string(room.text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    draw = Draw((STREAM, SPLITS[split], index))
    camera = RayCamera(size, draw_intrinsics(draw, size))
    position, rotation = choose_pose(room, model, data, camera.intrinsics, size, draw)
    hits = camera.cast(model, data, position, rotation)
    surfaces = Surfaces(model, data)
    linear = shade(room, model, data, surfaces, hits, size, position, float(camera.intrinsics[0, 0]))
    image = develop(linear, draw, (STREAM, SPLITS[split], index, 1))
    body = np.append(model.geom_bodyid, 0)[hits.geom].reshape(size)  # -1 is the last: nothing was met
    boxes, labels = [], []
    for number, maker in room.pieces.items():
        rows, columns = np.nonzero(body == number)
        if len(rows) >= _LEAST_PIXELS:
            boxes.append(extent_of(rows, columns))
            labels.append(NAMES.index("person" if maker == "person" else "furniture"))
    return ObjectView(image, _large_enough(np.array(boxes, float).reshape(-1, 4), np.array(labels, np.int64)))


def _large_enough(xyxy: np.ndarray, label: np.ndarray) -> Detections2D:
    """Boxes ``(N, 4)`` without the smallest."""
    kept = (xyxy[:, 2:] - xyxy[:, :2] >= _LEAST_SIDE).all(1)
    return Detections2D(xyxy[kept], np.ones(int(kept.sum())), label[kept], NAMES)

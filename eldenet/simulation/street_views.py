"""Frames of streets and halls: picture, exact depth, instances, 2D and 3D boxes of every object."""

from typing import Any, NamedTuple

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D
from eldenet.geometry import PinholeCamera, extent_of, pinhole
from eldenet.simulation.furnished_rooms.rooms import SPLITS
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation, cast_rays
from eldenet.simulation.rendering.camera_noise import develop
from eldenet.simulation.rendering.culling import SEEN_GROUPS, only_visible
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import Surfaces, shade
from eldenet.simulation.streets import FAR, NAMES, STREAM, generate_scene

#: Version of the frames of streets, halls and a detector's rooms. Golden frames in the tests watch over it.
STREETS_VERSION = 1
_LABEL_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # level from world


class StreetView(NamedTuple):
    """One frame of a scene.

    Attributes:
        image: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` float32 [m], 0 = nothing within reach.
        camera: whose own frame the boxes are in (it is tilted by a degree or so against the ground).
        boxes: objects that are seen, in the camera's frame.
        detections: their boxes around what is seen of them, in the same order.
        visible: ``(N,)`` share of each object's pixels that nothing hides; pixels outside the picture count
            as not visible.
        truncated: ``(N,)`` bool: the picture's border cuts the object.
        instance: ``(H, W)`` number of the object, -1 for the rest.
        height: of the camera above the ground [m].
    """

    image: np.ndarray
    depth: np.ndarray
    camera: PinholeCamera
    boxes: Boxes3D
    detections: Detections2D
    visible: np.ndarray
    truncated: np.ndarray
    instance: np.ndarray
    height: float


def render_street(
    split: str, index: int, size: tuple[int, int] = (256, 832), kind: str = "street", min_pixels: int = 30
) -> StreetView:
    """Render scene ``index`` at ``(height, width)`` [px]; objects of fewer visible pixels are left out."""
    import mujoco

    scene = generate_scene(split, index, kind)
    model = mujoco.MjModel.from_xml_string(scene.room.text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    height, width = size
    # KITTI's field of view outdoors, a wide robot's camera in halls
    focal = width * (0.58 if kind == "street" else 0.62)
    matrix = pinhole(focal, focal, (width - 1) / 2, (height - 1) * (0.47 if kind == "street" else 0.5))
    eye = RayCamera(size, matrix, far=FAR[kind])
    position = np.array([0.0, 0.0, scene.camera_height])
    rotation = camera_rotation(0.0, *scene.tilt)
    hits = eye.cast(model, data, position, rotation)
    linear = shade(scene.room, model, data, Surfaces(model, data), hits, size, position, focal)
    linear[hits.geom.reshape(size) < 0] = scene.sky
    seed = (STREAM, SPLITS[split], index, 2)
    image = develop(linear, Draw(seed), (*seed, 1))
    owner = np.append(model.geom_bodyid - 1, -1)[hits.geom]
    instance = np.where((owner >= 0) & (owner < len(scene.names)), owner, -1).reshape(size)
    seen = [
        _look(model, data, eye, position, rotation, instance, number) for number in range(len(scene.names))
    ]
    kept = [number for number, look in enumerate(seen) if look.pixels >= min_pixels]
    label = np.array([NAMES.index(scene.names[number]) for number in kept], np.int64)
    renumber = np.append(np.full(len(scene.names), -1), -1)
    renumber[kept] = np.arange(len(kept))
    xyxy = np.array([seen[number].xyxy for number in kept]).reshape(-1, 4)
    return StreetView(
        image,
        hits.depth.astype(np.float32).reshape(size),
        PinholeCamera(matrix),
        _boxes(model, data, kept, label, position, rotation),
        Detections2D(xyxy, np.ones(len(kept)), label, NAMES),
        np.array([seen[number].visible for number in kept]),
        np.array([seen[number].truncated for number in kept], bool),
        renumber[instance],
        scene.camera_height,
    )


class _Look(NamedTuple):
    pixels: int
    xyxy: np.ndarray
    visible: float
    truncated: bool


def _look(
    model: Any, data: Any, eye: RayCamera, position: np.ndarray, rotation: np.ndarray,
    instance: np.ndarray, number: int,
) -> _Look:  # fmt: skip
    """What is seen of an object, against what would be seen of it alone in a picture with wide borders."""
    rows, columns = np.nonzero(instance == number)
    if not len(rows):
        return _Look(0, np.zeros(4), 0.0, False)
    height, width = eye.size
    shift = np.array([[1, 0, width / 2], [0, 1, height / 2], [0, 0, 1.0]])
    coarse = np.diag([0.25, 0.25, 1.0])  # every fourth pixel of a picture twice as wide and high
    probe = RayCamera((height // 2, width // 2), coarse @ shift @ eye.intrinsics, eye.far)
    with only_visible(model, model.geom_bodyid == number + 1):
        _, geom, _ = cast_rays(
            model, data, position, probe.rays(rotation), eye.far, normals=False, groups=SEEN_GROUPS
        )
    alone = (geom >= 0).reshape(probe.size)
    inside = alone[height // 8 : height // 8 + height // 4, width // 8 : width // 8 + width // 4]
    truncated = int(inside.sum()) < int(alone.sum())
    visible = min(1.0, len(rows) / max(16.0 * alone.sum(), 1.0))
    return _Look(len(rows), extent_of(rows, columns), visible, truncated)


def _boxes(
    model: Any, data: Any, kept: list[int], label: np.ndarray, position: np.ndarray, rotation: np.ndarray
) -> Boxes3D:
    """Exact boxes of bodies, from the extents of their geoms."""
    center, size, yaw = np.zeros((len(kept), 3)), np.zeros((len(kept), 3)), np.zeros(len(kept))
    for row, number in enumerate(kept):
        low, high = _extent(model, number + 1)
        turn = data.xmat[number + 1].reshape(3, 3)
        middle = data.xpos[number + 1] + turn @ ((low + high) / 2)
        center[row] = rotation.T @ (middle - position)
        wide, long, tall = high - low
        size[row] = long, wide, tall
        front = _LABEL_AXES @ turn[:, 1]  # +y of the body
        yaw[row] = np.arctan2(-front[2], front[0])
    return Boxes3D(center, size, yaw, np.ones(len(kept)), label, NAMES)


def _extent(model: Any, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates ``(3,)`` of a body's geoms in its own frame [m]."""
    import mujoco

    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in np.nonzero(model.geom_bodyid == body)[0]:
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        turn, s = matrix.reshape(3, 3), model.geom_size[geom]
        axis = np.abs(turn[:, 2])
        kind = int(model.geom_type[geom])
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            reach = np.abs(turn) @ s
        elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            reach = np.sqrt((turn * s) ** 2 @ np.ones(3))
        elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            reach = axis * s[1] + s[0]
        else:  # cylinder
            reach = axis * s[1] + s[0] * np.sqrt(np.maximum(1 - axis**2, 0))
        low = np.minimum(low, model.geom_pos[geom] - reach)
        high = np.maximum(high, model.geom_pos[geom] + reach)
    return low, high

"""Frames of streets and halls whose objects are known, with depth, 3D and 2D boxes."""

from typing import Any, NamedTuple

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D
from eldenet.geometry import PinholeCamera, extent_of, pinhole
from eldenet.simulation.furnished_rooms.render import Views, stacked
from eldenet.simulation.furnished_rooms.rooms import SPLITS
from eldenet.simulation.rendering.camera import (
    SEEN_GROUPS,
    RayCamera,
    camera_rotation,
    cast_rays,
    only_visible,
)
from eldenet.simulation.rendering.camera_noise import develop, develop_photo
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import CompiledRoom
from eldenet.simulation.street_furniture import sky_color
from eldenet.simulation.streets import FAR, STREAM, generate_scene
from eldenet.simulation.streets import NAMES as STREET_NAMES

#: Version of the frames of streets, halls and a detector's rooms. Golden frames in the tests watch over it.
STREETS_VERSION = 1
#: Names of the boxes in streets and halls (furniture is in rooms alone).
BOX_NAMES = (*STREET_NAMES, "furniture", "cyclist")
#: fx [widths]: KITTI's field of view outdoors, a wide robot's camera in halls.
FOCAL = {"street": 0.58, "hall": 0.62, "crossing": 0.58}
_MIN_PIXELS = 30  # of an object in a street or hall
_LABEL_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # level from world


class StreetView(NamedTuple):
    """One frame of a scene."""

    image: np.ndarray  # (H, W, 3) uint8 RGB
    depth: np.ndarray  # (H, W) float32 [m], 0 = nothing within reach
    camera: PinholeCamera  # tilted by a degree or so against the ground
    boxes: Boxes3D  # visible objects, in the camera's own frame
    detections: Detections2D  # boxes around their visible pixels, in the same order
    # (N,) share of each object's pixels that nothing hides; pixels outside the image count as hidden
    visible: np.ndarray
    truncated: np.ndarray  # (N,) bool: the image border cuts the object
    instance: np.ndarray  # (H, W) number of the object, -1 elsewhere
    height: float  # of the camera above the ground [m]
    rotation: np.ndarray  # (3, 3) world from camera


def render_street(
    split: str,
    index: int,
    size: tuple[int, int] = (256, 832),
    kind: str = "street",
    *,
    focal: tuple[float, float] | None = None,
    detail: bool = False,
) -> StreetView:
    """Render scene ``index``; objects of few visible pixels are left out.

    Args:
        split: "train", "val" or "test".
        index: of the scene.
        size: ``(height, width)`` of the frame [px].
        kind: "street", "hall" or "crossing": a street with more people, and with cyclists.
        focal: range of fx [widths], of which each scene draws its own; None: ``FOCAL`` of its kind.
        detail: streets with sidewalks, trees, poles, signs, house fronts, clouds and shadows.
    """
    scene = generate_scene(split, index, kind, detail)
    compiled = CompiledRoom(scene.room)
    height, width = size
    fx = width * (FOCAL[kind] if focal is None else Draw((STREAM, SPLITS[split], index, 3)).uniform(*focal))
    matrix = pinhole(fx, fx, (width - 1) / 2, (height - 1) * (0.5 if kind == "hall" else 0.47))
    camera = RayCamera(size, matrix, far=FAR[kind])
    position = np.array([0.0, 0.0, scene.camera_height])
    rotation = camera_rotation(0.0, *scene.tilt)
    linear, hits = compiled.photograph(camera, position, rotation)
    sky, seed = hits.geom.reshape(size) < 0, (STREAM, SPLITS[split], index, 2)
    if detail:
        linear[sky] = sky_color(camera.rays(rotation)[sky.ravel()], scene.sky, Draw((*seed, 2)))
        image = develop_photo(linear, Draw(seed), (*seed, 1), outdoors=kind != "hall")
    else:
        linear[sky] = scene.sky
        image = develop(linear, Draw(seed), (*seed, 1))
    owner = np.append(compiled.model.geom_bodyid - 1, -1)[hits.geom]
    instance = np.where(owner < len(scene.names), owner, -1).reshape(size)
    numbers, pixels = np.unique(instance[instance >= 0], return_counts=True)
    kept = numbers[pixels >= _MIN_PIXELS].tolist()
    seen = [_visibility(compiled, camera, position, rotation, instance == number, number) for number in kept]
    label = np.array([BOX_NAMES.index(scene.names[number]) for number in kept], np.int64)
    xyxy = np.array([extent_of(*np.nonzero(instance == number)) for number in kept]).reshape(-1, 4)
    renumber = np.full(len(scene.names) + 1, -1)
    renumber[kept] = np.arange(len(kept))
    return StreetView(
        image,
        hits.depth.astype(np.float32).reshape(size),
        PinholeCamera(matrix),
        _boxes(compiled, kept, label, position, rotation),
        Detections2D(xyxy, np.ones(len(kept)), label, BOX_NAMES),
        np.array([visible for visible, _ in seen]),
        np.array([truncated for _, truncated in seen], bool),
        renumber[instance],
        scene.camera_height,
        rotation,
    )


def render_streets(
    split: str,
    index: int,
    size: tuple[int, int],
    views: int,
    *,
    focal: tuple[float, float] | None = None,
    detail: bool = False,
) -> Views:
    """Render streets ``index * views`` to ``(index + 1) * views - 1`` by :func:`render_street`."""
    places = range(index * views, (index + 1) * views)
    found = [render_street(split, place, size, focal=focal, detail=detail) for place in places]
    return stacked(
        (view.image, view.depth, view.camera.intrinsics, np.array([0.0, 0.0, view.height]), view.rotation)
        for view in found
    )


def _visibility(
    scene: CompiledRoom,
    camera: RayCamera,
    position: np.ndarray,
    rotation: np.ndarray,
    mask: np.ndarray,
    number: int,
) -> tuple[float, bool]:
    """Return the visible share of an object and whether the image border cuts it.

    The object's pixels ``mask (H, W)`` are compared with those of the object alone in an image twice as wide
    and high, at a quarter of the resolution.
    """
    height, width = camera.size
    shift = np.array([[1, 0, width / 2], [0, 1, height / 2], [0, 0, 1.0]])
    coarse = np.diag([0.25, 0.25, 1.0])
    probe = RayCamera((height // 2, width // 2), coarse @ shift @ camera.intrinsics, camera.far)
    model, data, rays = scene.model, scene.data, probe.rays(rotation)
    with only_visible(model, model.geom_bodyid == number + 1):
        _, geom, _ = cast_rays(model, data, position, rays, camera.far, normals=False, groups=SEEN_GROUPS)
    alone = (geom >= 0).reshape(probe.size)
    inside = alone[height // 8 : height // 8 + height // 4, width // 8 : width // 8 + width // 4]
    return min(1.0, mask.sum() / max(16.0 * alone.sum(), 1.0)), bool(inside.sum() < alone.sum())


def _boxes(
    scene: CompiledRoom, kept: list[int], label: np.ndarray, position: np.ndarray, rotation: np.ndarray
) -> Boxes3D:
    """Return the exact boxes of ``N`` bodies with labels ``(N,)``, from the extents of their geoms."""
    center, size, yaw = np.zeros((len(kept), 3)), np.zeros((len(kept), 3)), np.zeros(len(kept))
    for row, number in enumerate(kept):
        low, high = _extent(scene.model, number + 1)
        turn = scene.data.xmat[number + 1].reshape(3, 3)
        middle = scene.data.xpos[number + 1] + turn @ ((low + high) / 2)
        center[row] = rotation.T @ (middle - position)
        wide, long, tall = high - low
        size[row] = long, wide, tall
        front = _LABEL_AXES @ turn[:, 1]  # +y of the body
        yaw[row] = np.arctan2(-front[2], front[0])
    return Boxes3D(center, size, yaw, np.ones(len(kept)), label, BOX_NAMES)


def _extent(model: Any, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest coordinates ``(3,)`` of a body's geoms in its own frame [m]."""
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

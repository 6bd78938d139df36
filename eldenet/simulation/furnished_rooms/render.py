"""Frames of a room: choose cameras, cast, shade, develop."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypedDict, Unpack

import cv2
import numpy as np

from eldenet.geometry import pinhole
from eldenet.simulation.furnished_rooms.rooms import SPLITS, generate_room
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation
from eldenet.simulation.rendering.camera_noise import develop, develop_photo
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import CompiledRoom

Pose = tuple[np.ndarray, np.ndarray]  # position (3,) [m] and rotation (3, 3)
KINECT = (0.76, 0.88)  # fx [widths]: about 63 degrees


class Views(NamedTuple):
    """All frames of one room."""

    image: np.ndarray  # (V, H, W, 3) uint8 RGB
    depth: np.ndarray  # (V, H, W) float32 [m], 0 = nothing within reach
    intrinsics: np.ndarray  # (V, 3, 3) float64 [px]
    position: np.ndarray  # (V, 3) float64 camera centers in the room [m]
    rotation: np.ndarray  # (V, 3, 3) float64 world from camera


def stacked(frames: Iterable[Sequence[np.ndarray]]) -> Views:
    """Return frames, each an image, depth, intrinsics, position and rotation, as views."""
    return Views(*(np.stack(column) for column in zip(*frames, strict=True)))


class Shares(TypedDict, total=False):
    """What a data set may show more of."""

    near: float  # share of frames of what is close: at a median depth of 0.3 to 1.2 m
    down: float  # share of frames that look down at the floor and what stands on it
    plain: float  # share of rooms whose surfaces have no pattern


def render_room(
    split: str,
    index: int,
    size: tuple[int, int] = (128, 160),
    views: int = 8,
    *,
    focal: tuple[float, float] = KINECT,
    detail: bool = False,
    **shares: Unpack[Shares],
) -> Views:
    """Render the frames of room ``index`` of a split at ``(height, width)`` [px].

    Args:
        split: "train", "val" or "test".
        index: of the room.
        size: of the frames.
        views: how many.
        focal: range of fx [widths]; each frame draws its own.
        detail: rooms as people photograph them: natural colors, more things, light that bounces.
        **shares: see :class:`Shares`; 0 unless given.
    """
    cv2.setNumThreads(0)
    near, down, plain = shares.get("near", 0.0), shares.get("down", 0.0), shares.get("plain", 0.0)
    room = CompiledRoom(generate_room(split, index, detail, plain))
    draw = Draw((SPLITS[split], index, 1))
    frames = []
    for view in range(views):
        camera = RayCamera(size, draw_intrinsics(draw, size, focal))
        kind = draw.uniform(0, 1) if near or down else 1.0
        choose = choose_pose_near if kind < near else choose_pose_down if kind < near + down else choose_pose
        position, rotation = choose(room, camera, draw, by_hand=detail)
        linear, hits = room.photograph(camera, position, rotation)
        seed = (SPLITS[split], index, 2, view)
        image = (develop_photo if detail else develop)(linear, Draw(seed), (*seed, 1))
        depth = hits.depth.astype(np.float32).reshape(size)
        frames.append((image, depth, camera.intrinsics, position, rotation))
    return stacked(frames)


def draw_intrinsics(draw: Draw, size: tuple[int, int], focal: tuple[float, float] = KINECT) -> np.ndarray:
    """Draw intrinsics ``(3, 3)`` [px] of nearly square pixels and fx in a range [widths]."""
    height, width = size
    fx = width * draw.uniform(*focal)
    fy = fx * draw.uniform(0.98, 1.07)
    cx = (width - 1) / 2 + width * draw.uniform(-0.02, 0.02)
    cy = (height - 1) / 2 + height * draw.uniform(-0.03, 0.03)
    return pinhole(fx, fy, cx, cy)


def _handful_of_rays(camera: RayCamera) -> RayCamera:
    """The same camera with 9 x 12 pixels."""
    height, width = camera.size
    probe_size = (9, 12)
    scale = np.diag([probe_size[1] / width, probe_size[0] / height, 1.0])
    return RayCamera(probe_size, scale @ camera.intrinsics)


def _best_of(count: int, candidate: Callable[[], tuple[float, Pose] | None]) -> Pose | None:
    """Draw up to ``count`` poses and how much they miss; return the first without a miss, else the best."""
    best: tuple[float, Pose] | None = None
    for _ in range(count):
        drawn = candidate()
        if drawn is not None and (best is None or drawn[0] < best[0]):
            best = drawn
        if best is not None and best[0] == 0.0:
            break
    return None if best is None else best[1]


def choose_pose(room: CompiledRoom, camera: RayCamera, draw: Draw, *, by_hand: bool = False) -> Pose:
    """Draw position ``(3,)`` [m] and rotation ``(3, 3)`` of a camera on a robot or in a hand.

    On a robot it is 0.25 to 1.0 m above the floor, in a hand 1.2 to 1.8 m. A robot has three of ten
    candidates, and one of ten with ``by_hand``, where hands are steadier too.

    Each of up to 12 candidates casts a handful of rays. The first that is close to nothing, has several geoms
    in view and a median depth of at most 7 m is taken, else the one that misses this least.
    """
    probe = _handful_of_rays(camera)
    sx, sy, h = room.room.size
    nearest = draw.uniform(0.4, 1.0)
    wanted = draw.uniform(0.7, 3.2)
    geoms_wanted = draw.integer(3, 14)  # in view: few frames show a bare wall

    def candidate() -> tuple[float, Pose] | None:
        on_robot = draw.chance(0.1 if by_hand else 0.3)
        z = draw.uniform(0.25, 1.0) if on_robot else draw.uniform(1.2, min(1.8, h - 0.2))
        x, y = draw.uniform(-0.5, 0.5) * (sx - 0.5), draw.uniform(-0.5, 0.5) * (sy - 0.5)
        yaw = draw.uniform(-np.pi, np.pi)
        if draw.chance(0.65):  # look across the room rather than at the nearest wall
            yaw = float(np.arctan2(-y, -x)) + draw.uniform(-0.7, 0.7)
        high = (-0.62, 0.0) if by_hand else (-0.55, 0.04)
        pitch = draw.uniform(*(high if z > 1.1 else (-0.15, 0.25)))
        roll = draw.uniform(-0.06, 0.06) if draw.chance(0.95 if by_hand else 0.7) else draw.uniform(-0.2, 0.2)
        if any(
            x0 - 0.2 < x < x1 + 0.2 and y0 - 0.2 < y < y1 + 0.2 and z < top + 0.2
            for x0, y0, x1, y1, top in room.room.obstacles
        ):
            return None
        position, rotation = np.array([x, y, z]), camera_rotation(yaw, pitch, roll)
        depth, geoms = probe.probe(room.model, room.data, position, rotation)
        low, middle = np.partition(depth, (4, len(depth) // 2))[[4, len(depth) // 2]]
        miss = max(0.0, nearest - float(low)) + max(0.0, wanted - float(middle))
        miss += max(0.0, float(middle) - 7.0)
        miss += 0.15 * max(0, geoms_wanted - len(np.unique(geoms)))
        return miss, (position, rotation)

    chosen = _best_of(12, candidate)
    if chosen is None:  # every candidate stood in furniture: look down from the middle of the room
        return np.array([0.0, 0.0, min(1.7, h - 0.2)]), camera_rotation(draw.uniform(-np.pi, np.pi), -0.3)
    return chosen


def choose_pose_near(room: CompiledRoom, camera: RayCamera, draw: Draw, *, by_hand: bool = False) -> Pose:
    """Draw position ``(3,)`` [m] and rotation ``(3, 3)`` of a camera close to things or a wall.

    The best of 20 candidates is taken: a median depth near a drawn one of 0.3 to 1.2 m, nothing nearer than
    0.15 m, several things in view. Without the last, most frames of bare walls would be near ones, and teach
    that what is bare is near.
    """
    probe = _handful_of_rays(camera)
    sx, sy, h = room.room.size
    wanted = draw.uniform(0.3, 1.2)
    geoms_wanted = draw.integer(3, 10)

    def candidate() -> tuple[float, Pose]:
        z = draw.uniform(0.15, min(1.8, h - 0.2) if by_hand else 1.0)
        x, y = draw.uniform(-0.5, 0.5) * (sx - 0.3), draw.uniform(-0.5, 0.5) * (sy - 0.3)
        yaw, roll = draw.uniform(-np.pi, np.pi), draw.uniform(-0.1, 0.1)
        pitch = draw.uniform(-0.9, 0.1) if z > 0.8 else draw.uniform(-0.3, 0.3)
        position, rotation = np.array([x, y, z]), camera_rotation(yaw, pitch, roll)
        depth, geoms = probe.probe(room.model, room.data, position, rotation)
        miss = abs(float(np.log(np.median(depth) / wanted))) + 10 * float(depth.min() < 0.15)
        miss += 0.15 * max(0, geoms_wanted - len(np.unique(geoms)))
        return miss, (position, rotation)

    chosen = _best_of(20, candidate)
    assert chosen is not None
    return chosen


def choose_pose_down(room: CompiledRoom, camera: RayCamera, draw: Draw, *, by_hand: bool = False) -> Pose:
    """Draw position ``(3,)`` [m] and rotation ``(3, 3)`` of a camera that looks down at the floor.

    It is 0.3 to 1.8 m above the floor (1.0 m without ``by_hand``) and looks 17 to 60 degrees below the
    horizon. Of 20 candidates, the first that has three geoms in view and a median depth of about that of the
    floor, or more, is taken, else the one that misses this least.
    """
    probe = _handful_of_rays(camera)
    sx, sy, h = room.room.size

    def candidate() -> tuple[float, Pose]:
        z = draw.uniform(0.3, min(1.8, h - 0.2) if by_hand else 1.0)
        x, y = draw.uniform(-0.5, 0.5) * (sx - 0.5), draw.uniform(-0.5, 0.5) * (sy - 0.5)
        yaw = float(np.arctan2(-y, -x)) + draw.uniform(-1.0, 1.0)  # across the room
        pitch, roll = draw.uniform(-1.05, -0.3), draw.uniform(-0.1, 0.1)
        position, rotation = np.array([x, y, z]), camera_rotation(yaw, pitch, roll)
        depth, geoms = probe.probe(room.model, room.data, position, rotation)
        floor = 0.8 * z / np.sin(-pitch)
        miss = max(0.0, floor - float(np.median(depth))) + 0.15 * max(0, 3 - len(np.unique(geoms)))
        return miss, (position, rotation)

    chosen = _best_of(20, candidate)
    assert chosen is not None
    return chosen

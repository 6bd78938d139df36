"""A video of a room with known depth and poses: a camera in a hand or on a robot moves through it."""

import cv2
import numpy as np

from eldenet.simulation.furnished_rooms.render import Views, choose_pose, draw_intrinsics
from eldenet.simulation.furnished_rooms.rooms import SPLITS, generate_room
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation
from eldenet.simulation.rendering.camera_noise import develop
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import CompiledRoom

FRAMES_PER_SECOND = 15
CLEARANCE = 0.5  # [m] kept to whatever is ahead


def render_walk(split: str, index: int, size: tuple[int, int] = (192, 256), frames: int = 45) -> Views:
    """Render a walk through room ``index`` of a split, at 15 frames per second.

    The camera starts as in :func:`~eldenet.simulation.furnished_rooms.render.render_room`. It stands for a
    fifth of the time, then walks at up to 0.8 m/s and turns at up to 30 degrees/s, with the shake of a hand.
    It stops where something is close ahead. Lens, exposure and tone stay the same; the noise of the pixels
    differs from frame to frame.

    Args:
        split: "train", "val" or "test".
        index: of the room.
        size: ``(height, width)`` [px].
        frames: number of frames.
    """
    cv2.setNumThreads(0)
    room = CompiledRoom(generate_room(split, index))
    draw = Draw((SPLITS[split], index, 3))
    camera = RayCamera(size, draw_intrinsics(draw, size))
    start, rotation = choose_pose(room, camera, draw)
    forward = rotation[:, 2]
    yaw, pitch = float(np.arctan2(forward[1], forward[0])), float(np.arcsin(np.clip(forward[2], -1, 1)))
    heading = yaw + draw.uniform(-0.6, 0.6)
    speed, turn = draw.uniform(0.2, 0.8), np.radians(draw.uniform(-30, 30))
    shake = np.random.default_rng((SPLITS[split], index, 4)).normal(size=(frames, 3)) * np.radians(0.25)
    probe_size = (9, 12)
    scale = np.diag([probe_size[1] / size[1], probe_size[0] / size[0], 1.0])
    probe = RayCamera(probe_size, scale @ camera.intrinsics)
    position, pace = start.copy(), 0.0
    views = []
    for number in range(frames):
        wanted = speed if number >= frames // 5 else 0.0
        ahead, _ = probe.probe(room.model, room.data, position, camera_rotation(heading, 0.0))
        wanted = wanted if ahead.min() > CLEARANCE else 0.0
        pace += float(np.clip(wanted - pace, -0.15, 0.1))
        turning = turn if number >= frames // 5 else 0.0
        yaw, heading = yaw + turning / FRAMES_PER_SECOND, heading + turning / FRAMES_PER_SECOND
        position = position + pace / FRAMES_PER_SECOND * np.array([np.cos(heading), np.sin(heading), 0.0])
        pose = camera_rotation(yaw + shake[number, 0], pitch + shake[number, 1], shake[number, 2])
        linear, hits = room.photograph(camera, position, pose)
        # the same draws develop every frame; the noise of the pixels is its own
        image = develop(linear, Draw((SPLITS[split], index, 5)), (SPLITS[split], index, 6, number))
        views.append((image, hits.depth.astype(np.float32).reshape(size), camera.intrinsics, position, pose))
    return Views(*(np.stack(column) for column in zip(*views, strict=True)))

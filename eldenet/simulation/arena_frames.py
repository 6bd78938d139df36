"""Frames of arenas, as the robot's camera sees them on its way: what a depth network for it learns from.

All frames, whatever their split, show arenas of navigation's "train" stream: no network ever sees an arena
that drivers are chosen or reported on.
"""

import math

import cv2
import numpy as np

from eldenet.simulation.arena_view import ArenaView, camera_pose
from eldenet.simulation.arenas import SPLITS, Arena, cell_center, clearance_map, generate_arena
from eldenet.simulation.furnished_rooms.render import Views
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.robot import ROBOT

#: First arena of every split of frames within navigation's training stream; far apart, so none is shared.
FIRST_ARENA = {"train": 0, "val": 1_000_000, "test": 2_000_000}
LIGHT = (0.05, 3.0)  # dim to glaring, as a share of a normal day's
MOST_OBSTACLES, MOST_MOVERS = 80, 10
FRAME_STREAM = 104  # beside arenas.SPLITS and tasks.TASK_STREAM
_ROOM = 0.30  # that a robot has at least around its middle [m]
_CLOSE = 0.8  # what counts as close to something [m]
_NOSE_TO_WALL = 0.4  # median depth [m]


def render_arena(split: str, index: int, size: tuple[int, int] = (128, 160), views: int = 8) -> Views:
    """Render frames of arena ``index`` of a split at ``(height, width)`` [px].

    Density, light and number of walking people are the arena's; the pose, the time and the camera's settings
    are each frame's. Half of the poses are close to something, as a robot's are among obstacles.

    Raises:
        ValueError: unknown split or negative index.
    """
    if split not in FIRST_ARENA:
        raise ValueError(f"split={split!r}: use one of {list(FIRST_ARENA)}")
    if not 0 <= index < FIRST_ARENA["val"]:
        raise ValueError(f"index={index}: arenas are numbered from 0 to {FIRST_ARENA['val'] - 1}")
    cv2.setNumThreads(0)
    number = FIRST_ARENA[split] + index
    draw = Draw((FRAME_STREAM, number))
    movers = draw.integer(1, MOST_MOVERS) if draw.chance(0.5) else 0
    arena = generate_arena("train", draw.integer(0, MOST_OBSTACLES), number, movers=movers)
    light = LIGHT[0] * (LIGHT[1] / LIGHT[0]) ** draw.unit()
    view = ArenaView(arena, size, light=light)
    clearance = clearance_map(arena.obstacles)
    probe = ArenaView(arena, (9, 16))
    frames = []
    for frame in range(views):
        time = draw.uniform(0.0, 60.0)
        pose = _draw_pose(draw, arena, clearance, time)
        for _ in range(5):  # few frames show nothing but the next wall
            if np.median(probe.photo(pose, time).depth) > _NOSE_TO_WALL:
                break
            pose = _draw_pose(draw, arena, clearance, time)
        photo = view.photo(pose, time, noise=frame, settings=frame)
        frames.append((photo.image, photo.depth, view.intrinsics, *camera_pose(pose)))
    return Views(*(np.stack(column) for column in zip(*frames, strict=True)))


def _draw_pose(draw: Draw, arena: Arena, clearance: np.ndarray, time: float) -> tuple[float, float, float]:
    """Somewhere a robot fits, any heading."""
    people = [walker.position(time) for walker in arena.movers]
    far = _CLOSE if draw.chance(0.5) else np.inf
    places = np.argwhere((clearance >= _ROOM) & (clearance < far))
    while True:
        x, y = cell_center(*places[int(draw.unit() * len(places))])
        if all(math.hypot(x - a, y - b) > ROBOT.radius + 0.3 for a, b in people):
            return x, y, draw.uniform(-math.pi, math.pi)


assert FRAME_STREAM not in SPLITS.values()

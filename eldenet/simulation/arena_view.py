"""The robot camera's view of an arena, and the rendered frames that a depth network for it learns from.

All rendered frames, whatever their split, show arenas of navigation's "train" stream: no network ever sees
an arena in which drivers are selected or reported.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np

from eldenet.boxes import Detections2D
from eldenet.geometry import extent_of, pinhole
from eldenet.simulation.arena_detail import detailed_arena
from eldenet.simulation.arena_mjcf import CEILING, arena_mjcf
from eldenet.simulation.arenas import SPLITS, Arena, cell_center, clearance_map, generate_arena
from eldenet.simulation.furnished_rooms.render import Views, stacked
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation
from eldenet.simulation.rendering.camera_noise import develop, develop_photo
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import CompiledRoom, Room
from eldenet.simulation.robot import ROBOT
from eldenet.system.checks import one_of

ARENAS = 1_000_000  # of a split of frames
#: First arena of every split of frames within navigation's training stream.
FIRST_ARENA = {"train": 0, "val": ARENAS, "test": 2 * ARENAS}
FRAME_STREAM = 104  # beside arenas.SPLITS and tasks.TASK_STREAM
_LIGHT = (0.05, 3.0)  # dim to glaring, as a share of a normal day's
_MAX_OBSTACLES, _MAX_PEDESTRIANS = 80, 10
_MIN_PIXELS = 20  # of an object that a detector can find
_MIN_CLEARANCE = 0.30  # around the robot's center [m]
_CLOSE = 0.8  # clearance below which a robot is among obstacles [m]
_NOSE_TO_WALL = 0.4  # median depth up to which a pose is drawn again [m]


class Photo(NamedTuple):
    """An RGB-D frame of an arena."""

    image: np.ndarray  # (H, W, 3) uint8 RGB
    depth: np.ndarray  # (H, W) float32, true [m]
    # (H, W) index into Arena.obstacles of what each pixel shows; -1: floor, walls
    obstacle: np.ndarray


class ArenaView:
    """A level RGB-D camera on the robot; the robot itself is not drawn.

    Args:
        arena: the world.
        size: of the image, ``(height, width)`` [px].
        light: brightness of the lamps, as a share of a normal day's: 0.05 is dusk, 3 is glaring.
        detail: obstacles are furniture and people, with doors, windows, cables and light that bounces.
    """

    def __init__(
        self, arena: Arena, size: tuple[int, int] = (120, 160), *, light: float = 1.0, detail: bool = False
    ) -> None:
        self.intrinsics = robot_intrinsics(size)
        self.camera = RayCamera(size, self.intrinsics)
        self.arena, self.size = arena, size
        self._seed = (SPLITS.get(arena.split, 0), arena.density, arena.index, 2)
        draw = Draw((*self._seed, 0))
        tone = draw.pick(((1.0, 0.96, 0.9), (1.0, 0.88, 0.72), (0.92, 0.97, 1.0)))
        lamps = [(x, y) for x in (-6.0, 0.0, 6.0) for y in (-6.0, 0.0, 6.0)]
        power = light * draw.uniform(0.8, 1.2)
        outer = arena.side + 2.0
        self.room = CompiledRoom(
            Room(
                "arena",
                (outer, outer, CEILING),
                detailed_arena(arena) if detail else arena_mjcf(arena, "none", visual=True),
                lights=[(x, y, CEILING - 0.4, *(power * t for t in tone), 4.0) for x, y in lamps],
                ambient=light * draw.uniform(0.15, 0.4),
                detail=detail,
            )
        )
        if detail:  # body n + 1 is obstacle n; 0 is the world, the last one the hall
            body = np.append(self.room.model.geom_bodyid, 0)
            self._obstacle_of = np.where(body <= len(arena.obstacles), body - 1, -1)
        else:
            self._obstacle_of = _obstacle_numbers(self.room.model, arena)

    def walk_to(self, time: float) -> None:
        """Put the pedestrians where they are at a time [s]."""
        pedestrians = self.arena.pedestrians
        if pedestrians:
            self.room.data.mocap_pos[:, :2] = [pedestrian.position(time) for pedestrian in pedestrians]
            self.room.update()

    def photo(
        self,
        pose: tuple[float, float, float],
        time: float = 0.0,
        noise: int = 0,
        settings: int = 0,
        camera: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> Photo:
        """Take a photo from a pose of the robot.

        Args:
            pose: x, y [m], heading [rad].
            time: at which pedestrians are shown [s].
            noise: seed of the pixel noise.
            settings: seed of the camera's exposure, tone and blur; keep it over a video, so that it does not
                flicker.
            camera: center and rotation, as of :func:`camera_pose`; None: as it is mounted on the robot.
        """
        self.walk_to(time)
        linear, hits = self.room.photograph(self.camera, *(camera or camera_pose(pose)))
        finish = develop_photo if self.room.room.detail else develop
        image = finish(linear, Draw((*self._seed, 1, settings)), (*self._seed, noise))
        depth = hits.depth.astype(np.float32).reshape(self.size)
        return Photo(image, depth, self._obstacle_of[hits.geom].reshape(self.size))


def render_arena(
    split: str, index: int, size: tuple[int, int] = (128, 160), views: int = 8, *, detail: bool = False
) -> Views:
    """Render frames of arena ``index`` of a split at ``(height, width)`` [px].

    Density, light and number of pedestrians vary by arena; pose, time and camera settings by frame. Half of
    the poses are close to something, as a robot's are among obstacles. ``detail`` is :class:`ArenaView`'s.

    Raises:
        ValueError: unknown split or index out of range.
    """
    photos = arena_photos(split, index, size, views, detail)
    lens = robot_intrinsics(size)
    return stacked((photo.image, photo.depth, lens, *camera_pose(pose)) for _, pose, photo in photos)


def simulated_detections(photo: Photo, arena: Arena) -> Detections2D:
    """Tight 2D boxes around the visible part of each obstacle but walls, from the renderer."""
    kinds = tuple(sorted({obstacle.kind for obstacle in arena.obstacles}))
    boxes, labels = [], []
    for number in np.unique(photo.obstacle[photo.obstacle >= 0]):
        if arena.obstacles[number].is_wall:
            continue
        rows, columns = np.nonzero(photo.obstacle == number)
        if len(rows) >= _MIN_PIXELS:
            boxes.append(extent_of(rows, columns))
            labels.append(kinds.index(arena.obstacles[number].kind))
    if not boxes:
        return Detections2D.empty(kinds)
    return Detections2D(np.array(boxes, float), np.ones(len(boxes)), np.array(labels, np.int64), kinds)


def arena_photos(
    split: str, index: int, size: tuple[int, int], views: int, detail: bool = False
) -> Iterator[tuple[Arena, tuple[float, float, float], Photo]]:
    """Draw arena ``index`` of a split and yield it with the pose and photo of each frame.

    Raises:
        ValueError: unknown split or index out of range.
    """
    one_of("split", split, FIRST_ARENA)
    if not 0 <= index < ARENAS:
        raise ValueError(f"index={index}: give 0 to {ARENAS - 1}, the arenas of a split")
    cv2.setNumThreads(0)
    number = FIRST_ARENA[split] + index
    draw = Draw((FRAME_STREAM, number))
    pedestrians = draw.integer(1, _MAX_PEDESTRIANS) if draw.chance(0.5) else 0
    arena = generate_arena("train", draw.integer(0, _MAX_OBSTACLES), number, pedestrians=pedestrians)
    light = _LIGHT[0] * (_LIGHT[1] / _LIGHT[0]) ** draw.unit()
    view = ArenaView(arena, size, light=light, detail=detail)
    clearance = clearance_map(arena.obstacles)
    probe = RayCamera((9, 16), robot_intrinsics((9, 16)))
    for frame in range(views):
        time = draw.uniform(0.0, 60.0)
        pose = _draw_pose(draw, arena, clearance, time)
        for _ in range(5):  # few frames show nothing but the nearest wall
            view.walk_to(time)
            ahead = probe.cast(view.room.model, view.room.data, *camera_pose(pose)).depth
            if np.median(ahead.astype(np.float32)) > _NOSE_TO_WALL:
                break
            pose = _draw_pose(draw, arena, clearance, time)
        yield arena, pose, view.photo(pose, time, noise=frame, settings=frame)


def _draw_pose(draw: Draw, arena: Arena, clearance: np.ndarray, time: float) -> tuple[float, float, float]:
    """Draw a place with some ``clearance (n, n)`` [m] and away from people, and any heading."""
    people = [pedestrian.position(time) for pedestrian in arena.pedestrians]
    far = _CLOSE if draw.chance(0.5) else np.inf
    places = np.argwhere((clearance >= _MIN_CLEARANCE) & (clearance < far))
    while True:
        x, y = cell_center(*places[int(draw.unit() * len(places))])
        if all(math.hypot(x - a, y - b) > ROBOT.radius + 0.3 for a, b in people):
            return x, y, draw.uniform(-math.pi, math.pi)


def robot_intrinsics(size: tuple[int, int]) -> np.ndarray:
    """Return the intrinsics ``(3, 3)`` [px] of the robot's camera at ``(height, width)`` [px]."""
    height, width = size
    focal = width / 2 / math.tan(ROBOT.field_of_view / 2)
    return pinhole(focal, focal, (width - 1) / 2, (height - 1) / 2)


def camera_pose(pose: tuple[float, float, float], pitch: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the optical center ``(3,)`` [m] and world-from-camera rotation ``(3, 3)`` at a robot's pose.

    ``pitch`` is the camera's below the horizon [rad].
    """
    return np.array(ROBOT.camera_center(pose)), camera_rotation(pose[2], -pitch)


def _obstacle_numbers(model: Any, arena: Arena) -> np.ndarray:
    """Return every geom's index ``(G + 1,)`` in :attr:`Arena.obstacles`; -1: another, and last no geom.

    Geoms have no names, but their order is that of :func:`~eldenet.simulation.arena_mjcf.arena_mjcf`:
    the world's (floor, walls, hall, standing obstacles), then those of the pedestrians' bodies.
    """
    order = sorted(range(len(arena.obstacles)), key=lambda n: bool(arena.obstacles[n].path))
    numbers = [n for n in order for _ in range(2 if arena.obstacles[n].kind in ("person", "vehicle") else 1)]
    return np.array([-1] * (model.ngeom - len(numbers)) + numbers + [-1])


assert FRAME_STREAM not in SPLITS.values()

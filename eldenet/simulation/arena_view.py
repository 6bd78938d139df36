"""What the robot's camera sees of an arena: rays, the rooms' light and surfaces, a cheap camera's picture."""

import math
from typing import Any, NamedTuple

import numpy as np

from eldenet.geometry import pinhole
from eldenet.simulation.arena_mjcf import CEILING, arena_mjcf
from eldenet.simulation.arenas import SPLITS, Arena
from eldenet.simulation.furnished_rooms.rooms import Room
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation
from eldenet.simulation.rendering.camera_noise import develop
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import Surfaces, shade
from eldenet.simulation.robot import ROBOT


class Photo(NamedTuple):
    """What the camera sees, and what is there.

    Attributes:
        image: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` float32, true [m].
        obstacle: ``(H, W)`` number of what each pixel shows in :attr:`Arena.obstacles`; -1: floor, walls.
    """

    image: np.ndarray
    depth: np.ndarray
    obstacle: np.ndarray


class ArenaView:
    """A level RGB-D camera on the robot, in a model of the arena that has looks but no robot.

    Args:
        arena: the world.
        size: of the picture, ``(height, width)`` [px].
        light: brightness of the lamps, as a share of a normal day's: 0.05 is dusk, 3 is glaring.

    Attributes:
        intrinsics: ``(3, 3)`` [px], of the robot's field of view.
    """

    def __init__(self, arena: Arena, size: tuple[int, int] = (120, 160), *, light: float = 1.0) -> None:
        import mujoco

        if light <= 0:
            raise ValueError(f"light={light}: give a share above 0")
        self.intrinsics = robot_intrinsics(size)
        self.camera = RayCamera(size, self.intrinsics)
        self.arena, self.size = arena, size
        self.model: Any = mujoco.MjModel.from_xml_string(arena_mjcf(arena, "none", look=True))
        self.data: Any = mujoco.MjData(self.model)
        self._kinematics = mujoco.mj_kinematics
        self._kinematics(self.model, self.data)
        self._surfaces: Surfaces | None = None
        self._obstacle_of = _obstacle_numbers(self.model, arena)
        self._seed = (SPLITS.get(arena.split, 0), arena.density, arena.index, 2)
        draw = Draw((*self._seed, 0))
        tone = draw.pick(((1.0, 0.96, 0.9), (1.0, 0.88, 0.72), (0.92, 0.97, 1.0)))
        lamps = [(x, y) for x in (-6.0, 0.0, 6.0) for y in (-6.0, 0.0, 6.0)]
        power = light * draw.uniform(0.8, 1.2)
        outer = arena.side + 2.0
        self.room = Room(
            "arena",
            (outer, outer, CEILING),
            lights=[(x, y, CEILING - 0.4, *(power * t for t in tone), 4.0) for x, y in lamps],
            ambient=light * draw.uniform(0.15, 0.4),
        )

    def photo(
        self, pose: tuple[float, float, float], time: float = 0.0, noise: int = 0, settings: int = 0
    ) -> Photo:
        """Look from a pose.

        Args:
            pose: of the robot: x, y [m], heading [rad].
            time: at which walking people are shown [s].
            noise: seed of the pixel noise.
            settings: which draw of the camera's exposure, tone and blur; a film keeps one, so as not to
                flicker.
        """
        for number, obstacle in enumerate(self.arena.movers):
            self.data.mocap_pos[number, :2] = obstacle.position(time)
        if self.arena.movers or self._surfaces is None:
            self._kinematics(self.model, self.data)
            self._surfaces = Surfaces(self.model, self.data)
        eye, rotation = camera_pose(pose)
        hits = self.camera.cast(self.model, self.data, eye, rotation)
        focal = float(self.intrinsics[0, 0])
        linear = shade(self.room, self.model, self.data, self._surfaces, hits, self.size, eye, focal)
        image = develop(linear, Draw((*self._seed, 1, settings)), (*self._seed, noise))
        depth = hits.depth.astype(np.float32).reshape(self.size)
        return Photo(image, depth, self._obstacle_of[hits.geom].reshape(self.size))


def robot_intrinsics(size: tuple[int, int]) -> np.ndarray:
    """``(3, 3)`` [px] of the robot's camera at ``(height, width)`` [px]."""
    height, width = size
    focal = width / 2 / math.tan(ROBOT.field_of_view / 2)
    return pinhole(focal, focal, (width - 1) / 2, (height - 1) / 2)


def camera_pose(pose: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Optical center ``(3,)`` [m] and world-from-camera rotation ``(3, 3)`` of a robot's level camera."""
    x, y, yaw = pose
    ahead = ROBOT.camera_ahead
    center = np.array([x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), ROBOT.camera_height])
    return center, camera_rotation(yaw)


def _obstacle_numbers(model: Any, arena: Arena) -> np.ndarray:
    """Obstacle number of every geom, -1 for what is none; a last entry stands for "no geom" (-1).

    Geoms carry no names, but their order is that of :func:`~eldenet.simulation.arena_mjcf.arena_mjcf`:
    those of the world (floor, walls, hall, standing obstacles), then the walking ones' bodies.
    """
    count = {"person": 2, "vehicle": 2}
    standing = [n for n, o in enumerate(arena.obstacles) for _ in range(count.get(o.kind, 1)) if not o.path]
    walking = [n for n, o in enumerate(arena.obstacles) for _ in range(count.get(o.kind, 1)) if o.path]
    numbers = [*standing, *walking]
    return np.array([-1] * (model.ngeom - len(numbers)) + numbers + [-1])

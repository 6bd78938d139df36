"""A robot in an arena, simulated by MuJoCo: kinematic (to train in) or on wheels (to report).

Both share one world: collisions are MuJoCo's contacts, ranges are MuJoCo's rays.
"""

import math
from typing import Any

import numpy as np

from eldenet.simulation.arena_mjcf import FRICTION, TIMESTEP, WHEEL_RADIUS, WHEEL_TRACK, arena_mjcf
from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import THIN
from eldenet.simulation.rendering.camera import SEEN_GROUPS, cast_rays
from eldenet.simulation.robot import ROBOT, Robot, arc
from eldenet.system.checks import one_of

PHYSICS = ("kinematic", "wheels")
#: Of the kinematic robot, the same as with the wheels' motors [m/s2], [rad/s2].
ACCELERATION, TURN_ACCELERATION = 3.5, 12.0


class ArenaWorld:
    """One robot in one arena.

    Args:
        arena: the world.
        physics: "kinematic" moves the pose along arcs, at bounded acceleration, and checks for contacts
            (about 4 us each); "wheels" drives two torque-limited wheels over the floor in steps of 5 ms.
        size: of the robot's footprint, relative to :data:`~eldenet.simulation.robot.ROBOT`.
        friction: between wheels and floor.

    Raises:
        ValueError: unknown physics.
    """

    def __init__(
        self, arena: Arena, physics: str = "kinematic", size: float = 1.0, friction: float = FRICTION
    ) -> None:
        import mujoco

        one_of("physics", physics, PHYSICS)
        self.arena, self.physics, self.size = arena, physics, size
        text = arena_mjcf(
            arena, "planar" if physics == "kinematic" else "wheels", size=size, friction=friction
        )
        self.model: Any = mujoco.MjModel.from_xml_string(text)
        self.data: Any = mujoco.MjData(self.model)
        self._kinematics, self._collide = mujoco.mj_kinematics, mujoco.mj_collision
        self._step = mujoco.mj_step
        self._pedestrians = arena.pedestrians
        self._solid = self.model.geom_contype == 1  # obstacles and walls
        wall = 2 * np.min(self.model.geom_size[:, :2], axis=1) < THIN  # which no detector finds
        self._object = ~(wall & (self.model.geom_type == mujoco.mjtGeom.mjGEOM_BOX))
        self.time = 0.0
        self.speed = self.turn = 0.0  # of the kinematic robot [m/s], [rad/s]
        self.place(arena.start)

    def place(self, pose: tuple[float, float, float]) -> None:
        """Put the robot at a pose, at rest, and restart time."""
        import mujoco

        mujoco.mj_resetData(self.model, self.data)
        self.time = self.speed = self.turn = 0.0
        self._move_pedestrians()
        x, y, yaw = pose
        if self.physics == "kinematic":
            self.data.qpos[:] = pose
            self._kinematics(self.model, self.data)
        else:
            self.data.qpos[:7] = (x, y, 0.0, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
            mujoco.mj_forward(self.model, self.data)

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y [m] and heading [rad] of the center of the axle."""
        if self.physics == "kinematic":
            x, y, yaw = self.data.qpos.tolist()
            return x, y, yaw
        x, y, _, w, i, j, k = self.data.qpos[:7].tolist()
        return x, y, math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    def advance(self, speed: float, turn: float, seconds: float) -> bool:
        """Drive for a while and return whether the robot touched an obstacle or a wall.

        ``speed`` is ahead [m/s], ``turn`` counter-clockwise [rad/s]; on wheels, ``seconds`` is a multiple
        of 5 ms.
        """
        if self.physics == "wheels":
            return self._drive(speed, turn, round(seconds / TIMESTEP))
        x, y, yaw = self.pose
        before = self.speed, self.turn
        self.speed += min(max(speed - self.speed, -ACCELERATION * seconds), ACCELERATION * seconds)
        self.turn += min(max(turn - self.turn, -TURN_ACCELERATION * seconds), TURN_ACCELERATION * seconds)
        mean = (before[0] + self.speed) / 2, (before[1] + self.turn) / 2
        self.data.qpos[:] = arc(x, y, yaw, *mean, seconds)
        self.time += seconds
        self._move_pedestrians()
        self._kinematics(self.model, self.data)
        self._collide(self.model, self.data)
        return bool(self.data.ncon > 0)

    def _drive(self, speed: float, turn: float, steps: int) -> bool:
        difference = turn * self.size * WHEEL_TRACK / 2
        self.data.ctrl[:] = (speed - difference) / WHEEL_RADIUS, (speed + difference) / WHEEL_RADIUS
        for _ in range(steps):
            self.time += TIMESTEP
            self._move_pedestrians()
            self._step(self.model, self.data)
            if self._solid[self.data.contact.geom].any():
                return True
        return False

    def _move_pedestrians(self) -> None:
        if self._pedestrians:
            self.data.mocap_pos[:, :2] = [pedestrian.position(self.time) for pedestrian in self._pedestrians]

    def ranges(self, view: Robot = ROBOT) -> np.ndarray:
        """Return the distance from the camera along the central ray of a view's columns ``(columns,)`` [m].

        Convention: horizontal rays; distances are at least ``near``, and ``far`` where nothing is hit.
        """
        return np.clip(self._cast(view)[0], view.near, view.far)

    def _cast(self, view: Robot) -> tuple[np.ndarray, np.ndarray]:
        """Distance ``(columns,)`` [m], and the number of the geom that each ray hits; -1: none."""
        origin, yaw = np.array(view.camera_center(self.pose)), self.pose[2]
        angles = np.array(view.column_angles) + yaw
        rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(view.columns)], axis=1)
        distance, geom, _ = cast_rays(
            self.model, self.data, origin, rays, view.far, normals=False, groups=SEEN_GROUPS
        )
        distance[geom < 0] = view.far
        return distance, geom

    def centers(self) -> np.ndarray:
        """Return x, y ``(K, 2)`` [m] of the centers of the objects that the camera's rays hit; no walls."""
        geom = self._cast(ROBOT)[1]
        hit = np.unique(geom[geom >= 0])
        return np.asarray(self.data.geom_xpos[hit[self._object[hit]], :2])

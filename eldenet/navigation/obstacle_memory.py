"""What a robot has seen and no longer sees: points on the floor, in the odometry's frame.

Points are forgotten with age, and when later looks see through them. The second matters: a depth network is
wrong by a tenth, so a thing seen from 6 m smears over half a meter, and odometry shifts what was seen long
ago. Without it every such error stays an obstacle until it is old, and the arena fills with things that are
not there (of 200 "val" arenas of 80 under measured errors, one driver crossed 66 % without and 91 % with it).
It is the free space of an occupancy grid (Elfes, "Using occupancy grids for mobile robot perception and
navigation", 1989), kept on points.

NumPy alone; nothing here knows a simulator.
"""

import math

import numpy as np

from eldenet.navigation.pedestrians import AHEAD, MOST, Walkers, marks
from eldenet.simulation.robot import ROBOT

MEMORY_REACH = 3.0  # of what is asked for [m]
TRAIL = 0.35  # half width of what a walker leaves in the memory [m]
LOOKED_AT = 5.0  # from the camera: farther points are left alone until it comes near [m]
BEHIND, SLACK = 0.2, 0.05  # a look sees through a point if its range is longer by this share and length [m]
_NOWHERE = np.float32(1e6)


class Memory:
    """Points that ``robots`` robots saw.

    Args:
        robots: how many.
        periods: control periods that are remembered, every second frame of them; 0: the last frame alone.
        seen_through: looks one after the other that must see through a point before it is forgotten; one may
            have missed the thing. 0: points are forgotten with age alone.
        walkers: follow what moves: where it was is forgotten, where it will be is remembered.
    """

    def __init__(self, robots: int, periods: int, *, seen_through: int, walkers: bool) -> None:
        self.seen_through = seen_through
        self._angles = np.array(ROBOT.column_angles)
        self._points = np.full((robots, periods // 2 + 1, ROBOT.columns, 2), _NOWHERE, np.float32)
        self._doubts = np.zeros(self._points.shape[:3], np.uint8)  # looks that saw through a point, so far
        self._looks = np.zeros(robots, np.intp)  # frames seen so far
        self._walkers = [Walkers() for _ in range(robots)] if walkers else []
        marked = MOST * len(AHEAD) * 8 if walkers else 0
        self._marks = np.full((robots, marked, 2), _NOWHERE, np.float32)

    def reset(self, robot: int | slice) -> None:
        """Forget all that one robot (or some) saw."""
        self._points[robot] = _NOWHERE
        self._looks[robot] = 0
        self._marks[robot] = _NOWHERE
        for number in range(len(self._looks))[robot] if isinstance(robot, slice) else [robot]:
            if self._walkers:
                self._walkers[number] = Walkers()

    def add(self, who: np.ndarray, ranges: np.ndarray, odometry: np.ndarray) -> None:
        """Write frames over the oldest ones or the odd frame before, and forget what they see through.

        Args:
            who: numbers of the robots that look ``(K,)``.
            ranges: theirs ``(K, columns)`` [m].
            odometry: theirs ``(K, 3)``.
        """
        yaw = odometry[:, 2]
        eyes = odometry[:, :2] + ROBOT.camera_ahead * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        angles = yaw[:, None] + self._angles
        frame = np.stack(
            [eyes[:, :1] + ranges * np.cos(angles), eyes[:, 1:] + ranges * np.sin(angles)], axis=2
        )
        if self.seen_through:
            self._forget_seen_through(who, ranges, eyes, yaw)
        for row, robot in enumerate(who) if self._walkers else ():
            self._follow(int(robot), frame[row], ranges[row], eyes[row])
        frame[ranges >= ROBOT.far] = _NOWHERE
        place = self._looks[who] // 2 % self._points.shape[1]
        self._points[who, place] = frame
        self._doubts[who, place] = 0
        self._looks[who] += 1

    def _forget_seen_through(
        self, who: np.ndarray, ranges: np.ndarray, eyes: np.ndarray, yaw: np.ndarray
    ) -> None:
        points, eye = self._points[who], eyes.astype(np.float32)
        dx, dy = points[..., 0] - eye[:, 0, None, None], points[..., 1] - eye[:, 1, None, None]
        squared = dx * dx + dy * dy
        at = np.nonzero((squared < np.float32(LOOKED_AT**2)) & (squared > np.float32(ROBOT.near**2)))
        away, row = np.sqrt(squared[at]), at[0]
        bearing = np.arctan2(dy[at], dx[at]) - yaw[row] + math.pi
        bearing -= 2 * math.pi * np.floor(bearing / (2 * math.pi)) + math.pi
        column = np.floor((bearing / ROBOT.field_of_view + 0.5) * ROBOT.columns).astype(np.intp)
        seen = (column >= 0) & (column < ROBOT.columns)
        row, column, away = row[seen], column[seen], away[seen]
        place = (who[row], at[1][seen], at[2][seen])
        # also beside it: at the edge of a thing, the ray in the middle of the column may miss it
        beside = np.pad(ranges, ((0, 0), (1, 1)), constant_values=np.inf)
        free = np.minimum(np.minimum(beside[:, :-2], ranges), beside[:, 2:])
        through = free[row, column] > away * (1 + BEHIND) + SLACK
        doubts = np.where(through, self._doubts[place] + 1, 0)
        self._doubts[place] = doubts
        gone = doubts >= self.seen_through
        self._points[tuple(part[gone] for part in place)] = _NOWHERE

    def _follow(self, robot: int, frame: np.ndarray, ranges: np.ndarray, eye: np.ndarray) -> None:
        """Forget the trails of what moves, also in this frame, and mark where it will be."""
        moving = self._walkers[robot].update(frame, ranges)
        self._marks[robot] = _NOWHERE
        if not moving:
            return
        points = self._points[robot]
        for track in moving:
            # its trail lies between where it began and where it is
            along, at = track.position - track.began, points - track.began.astype(np.float32)
            share = np.clip(at @ along / max(float(along @ along), 1e-6), 0, 1)
            off = at - share[..., None] * along
            points[np.hypot(off[..., 0], off[..., 1]) < TRAIL] = _NOWHERE
            frame[track.columns] = _NOWHERE
        marked = marks(moving, eye)
        self._marks[robot, : len(marked)] = marked

    def near(
        self, odometry: np.ndarray, robots: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Remembered points within 3 m: row of ``odometry``, x ahead, y left, distance; ``(M,)``, by row."""
        place = odometry.astype(np.float32)
        points = self._points if robots is None else self._points[robots]
        points = points.reshape(len(place), -1, 2)
        if self._walkers:
            marked = self._marks if robots is None else self._marks[robots]
            points = np.concatenate([points, marked], axis=1)
        dx, dy = points[..., 0] - place[:, 0, None], points[..., 1] - place[:, 1, None]
        squared = dx * dx + dy * dy
        row, number = np.nonzero(squared < np.float32(MEMORY_REACH**2))
        dx, dy, away = dx[row, number], dy[row, number], np.sqrt(squared[row, number])
        c, s = np.cos(place[:, 2])[row], np.sin(place[:, 2])[row]
        return row, c * dx + s * dy, c * dy - s * dx, away

"""Memory of seen obstacles: points on the floor in the odometry's frame.

Points are forgotten with age, and when later scans see through them. The second matters: with a depth
network's error of 10 % an object seen from 6 m smears over half a meter, and odometry shifts old points.
Without it each such error stays an obstacle until it is old (in 200 "val" arenas of 80 obstacles with
measured errors, one driver succeeded in 66 % without and 91 % with it). It is the free space of an occupancy
grid (Elfes, "Using occupancy grids for mobile robot perception and navigation", 1989), applied to points.

Needs NumPy only, no simulator.
"""

import math

import numpy as np

from eldenet.navigation.pedestrian_tracking import MAX_MARKS, PedestrianTracker, marks
from eldenet.simulation.robot import ROBOT, view_of

MEMORY_REACH = 3.0  # distance up to which points are returned [m]
TRAIL = 0.35  # half width of a pedestrian's trail in the memory [m]
CHECKED = 5.0  # distance from the camera up to which points are checked [m]
BEHIND, SLACK = 0.2, 0.05  # a scan sees through a point if its range is longer by this share and length [m]
_NOWHERE = np.float32(1e6)


class Memory:
    """Points that ``robots`` robots saw.

    Args:
        periods: control periods to remember, of which every second scan is kept; 0: the last scan only.
        seen_through: consecutive scans that must see through a point before it is forgotten, as one may have
            missed the object; 0: points are forgotten with age only.
        walkers: track pedestrians: forget where they were, remember where they will be.
    """

    def __init__(self, robots: int, periods: int, *, seen_through: int, walkers: bool) -> None:
        self.seen_through = seen_through
        self._periods = periods
        self._make_room(robots, ROBOT.columns)
        self._scans = np.zeros(robots, np.intp)  # scans so far
        self._walkers = [PedestrianTracker() for _ in range(robots)] if walkers else []
        self._marks = np.full((robots, MAX_MARKS if walkers else 0, 2), _NOWHERE, np.float32)

    def _make_room(self, robots: int, columns: int) -> None:
        """Forget all points, and make room for those of scans with so many columns."""
        self._points = np.full((robots, self._periods // 2 + 1, columns, 2), _NOWHERE, np.float32)
        self._doubts = np.zeros(self._points.shape[:3], np.uint8)  # scans that saw through a point so far

    def reset(self, robot: int | slice) -> None:
        """Forget everything that one or more robots saw."""
        self._points[robot] = _NOWHERE
        self._scans[robot] = 0
        self._marks[robot] = _NOWHERE
        for number in range(len(self._scans))[robot] if isinstance(robot, slice) else [robot]:
            if self._walkers:
                self._walkers[number] = PedestrianTracker()

    def add(
        self, who: np.ndarray, ranges: np.ndarray, odometry: np.ndarray, cautious: np.ndarray | None = None
    ) -> None:
        """Forget points that scans see through, then store the scans.

        Each pair of scans shares a place: the second replaces the first, and the next pair the oldest.

        Args:
            who: numbers of the scanning robots ``(K,)``.
            ranges: of these robots ``(K, columns)`` [m]; a camera's after a lidar's, or the other way round,
                make them forget all before.
            odometry: of these robots ``(K, 3)``.
            cautious: how near things may be ``(K, columns)`` [m]: up to there a scan sees through points;
                None: as far as ``ranges``.
        """
        if ranges.shape[1] != self._points.shape[2]:
            self._make_room(len(self._points), ranges.shape[1])
        yaw = odometry[:, 2]
        cameras = odometry[:, :2] + ROBOT.camera_ahead * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        angles = yaw[:, None] + np.array(view_of(ranges.shape[1]).column_angles)
        frame = np.stack(
            [cameras[:, :1] + ranges * np.cos(angles), cameras[:, 1:] + ranges * np.sin(angles)], axis=2
        )
        if self.seen_through:
            self._forget_seen_through(who, ranges if cautious is None else cautious, cameras, yaw)
        for row, robot in enumerate(who) if self._walkers else ():
            self._follow(int(robot), frame[row], ranges[row], cameras[row])
        frame[ranges >= ROBOT.far] = _NOWHERE
        place = self._scans[who] // 2 % self._points.shape[1]
        self._points[who, place] = frame
        self._doubts[who, place] = 0
        self._scans[who] += 1

    def _forget_seen_through(
        self, who: np.ndarray, ranges: np.ndarray, cameras: np.ndarray, yaw: np.ndarray
    ) -> None:
        """Forget points that scans ``(K, columns)`` [m] of robots ``(K,)`` see through."""
        points, camera = self._points[who], cameras.astype(np.float32)
        dx, dy = points[..., 0] - camera[:, 0, None, None], points[..., 1] - camera[:, 1, None, None]
        squared = dx * dx + dy * dy
        at = np.nonzero((squared < np.float32(CHECKED**2)) & (squared > np.float32(ROBOT.near**2)))
        away, row = np.sqrt(squared[at]), at[0]
        bearing = np.arctan2(dy[at], dx[at]) - yaw[row] + math.pi
        bearing -= 2 * math.pi * np.floor(bearing / (2 * math.pi)) + math.pi
        view = view_of(ranges.shape[1])
        column = np.floor((bearing / view.field_of_view + 0.5) * view.columns).astype(np.intp)
        seen = (column >= 0) & (column < view.columns)
        row, column, away = row[seen], column[seen], away[seen]
        place = (who[row], at[1][seen], at[2][seen])
        # check the neighbors too: at an object's edge, the ray at the column's center may miss it
        beside = np.pad(ranges, ((0, 0), (1, 1)), constant_values=np.inf)
        free = np.minimum(np.minimum(beside[:, :-2], ranges), beside[:, 2:])
        through = free[row, column] > away * (1 + BEHIND) + SLACK
        doubts = np.where(through, self._doubts[place] + 1, 0)
        self._doubts[place] = doubts
        gone = doubts >= self.seen_through
        self._points[tuple(part[gone] for part in place)] = _NOWHERE

    def _follow(self, robot: int, frame: np.ndarray, ranges: np.ndarray, camera: np.ndarray) -> None:
        """Forget the trails of pedestrians, also in this scan, and mark where they will be.

        ``frame (columns, 2)`` has the points and ``ranges (columns,)`` the ranges of the scan [m].
        """
        moving = self._walkers[robot].update(frame, ranges)
        self._marks[robot] = _NOWHERE
        if not moving:
            return
        points = self._points[robot]
        for track in moving:
            # the trail is the line from its first to its current position
            along, at = track.position - track.began, points - track.began.astype(np.float32)
            share = np.clip(at @ along / max(float(along @ along), 1e-6), 0, 1)
            off = at - share[..., None] * along
            points[np.hypot(off[..., 0], off[..., 1]) < TRAIL] = _NOWHERE
            frame[track.columns] = _NOWHERE
        marked = marks(moving, camera)
        self._marks[robot, : len(marked)] = marked

    def points(self, robot: int) -> np.ndarray:
        """All points that a robot remembers, in the odometry's frame ``(M, 2)`` [m]."""
        points = self._points[robot].reshape(-1, 2)
        return points[points[:, 0] < _NOWHERE]

    def near(
        self, odometry: np.ndarray, robots: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return points within 3 m: row of ``odometry``, x ahead, y left, distance; ``(M,)`` each, by row."""
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

"""Tracking of pedestrians: segments of a scan with a person's width, followed from scan to scan.

One alpha-beta filter per segment (Kalata, "The tracking index: a generalized parameter for alpha-beta and
alpha-beta-gamma target trackers", 1984) on the center of its visible face. Needs NumPy only, no simulator.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from eldenet.simulation.robot import ROBOT

MAX_WIDTH = 0.8  # of a pedestrian [m]
MAX_RANGE = 6.0  # of a tracked segment [m]
MAX_DISTANCE = 0.45  # between a segment and the predicted position of its track [m]
ALPHA, BETA = 0.5, 0.25  # gains of position and velocity
MIN_SPEED = 0.15  # of a moving track [m/s]
MIN_HITS = 4  # scans before a track can count as moving
MAX_AGE = 20  # scans without its segment after which a track is dropped
AHEAD = (0.0, 0.5, 1.0, 1.5, 2.0)  # until the positions that are marked [s]
RADIUS = 0.25  # of a pedestrian [m]
DEPTH_STEP = 0.3  # least range step between two segments, or a tenth of the range [m]
MAX_MARKED = 8  # pedestrians
_CIRCLE = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1) * RADIUS
MAX_MARKS = MAX_MARKED * len(AHEAD) * len(_CIRCLE)  # points that :func:`marks` returns at most


@dataclass
class Track:
    """A tracked object in the odometry's frame.

    Attributes:
        position: of the center of its visible face ``(2,)`` [m].
        began: first position ``(2,)`` [m].
        columns: of its segment in the last scan; empty if that missed it.
        velocity: ``(2,)`` [m/s].
        hits: number of scans that saw it.
        missed: scans since the last of them.
        moving: whether it moves.
    """

    position: np.ndarray
    began: np.ndarray
    columns: slice
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    hits: int = 1
    missed: int = 0
    moving: bool = False


class PedestrianTracker:
    """Tracks of one robot's scans."""

    def __init__(self) -> None:
        self.tracks: list[Track] = []

    def update(self, points: np.ndarray, ranges: np.ndarray) -> list[Track]:
        """Update the tracks with a scan and return those that move.

        Args:
            points: ``(columns, 2)`` in the odometry's frame [m].
            ranges: ``(columns,)`` [m].
        """
        for track in self.tracks:
            track.position = track.position + track.velocity * ROBOT.period
            track.missed += 1
            track.columns = slice(0)
        for columns in slim_segments(points, ranges):
            middle = points[columns].mean(axis=0)
            free = [track for track in self.tracks if track.missed]
            away = [float(np.hypot(*(middle - track.position))) for track in free]
            if away and min(away) < MAX_DISTANCE:
                _correct(free[int(np.argmin(away))], middle, columns)
            else:
                self.tracks.append(Track(middle, middle, columns))
        self.tracks = [track for track in self.tracks if track.missed <= MAX_AGE]
        return [track for track in self.tracks if track.moving]


def _correct(track: Track, middle: np.ndarray, columns: slice) -> None:
    """Update a track with the center ``(2,)`` [m] and the columns of its segment."""
    surprise = middle - track.position
    track.position = track.position + ALPHA * surprise
    track.velocity = track.velocity + BETA / ROBOT.period * surprise
    track.hits, track.missed, track.columns = track.hits + 1, 0, columns
    fast = float(np.hypot(*track.velocity)) > MIN_SPEED
    gone = float(np.hypot(*(track.position - track.began))) > MIN_SPEED * ROBOT.period * track.hits
    track.moving = track.hits >= MIN_HITS and fast and (track.moving or gone)


def slim_segments(points: np.ndarray, ranges: np.ndarray) -> list[slice]:
    """Return the columns of each segment narrower than :data:`MAX_WIDTH`, near enough and fully in view.

    ``points (columns, 2)`` and ``ranges (columns,)`` are those of a scan [m].
    """
    nearer = np.minimum(ranges[1:], ranges[:-1])
    steps = np.flatnonzero(np.abs(np.diff(ranges)) > np.maximum(DEPTH_STEP, 0.1 * nearer)) + 1
    out = []
    for first, end in pairwise(steps.tolist()):  # segments at the border of the view are left out
        if ranges[first:end].min() < MAX_RANGE and np.hypot(*(points[end - 1] - points[first])) < MAX_WIDTH:
            out.append(slice(first, end))
    return out


def marks(tracks: list[Track], camera: np.ndarray) -> np.ndarray:
    """Return points ``(M, 2)`` [m] around where the nearest pedestrians are and will be, at times ``AHEAD``.

    Args:
        tracks: of pedestrians, those that move.
        camera: position of the camera ``(2,)``; an object's center lies behind its visible face.
    """
    near = sorted(tracks, key=lambda track: float(np.hypot(*(track.position - camera))))[:MAX_MARKED]
    out = [np.empty((0, 2))]
    for track in near:
        away = track.position - camera
        middle = track.position + RADIUS / 2 * away / max(float(np.hypot(*away)), 1e-6)
        out += [middle + track.velocity * time + _CIRCLE for time in AHEAD]
    return np.concatenate(out)

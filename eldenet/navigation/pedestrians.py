"""What moves: things of a walker's width that the camera sees, followed from look to look.

An alpha-beta filter per thing (Kalata, "The tracking index: a generalized parameter for alpha-beta and
alpha-beta-gamma target trackers", 1984) on the middle of its visible face; NumPy alone, no simulator.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from eldenet.simulation.robot import ROBOT

WIDEST = 0.8  # of what may walk [m]
FARTHEST = 6.0  # that is followed [m]
GATE = 0.45  # from where a track expects its thing [m]
ALPHA, BETA = 0.5, 0.25  # shares of a surprise that go into position and velocity
SLOWEST = 0.15  # of what counts as moving [m/s]
SEEN_OFTEN = 4  # looks before anything counts as moving
KEPT = 20  # looks without its thing after which a track is given up
AHEAD = (0.0, 0.5, 1.0, 1.5, 2.0)  # where a walker will be is marked at these times [s]
RADIUS = 0.25  # of a walker [m]
DEPTH_STEP = 0.3  # between neighboring columns of two things, and a tenth of the range [m]
MOST = 8  # walkers that are marked
_CIRCLE = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1) * RADIUS


@dataclass
class Track:
    """One thing in the odometry's frame.

    Attributes:
        position: of the middle of its visible face ``(2,)`` [m].
        velocity: ``(2,)`` [m/s].
        began: where it was first seen ``(2,)`` [m].
        looks: in which it was seen.
        missed: looks since.
        moving: whether it moves.
        columns: of the last look, where it was seen.
    """

    position: np.ndarray
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    began: np.ndarray = field(default_factory=lambda: np.zeros(2))
    looks: int = 1
    missed: int = 0
    moving: bool = False
    columns: slice = field(default_factory=lambda: slice(0))


class Walkers:
    """Tracks of one robot."""

    def __init__(self) -> None:
        self.tracks: list[Track] = []

    def update(self, points: np.ndarray, ranges: np.ndarray) -> list[Track]:
        """Take a look over; returns the tracks that move.

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
            if away and min(away) < GATE:
                _correct(free[int(np.argmin(away))], middle, columns)
            else:
                self.tracks.append(Track(middle, began=middle, columns=columns))
        self.tracks = [track for track in self.tracks if track.missed <= KEPT]
        return [track for track in self.tracks if track.moving]


def _correct(track: Track, middle: np.ndarray, columns: slice) -> None:
    surprise = middle - track.position
    track.position = track.position + ALPHA * surprise
    track.velocity = track.velocity + BETA / ROBOT.period * surprise
    track.looks, track.missed, track.columns = track.looks + 1, 0, columns
    fast = float(np.hypot(*track.velocity)) > SLOWEST
    gone = float(np.hypot(*(track.position - track.began))) > SLOWEST * ROBOT.period * track.looks
    track.moving = track.looks >= SEEN_OFTEN and fast and (track.moving or gone)


def slim_segments(points: np.ndarray, ranges: np.ndarray) -> list[slice]:
    """Columns of everything in view that is at most :data:`WIDEST` wide and wholly in view."""
    nearer = np.minimum(ranges[1:], ranges[:-1])
    steps = np.flatnonzero(np.abs(np.diff(ranges)) > np.maximum(DEPTH_STEP, 0.1 * nearer)) + 1
    out = []
    for first, end in pairwise(steps.tolist()):  # what the picture's border cuts is left out
        if ranges[first:end].min() < FARTHEST and np.hypot(*(points[end - 1] - points[first])) < WIDEST:
            out.append(slice(first, end))
    return out


def marks(tracks: list[Track], eye: np.ndarray) -> np.ndarray:
    """Points ``(M, 2)`` [m] around where walkers are and will be within two seconds; the nearest few walkers.

    Args:
        tracks: that move.
        eye: of the robot ``(2,)``, from which a walker's middle lies behind its visible face.
    """
    near = sorted(tracks, key=lambda track: float(np.hypot(*(track.position - eye))))[:MOST]
    out = [np.empty((0, 2))]
    for track in near:
        away = track.position - eye
        middle = track.position + RADIUS / 2 * away / max(float(np.hypot(*away)), 1e-6)
        out += [middle + track.velocity * time + _CIRCLE for time in AHEAD]
    return np.concatenate(out)

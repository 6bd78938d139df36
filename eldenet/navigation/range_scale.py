"""Finds out from the robot's own motion that all ranges are too long or too short by one factor.

A depth camera that is badly calibrated, or a depth network, may measure everything 15 % too near. One scan
cannot show that, but two scans with a known way between them can: with the right factor, both show the same
things in the same places. Needs NumPy only, no simulator.
"""

import math

import numpy as np

from eldenet.navigation.range_filter import seen_from
from eldenet.simulation.robot import ROBOT, view_of

SCALE_VERSION = 1  # raise it whenever factors change: stored rows with the range scale name it
_LOGS = np.arange(-18, 19) * 0.02  # of the factors tried: 0.70 to 1.43
FACTORS = np.exp(_LOGS)
_UNCHANGED = len(FACTORS) // 2  # index of factor 1
WAYS = (0.5, 1.0)  # least way between two scans that are compared [m]; a comparison each
WAY_SLACK = 0.5  # the way may be longer by this [m]
REACH = 6.0  # readings beyond are not compared [m]: they hardly depend on the way
EDGE = 0.1  # readings whose neighbors differ by this share are not compared: they may be mixed
FULL_DISAGREEMENT = 0.1  # readings that differ by this share, or more, disagree fully: by 1
ENOUGH = 60  # readings to compare before the factor may change
LEAST_GAIN = 0.1  # the factor may change only if it reduces the mean disagreement by more than this
MOST_DISAGREEMENT = 0.2  # ... to less than this
LEAST_ERROR = 0.05  # smaller errors stay as they are
REMEMBERED = 4000  # readings after which earlier ones count half


class RangeScale:
    """Corrects the ranges of one robot by a factor that it estimates while the robot drives.

    It needs about 2 m of way among many obstacles, and more in open space. The factor stays 1 unless it makes
    the scans agree clearly better, and well: noise that differs from scan to scan, as a depth network's,
    changes nothing.

    It trusts the odometry. Where wheels slip, the odometry is too long, and it would make ranges too long as
    well; so use it only where the wheels hold.

    Attributes:
        factor: ranges are multiplied by it.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything; call this at every new start."""
        self.factor = 1.0
        self._way = 0.0  # driven [m]
        self._scans: list[tuple[np.ndarray, np.ndarray, float]] = []  # ranges, pose and way
        self._summed = np.zeros(len(FACTORS))  # disagreement of all readings, by factor
        self._readings = 0

    def __call__(
        self, ranges: np.ndarray, odometry: np.ndarray, cautious: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Correct a scan.

        Args:
            ranges: ``(columns,)`` [m], all known: :class:`~eldenet.navigation.range_filter.RangeFilter`'s.
            odometry: ``(3,)`` x, y [m], heading [rad].
            cautious: ``(columns,)`` [m] how near things may be; None: as ``ranges`` says.

        Returns:
            Ranges and ``cautious``, corrected. Readings at the camera's least and greatest range stay.
        """
        pose = np.asarray(odometry, dtype=float)
        if self._scans:
            self._way += math.dist(pose[:2], self._scans[-1][1][:2])
        self._compare(ranges, pose)
        self._scans = [scan for scan in self._scans if self._way - scan[2] <= max(WAYS) + WAY_SLACK]
        self._scans.append((ranges, pose, self._way))
        return self._corrected(ranges), None if cautious is None else self._corrected(cautious)

    def _corrected(self, ranges: np.ndarray) -> np.ndarray:
        """Ranges ``(columns,)`` [m] times the factor."""
        inside = (ranges > ROBOT.near) & (ranges < ROBOT.far)
        return np.where(inside, np.clip(ranges * self.factor, ROBOT.near, ROBOT.far), ranges)

    def _compare(self, ranges: np.ndarray, pose: np.ndarray) -> None:
        """Compare a scan ``(columns,)`` [m] with earlier ones, and update the factor."""
        for way in WAYS:
            earlier = [scan for scan in self._scans if way <= self._way - scan[2] <= way + WAY_SLACK]
            if earlier:
                by_factor = _disagreements(*earlier[-1][:2], ranges, pose)
                self._summed += by_factor.sum(axis=1)
                self._readings += by_factor.shape[1]
        if self._readings > REMEMBERED:
            self._summed /= 2
            self._readings //= 2
        if self._readings < ENOUGH:
            return
        mean = self._summed / self._readings
        best = int(mean.argmin())
        if not 0 < best < len(FACTORS) - 1:  # the right one may lie beyond those tried: no change
            return
        better = mean[best] < MOST_DISAGREEMENT and mean[_UNCHANGED] - mean[best] > LEAST_GAIN
        self.factor = float(FACTORS[best]) if better and abs(_LOGS[best]) > LEAST_ERROR else 1.0


def _disagreements(
    before: np.ndarray, pose_before: np.ndarray, ranges: np.ndarray, pose: np.ndarray
) -> np.ndarray:
    """How much two scans disagree, 0 to 1, by factor and by reading ``(factors, readings)``.

    Readings of the earlier scan that no factor puts out of view are compared. Where the later scan measures
    nothing in range there, or something too near to measure, they disagree fully.

    Args:
        before: ranges of the earlier scan ``(columns,)`` [m].
        pose_before: its pose ``(3,)``.
        ranges: of the later scan ``(columns,)`` [m].
        pose: its pose ``(3,)``.
    """
    steps = np.abs(np.diff(np.log(before))) > EDGE
    flat = ~(np.append(steps, False) | np.append(False, steps))
    used = flat & (before > ROBOT.near) & (before < REACH)
    angle, away = (part[:, used] for part in seen_from(pose, FACTORS[:, None] * before, pose_before))
    view = view_of(len(ranges))
    column = np.floor((angle / view.field_of_view + 0.5) * view.columns).astype(np.intp)
    in_view = ((column >= 0) & (column < view.columns)).all(axis=0)
    away, column = away[:, in_view], column[:, in_view]
    seen = ranges[column]
    apart = np.log(away / (FACTORS[:, None] * seen)) / FULL_DISAGREEMENT
    return np.where((seen > ROBOT.near) & (seen < ROBOT.far), np.minimum(apart**2, 1), 1.0)

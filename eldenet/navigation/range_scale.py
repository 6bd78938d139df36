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
WAYS = (0.5, 1.0)  # least way between two scans that are compared [m]; a comparison each
LONGEST = 0.5  # the way may be longer by this [m]
REACH = 6.0  # readings beyond are not compared [m]: they hardly depend on the way
EDGE = 0.1  # readings whose neighbors differ by this share are not compared: they may be mixed
AGREE = 0.1  # readings that differ by this share, or more, disagree fully
ENOUGH = 60  # readings to compare before the factor may change
WORSE = 0.1  # the factor may change only if the mean disagreement without it is greater by this much
WRONG = 0.2  # ... and is at most this with it
SMALLEST = 0.05  # smaller errors stay as they are
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
        self._disagreement = np.zeros(len(FACTORS))  # sum over readings
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
        self._scans = [scan for scan in self._scans if self._way - scan[2] <= max(WAYS) + LONGEST]
        self._scans.append((ranges, pose, self._way))
        return self._corrected(ranges), None if cautious is None else self._corrected(cautious)

    def _corrected(self, ranges: np.ndarray) -> np.ndarray:
        """Ranges ``(columns,)`` [m] times the factor."""
        inside = (ranges > ROBOT.near) & (ranges < ROBOT.far)
        return np.where(inside, np.clip(ranges * self.factor, ROBOT.near, ROBOT.far), ranges)

    def _compare(self, ranges: np.ndarray, pose: np.ndarray) -> None:
        """Compare a scan ``(columns,)`` [m] with earlier ones, and update the factor."""
        for way in WAYS:
            earlier = [scan for scan in self._scans if way <= self._way - scan[2] <= way + LONGEST]
            if not earlier:
                continue
            before, then, _ = earlier[-1]
            disagreement = _disagreement(before, then, ranges, pose)
            self._disagreement += disagreement.sum(axis=1)
            self._readings += disagreement.shape[1]
        if self._readings > REMEMBERED:
            self._disagreement /= 2
            self._readings //= 2
        if self._readings < ENOUGH:
            return
        mean = self._disagreement / self._readings
        best = int(mean.argmin())
        if 0 < best < len(FACTORS) - 1:
            agrees = mean[best] < WRONG and mean[len(FACTORS) // 2] - mean[best] > WORSE
            self.factor = float(FACTORS[best]) if agrees and abs(_LOGS[best]) > SMALLEST else 1.0


def _disagreement(before: np.ndarray, then: np.ndarray, ranges: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """How much two scans disagree, 0 to 1, by factor and by reading ``(factors, readings)``.

    Args:
        before: ranges of the earlier scan ``(columns,)`` [m].
        then: its pose ``(3,)``.
        ranges: of the later scan ``(columns,)`` [m].
        pose: its pose ``(3,)``.
    """
    steps = np.abs(np.diff(np.log(before))) > EDGE
    flat = ~(np.append(steps, False) | np.append(False, steps))
    used = flat & (before > ROBOT.near) & (before < REACH)
    angle, away = (part[:, used] for part in seen_from(pose, FACTORS[:, None] * before, then))
    view = view_of(len(ranges))
    column = np.floor((angle / view.field_of_view + 0.5) * view.columns).astype(np.intp)
    in_view = ((column >= 0) & (column < view.columns)).all(axis=0)  # with any factor, or it favors some
    away, column = away[:, in_view], column[:, in_view]
    seen = ranges[column]
    apart = np.log(away / (FACTORS[:, None] * seen)) / AGREE
    return np.where((seen > ROBOT.near) & (seen < ROBOT.far), np.minimum(apart**2, 1), 1.0)

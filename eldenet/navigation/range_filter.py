"""Ranges in which no single reading decides: lone readings are dropped, narrow gaps are filled.

It stands between a sensor and the driver, so any driver may use it. Needs NumPy and SciPy, no simulator.
"""

import math

import numpy as np

from eldenet.simulation.robot import ROBOT, view_of

SLIMMEST = 0.05  # width of the slimmest thing that a single scan must show [m]
MOST = 3  # neighboring columns that are asked for at most
APART, APART_SHARE = 0.15, 0.10  # readings agree if they differ by less than this length [m] or share
WIDEST_GAP = 3  # unknown columns that are filled from their neighbors; a wider gap reads as near
STUCK = 0.5  # way [m] or turn [rad] after which a narrow reading that stays the same is a fault
STILL = 0.05  # change of a reading that stays the same [m]
CLEARED = 10  # scans that must read otherwise before a fault is over
FILTER_VERSION = 1  # raise it whenever filtered ranges change: stored rows with the filter name it
_STEP = ROBOT.field_of_view / ROBOT.columns


class RangeFilter:
    """A filter in space and time for the ranges of one robot.

    A near reading counts if as many neighboring columns agree as a thing 5 cm wide covers at that range (two
    to three). A narrower one that is more than 0.8 m away, or at the edge of the view, counts if the last
    scan agrees, seen from where the robot was then. Others, and unknown readings (nan), are filled from
    their neighbors if they are at most three columns wide; wider gaps read as near. One or two columns
    farther than both sides (at the edge of the view: than the inner side) are filled too.

    A narrow near reading that stays the same while the robot drives 0.5 m or turns 0.5 rad is a fault of the
    sensor. It counts as unknown until it reads otherwise for two seconds.

    A thing slimmer than 5 cm is missed if it first comes into view within 0.8 m.

    Attributes:
        faults: numbers of the columns that stay near, right to left.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget earlier scans and faults; call this at every new start."""
        self._begin(ROBOT.columns)

    def _begin(self, columns: int) -> None:
        self._before: tuple[np.ndarray, np.ndarray] | None = None  # readings and pose of the last scan
        self._held = np.full(columns, np.nan)  # narrow reading that may be stuck [m]
        self._moved = np.zeros(columns)  # motion while it stayed, as a share of STUCK
        self._otherwise = np.zeros(columns, np.intp)  # scans since it was last seen

    @property
    def faults(self) -> tuple[int, ...]:
        """Columns that stay near."""
        return tuple(np.flatnonzero(self._moved >= 1).tolist())

    def __call__(
        self, ranges: np.ndarray, odometry: np.ndarray, cautious: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Filter a scan.

        Args:
            ranges: ``(columns,)`` [m]; nan where unknown.
            odometry: ``(3,)`` x, y [m], heading [rad].
            cautious: ``(columns,)`` [m] how near things may be, 0 in columns that the camera does not see;
                None: as ``ranges`` says.

        Returns:
            Ranges ``(columns,)`` [m], all known, and ``cautious`` with the same columns filled. Columns that
            the camera does not see stay as they are.
        """
        pose = np.asarray(odometry, dtype=float)
        raw = np.asarray(ranges, dtype=float)
        if len(raw) != len(self._held):
            self._begin(len(raw))
        self._watch(raw, pose)
        known = np.where(self._moved >= 1, np.nan, raw)
        out = np.where(self._counts(known, pose), known, np.nan)
        self._before = (known, pose)
        if cautious is not None:
            cautious = fill_gaps(np.where(np.isnan(out), np.nan, cautious))
        out = without_peaks(fill_gaps(out))
        if cautious is None:
            return out, None
        out[cautious == 0] = ROBOT.far
        return out, np.minimum(cautious, out)

    def _counts(self, ranges: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Mask of the readings that neighbors or the last scan agree with ``(columns,)``."""
        with np.errstate(invalid="ignore"):
            needed = np.clip(np.floor(SLIMMEST / (_STEP * ranges)), 1, MOST)
            needed[[0, 1, -2, -1]] = np.minimum(needed[[0, 1, -2, -1]], 2)  # the rest may be out of view
            enough = (_agreeing(ranges) >= np.maximum(needed, 2)) | (ranges >= ROBOT.far)
        slim = needed == 1
        slim[[0, -1]] = True
        slim &= ~enough
        if slim.any():
            enough[slim] = self._seen_before(ranges, pose)[slim]
        return enough & ~np.isnan(ranges)

    def _seen_before(self, ranges: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Mask of the readings that the last scan shows too ``(columns,)``; all of the first scan's."""
        if self._before is None:
            return np.full(len(ranges), True)
        bearing, away = seen_from(pose, *self._before)
        angles = np.array(view_of(len(ranges)).column_angles)
        with np.errstate(invalid="ignore"):
            beside = np.abs(bearing[None, :] - angles[:, None]) < 1.5 * _STEP
            same = np.abs(away[None, :] - ranges[:, None]) < _apart(ranges)[:, None]
        return np.asarray((beside & same).any(axis=1))

    def _watch(self, ranges: np.ndarray, pose: np.ndarray) -> None:
        """Follow narrow near ``ranges (columns,)`` [m] that stay the same while the robot moves."""
        way = 0.0
        if self._before is not None:
            dx, dy, turn = pose - self._before[1]
            turn = abs((turn + math.pi) % (2 * math.pi) - math.pi)
            way = max(math.hypot(dx, dy), turn) / STUCK
        with np.errstate(invalid="ignore"):
            narrow = without_dips(np.where(np.isnan(ranges), ROBOT.far, ranges)) - ranges > _apart(ranges)
            same = np.abs(ranges - self._held) < STILL
        self._moved[same] += way * (narrow | (self._moved >= 1))[same]
        self._otherwise = np.where(same, 0, self._otherwise + 1)
        other = ~same & ((self._moved < 1) | (self._otherwise >= CLEARED))
        self._moved[other] = 0.0
        self._held[other] = np.where(narrow, ranges, np.nan)[other]


def fill_gaps(ranges: np.ndarray) -> np.ndarray:
    """Return ranges ``(columns,)`` [m] with unknown columns as near as their nearer neighbor.

    A gap of more than :data:`WIDEST_GAP` columns reads as near: the robot must not drive where it is blind.
    """
    out, unknown = ranges.copy(), np.isnan(ranges)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], unknown, [False]]).astype(int)))
    for first, end in edges.reshape(-1, 2):
        beside = [ranges[side] for side in (first - 1, end) if 0 <= side < len(ranges)]
        out[first:end] = min(beside) if beside and end - first <= WIDEST_GAP else ROBOT.near
    return out


def without_peaks(ranges: np.ndarray) -> np.ndarray:
    """Return ranges ``(columns,)`` [m] with one or two columns beyond both sides at the farther side.

    This is a grayscale opening (Serra, "Image Analysis and Mathematical Morphology", 1982) where it matters.
    """
    from scipy.ndimage import grey_opening

    opened = grey_opening(ranges, 3, mode="nearest")
    return np.where(ranges - opened > _apart(opened), opened, ranges)


def without_dips(ranges: np.ndarray) -> np.ndarray:
    """Return ranges ``(columns,)`` [m] with up to four columns nearer than both sides at the nearer side."""
    from scipy.ndimage import grey_closing

    return np.maximum(grey_closing(ranges, 5, mode="nearest"), ranges)


def _apart(ranges: np.ndarray) -> np.ndarray:
    """How far readings ``(columns,)`` [m] may differ and still agree [m]."""
    return np.maximum(APART, APART_SHARE * ranges)


def _agreeing(ranges: np.ndarray) -> np.ndarray:
    """Count each column and those beside it, without a break, that are as near or nearer ``(columns,)``."""
    count = np.ones(len(ranges), np.intp)
    bound, columns = ranges + _apart(ranges), len(ranges)
    padded = np.pad(ranges, MOST - 1, constant_values=np.nan)
    for side in (-1, 1):
        goes_on = np.full(columns, True)
        for step in range(1, MOST):
            at = MOST - 1 + side * step
            goes_on &= padded[at : at + columns] <= bound
            count += goes_on
    return count


def seen_from(pose: np.ndarray, ranges: np.ndarray, scanned_at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bearing [rad] and distance [m] of an earlier scan's points from the camera now; each as ``ranges``.

    Args:
        pose: ``(3,)`` of the robot now.
        ranges: of the scan ``(..., columns)`` [m].
        scanned_at: ``(3,)`` pose of the robot then.
    """
    x, y, yaw = scanned_at
    angles = yaw + np.array(view_of(ranges.shape[-1]).column_angles)
    ahead = ROBOT.camera_ahead
    dx = x - pose[0] + ahead * (math.cos(yaw) - math.cos(pose[2])) + ranges * np.cos(angles)
    dy = y - pose[1] + ahead * (math.sin(yaw) - math.sin(pose[2])) + ranges * np.sin(angles)
    bearing = np.arctan2(dy, dx) - pose[2]
    return np.arctan2(np.sin(bearing), np.cos(bearing)), np.hypot(dx, dy)

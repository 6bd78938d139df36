"""What a drive tells about its camera: focal length and mount, from how corners move between known poses.

A corner of one picture lies in the next one on a line that the poses give (its epipolar line), if the camera
is the right one. Focal length, pitch, yaw and place on the robot are those for which corners lie nearest to
their lines: Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2004, chapters 9 and 19.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from eldenet.data.depth_from_motion import (
    CORNER_SPACING,
    TRACK_ERROR,
    View,
    apart,
    homogeneous,
    there_and_back,
)
from eldenet.geometry import level_rotation

PAIR_WAY, MOST_WAY, MOST_TURN = 0.08, 1.0, 0.35  # between the pictures of a pair: least, most [m], [rad]
MOST_PAIRS, LEAST_PAIRS = 200, 24
CORNERS, LEAST_CORNERS = 200, 20  # of a pair
THERE_AND_BACK = 0.5  # by which tracking forth and back may miss a corner [px]
ON_LINE, LEAST_SHARE = 1.5, 0.7  # distance of a corner from its line that agrees [px]; their share
PARTS = 5  # of the drive; fits without one of them tell how sure the fit is (jackknife)
#: Standard errors of a fit that counts: ln of the focal length, pitch and yaw [rad], place on the robot [m].
SURE = (0.03, 0.02, 0.02, 0.03)
STARTS = (0.5, 0.7, 1.0, 1.4, 2.0)  # factors of the focal length
LIMITS = (math.log(3), 0.6, 0.6, 1.0)  # of the search, as SURE; a heading of the wrong sign meets them
#: Of a corner that may be on the floor: least height below the camera per depth, sigma of it as a share.
LEAST_DOWN, MOST_SIGMA = 0.02, 0.3
HEIGHTS = np.arange(math.log(0.03), math.log(6.0), 0.01)  # of the search for the floor: ln of meters
SMOOTH, LEAST_PEAK = 0.04, 0.4  # of their histogram: ln of a height; share of its peak that a floor needs
SHARP, ABOVE = 2.0, 0.15  # a floor has more than so many times the corners of what is so much higher (ln)
SAME_FLOOR, LEAST_AGREE = 0.05, 4  # ln by which the floor of a part may differ, and parts that must agree


class Pair(NamedTuple):
    """Corners of a picture and of a later one."""

    here: np.ndarray  # (N, 2) [px]
    there: np.ndarray  # (N, 2) [px]
    motion: np.ndarray  # (4, 4) between the two [m]
    times: tuple[float, float] | None = None  # of the two, if they are known [s]


class CameraFit(NamedTuple):
    """How the camera differs from what was told; None where the drive does not tell."""

    focal: float | None = None  # the true focal length over the one told
    pitch: float | None = None  # how much lower it looks [rad]
    yaw: float | None = None  # how far it looks to the left [rad]
    ahead: float | None = None  # how far it sits before the place that was told [m]


def find_pairs(views: Iterable[View]) -> list[Pair]:
    """Track corners between views in the order of time; stop after ``MOST_PAIRS``."""
    pairs: list[Pair] = []
    first: View | None = None
    for view in views:
        way, turn = (0.0, 0.0) if first is None else apart(first.pose, view.pose)
        if first is None or way > MOST_WAY or turn > MOST_TURN:
            first = view
        elif way >= PAIR_WAY:
            pair = _tracked(first, view)
            if len(pair.here) >= LEAST_CORNERS:
                pairs.append(pair)
            first = view
        if len(pairs) == MOST_PAIRS:
            break
    return pairs


def _tracked(one: View, other: View) -> Pair:
    motion = np.linalg.inv(other.pose) @ one.pose
    times = None if one.seconds is None or other.seconds is None else (one.seconds, other.seconds)
    corners = cv2.goodFeaturesToTrack(one.gray, CORNERS, 0.01, max(3, CORNER_SPACING * one.gray.shape[1]))
    if corners is None:
        return Pair(np.empty((0, 2)), np.empty((0, 2)), motion, times)
    there, good = there_and_back(one.gray, other.gray, corners[:, 0], THERE_AND_BACK, maxLevel=4)
    return Pair(corners[good, 0].astype(np.float64), there[good].astype(np.float64), motion, times)


def fit_camera(pairs: Sequence[Pair], intrinsics: np.ndarray, forward: np.ndarray | None = None) -> CameraFit:
    """Fit the focal length and the mount.

    Args:
        pairs: of a drive.
        intrinsics: ``(3, 3)`` that were told [px].
        forward: where the robot drives, in the camera that was told ``(3,)``; None: the poses are the
            camera's own, so it has no mount.
    """
    if len(pairs) < LEAST_PAIRS:
        return CameraFit()
    drive = _Drive(pairs, intrinsics, np.zeros(3) if forward is None else forward)
    unknown = {"focal": 0, "pitch": 1, "yaw": 2, "ahead": 3}
    # gentle curves do not tell where the camera sits, a straight drive not the focal length
    fits = []
    for free in ([0],) if forward is None else ([0, 1, 2, 3], [0, 1, 2], [1, 2]):
        starts = [np.array([math.log(start), 0, 0, 0]) for start in (STARTS if 0 in free else (1.0,))]
        found, sure = _fitted(drive, starts, free)
        if sure[free].all():
            break
        fits.append((free, found, sure))
    else:  # lens and pitch may be sure though the yaw is not
        free, found, sure = next((fit for fit in fits if fit[2][:2].all()), fits[-1])
    found[0] = math.exp(found[0])
    return CameraFit(**{name: float(found[k]) for name, k in unknown.items() if k in free and sure[k]})


def floor_below(pairs: Sequence[Pair], intrinsics: np.ndarray, pitch: float) -> float | None:
    """Return how far the floor lies below the camera [m]; None if the drive does not tell.

    Corners on it share one height, which is the lowest that many of them have.

    Args:
        pairs: of a drive.
        intrinsics: ``(3, 3)`` [px].
        pitch: of the camera below the horizon [rad].
    """
    heights = [_heights_below(pair, intrinsics, level_rotation(pitch)[1]) for pair in pairs]
    ends = np.linspace(0, len(heights), PARTS + 1).astype(int).tolist()
    parts = [np.concatenate([np.empty((0, 2)), *heights[i:j]]) for i, j in pairwise(ends)]
    floor = _lowest_peak(np.concatenate(parts))
    agree = sum(abs(_lowest_peak(part) - floor) < SAME_FLOOR for part in parts)
    return math.exp(floor) if agree >= LEAST_AGREE else None


def _heights_below(pair: Pair, intrinsics: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Ln of how far corners lie below the camera [m], and its sigma ``(M, 2)``, where motion tells depth."""
    to_rays = np.linalg.inv(intrinsics)
    here, there = homogeneous(pair.here) @ to_rays.T, (homogeneous(pair.there) @ to_rays.T)[:, :2]
    turned, way = here @ pair.motion[:3, :3].T, pair.motion[:3, 3]
    moves = way[:2] - there * way[2]  # in the picture, times inverse depth
    moved = there * turned[:, 2:] - turned[:, :2]
    squared = np.maximum((moves**2).sum(1), 1e-12)
    depth = squared / np.maximum((moves * moved).sum(1), 1e-12)
    misses = np.linalg.norm(moves / depth[:, None] - moved, axis=1) * intrinsics[0, 0]
    sigma = math.sqrt(2) * TRACK_ERROR / intrinsics[0, 0] * depth / np.sqrt(squared)  # share
    below = here @ down
    sure = (misses < ON_LINE) & (sigma < MOST_SIGMA) & (below > LEAST_DOWN)
    return np.column_stack([np.log(below[sure] * depth[sure]), sigma[sure]])


def _lowest_peak(heights: np.ndarray) -> float:
    """Ln of how far below the camera [m] the lowest place of many corners is; NaN if none stands out.

    ``heights (N, 2)`` are those of :func:`_heights_below`.
    """
    from scipy.ndimage import gaussian_filter1d

    step = HEIGHTS[1] - HEIGHTS[0]
    edges = np.append(HEIGHTS, HEIGHTS[-1] + step) - step / 2
    counts = np.histogram(heights[:, 0], edges, weights=heights[:, 1] ** -2.0)[0]
    density = gaussian_filter1d(counts, SMOOTH / step, mode="constant")
    peaks = np.flatnonzero((density[1:-1] >= density[:-2]) & (density[1:-1] > density[2:])) + 1
    above = density[np.maximum(peaks - round(ABOVE / step), 0)]
    sharp = peaks[(density[peaks] > LEAST_PEAK * density.max()) & (density[peaks] > SHARP * above)]
    return float(HEIGHTS[sharp[-1]]) if len(sharp) else math.nan


def fit_error(
    pairs: Sequence[Pair], intrinsics: np.ndarray, forward: np.ndarray | None, start: np.ndarray | None
) -> tuple[float, np.ndarray]:
    """Fit focal length, pitch and yaw; return the mean cost of corners, and the fit: a next one's ``start``.

    The other arguments are those of :func:`fit_camera`. Without ``start`` several focal lengths are tried.
    """
    drive = _Drive(pairs, intrinsics, np.zeros(3) if forward is None else forward)
    free = [0] if forward is None else [0, 1, 2]
    starts = [np.array([math.log(factor), 0, 0, 0]) for factor in STARTS] if start is None else [start]
    camera, cost, _ = min((_fit(drive, one, free) for one in starts), key=lambda fit: fit[1])
    return cost / sum(len(pair.here) for pair in pairs), camera


class _Drive(NamedTuple):
    """What :func:`fit_camera` is given."""

    pairs: Sequence[Pair]
    intrinsics: np.ndarray
    forward: np.ndarray  # zeros: the poses are the camera's own


def _fitted(drive: _Drive, starts: Sequence[np.ndarray], free: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """The best fit of ``free`` ones of ln focal, pitch, yaw, ahead ``(4,)``, and which are sure ``(4,)``."""
    found = [_fit(drive, start, free) for start in starts]
    best, _, sigma = min(found, key=lambda one: one[1])
    within = (np.abs(best) < np.multiply(0.98, LIMITS)).all()
    agree = np.mean(np.abs(_off_line(best, drive)) < ON_LINE)
    if agree < LEAST_SHARE or not within:
        return best, np.zeros(4, bool)
    ends = np.linspace(0, len(drive.pairs), PARTS + 1).astype(int).tolist()
    rests = [[*drive.pairs[:i], *drive.pairs[j:]] for i, j in pairwise(ends)]
    without = [_fit(drive._replace(pairs=rest), best, free)[0] for rest in rests]
    # all fits agree on what hardly moves a corner, too: they stay where they start
    return best, np.hypot(np.std(without, axis=0) * math.sqrt(PARTS - 1), sigma) < SURE


def _fit(drive: _Drive, start: np.ndarray, free: list[int]) -> tuple[np.ndarray, float, np.ndarray]:
    """The nearest fit to ``start (4,)``, its cost, and sigma ``(4,)`` by the corners' errors."""
    from scipy.optimize import least_squares

    limits = np.array(LIMITS)[free]

    def camera(values: np.ndarray) -> np.ndarray:
        moved = start.copy()
        moved[free] = values
        return moved

    solved = least_squares(
        lambda values: _off_line(camera(values), drive),
        start[free], bounds=(-limits, limits), loss="cauchy", f_scale=TRACK_ERROR, x_scale=0.1,
    )  # fmt: skip
    sigma = np.zeros(4)
    steepness = solved.jac.T @ solved.jac + 1e-9 * np.eye(len(free))
    sigma[free] = TRACK_ERROR * np.sqrt(np.diag(np.linalg.inv(steepness)))
    return camera(solved.x), float(solved.cost), sigma


def _off_line(camera: np.ndarray, drive: _Drive) -> np.ndarray:
    """Sampson's distance of all corners from their lines [px], for ln focal, pitch, yaw, ahead ``(4,)``."""
    pairs, intrinsics, forward = drive
    focal = intrinsics[0, 0] * math.exp(camera[0])
    lens = np.array([focal, focal * intrinsics[1, 1] / intrinsics[0, 0]])
    motions = np.stack([pair.motion for pair in pairs])
    ways = motions[:, :3, 3] + camera[3] * (motions[:, :3, :3] @ forward - forward)
    mount = from_told(camera[1], camera[2])
    turns, ways = mount @ motions[:, :3, :3] @ mount.T, ways @ mount.T
    essential = np.cross(ways[:, None] / np.linalg.norm(ways, axis=1)[:, None, None], turns, axisb=1, axisc=1)
    of_corner = np.repeat(essential, [len(pair.here) for pair in pairs], axis=0)
    one, other = (
        homogeneous((np.concatenate(seen) - intrinsics[:2, 2]) / lens)
        for seen in ([pair.here for pair in pairs], [pair.there for pair in pairs])
    )
    line, back = np.einsum("nij,nj->ni", of_corner, one), np.einsum("nij,ni->nj", of_corner, other)
    length = np.sqrt((line[:, :2] ** 2).sum(1) + (back[:, :2] ** 2).sum(1))
    return np.asarray((other * line).sum(1) / length * focal)


def from_told(pitch: float, yaw: float = 0.0) -> np.ndarray:
    """Rotation ``(3, 3)`` to a camera that looks so much lower and to the left [rad], from the one told."""
    c, s = math.cos(yaw), math.sin(yaw)
    return level_rotation(pitch).T @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

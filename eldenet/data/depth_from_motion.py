"""Depth of corners that a moving camera sees from several known places.

Around each chosen picture, corners are tracked through earlier and later ones, both ways. A bundle adjustment
then solves for the depth of all corners and corrects the poses, within what odometry may be wrong: a few
percent of the way and some tenths of a degree. A corner counts if three other views agree on it (two, where
there are only two) and its depth is known to 10 %.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.linalg import block_diag

from eldenet.geometry import resize_image, resize_intrinsics

MOST_WIDTH = 640  # of the pictures in which corners are tracked [px]
CORNERS, CORNER_SPACING = 600, 0.0125  # most in a picture, and how far apart [widths]
STEP, STEP_TURN = 0.03, 0.05  # between two views [m], [rad]
NEAREST_VIEW, FARTHEST_VIEW, MOST_TURN = 0.04, 1.2, 0.7  # of a picture's views [m], [m], [rad]
SIDE_VIEWS, GROWTH = 6, 1.7  # of a picture, before and after it; from one's distance to the next one's
THERE_AND_BACK = 0.7  # by which tracking forth and back may miss a corner [px]
SAME_POINT = 1.5  # error of a view that agrees [px]
LEAST_VIEWS, LEAST_SHARE = 3, 0.6  # other views that agree; their share of those that saw the corner
MOST_SIGMA = 0.1  # of ln depth
NEAR, FAR = 0.15, 12.0  # of depth that is kept [m]
WAY_ERROR, TURN_ERROR = 0.03, 0.005  # of odometry between two views: share of the way, [rad]
TRACK_ERROR = 0.5  # of a tracked corner [px]
HEIGHT_ERROR, PITCH_ERROR = 0.02, 0.012  # of the mount: share of the height, [rad]
TURN_COUNTS = 0.3  # meters of travel that a turn of one radian counts
SWEPT_WIDTH, SWEPT_WINDOW, MOST_DIFFERENCE = 240, 7, 30.0  # of the plane sweep [px], [px], gray levels
_TO_VIEW = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_STARTS = 1 / np.geomspace(NEAR, 25, 40)  # of the search for inverse depth [1/m]


class View(NamedTuple):
    """A picture of a drive."""

    name: str  # of the frame
    image: np.ndarray  # (H, W, 3) uint8 RGB, at most MOST_WIDTH wide
    gray: np.ndarray  # the same in gray, (H, W)
    pose: np.ndarray  # (4, 4) camera to world [m]
    seconds: float | None = None  # when it was taken, if that is known [s]


class Points(NamedTuple):
    """Corners of a view with known depth."""

    pixels: np.ndarray  # (N, 2) column, row [px]
    depth: np.ndarray  # (N,) [m]
    sigma: np.ndarray  # (N,) of ln depth


@dataclass(frozen=True)
class MotionDepth:
    """Finds depth along a drive."""

    intrinsics: np.ndarray  # (3, 3) of the pictures that are given [px]
    size: tuple[int, int]  # (height, width) of these [px]
    floor: float | None = None  # height of the camera above a world's floor at z = 0 [m]; None: not known

    @property
    def seen_size(self) -> tuple[int, int]:
        """``(height, width)`` [px] of the views."""
        scale = min(1.0, MOST_WIDTH / self.size[1])
        return round(self.size[0] * scale), round(self.size[1] * scale)

    @property
    def seen_intrinsics(self) -> np.ndarray:
        """``(3, 3)`` [px] of the views."""
        return resize_intrinsics(self.intrinsics, self.size, self.seen_size)

    def view(self, name: str, picture: np.ndarray, pose: np.ndarray, seconds: float | None = None) -> View:
        """Return a picture ``(H, W, 3)`` uint8 RGB at a pose ``(4, 4)`` and a time [s] as a view."""
        image = resize_image(picture, self.seen_size)
        return View(name, image, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), pose, seconds)

    def along(self, views: Iterable[View], spacing: float) -> Iterator[tuple[View, Points]]:
        """Yield a view each ``spacing`` [m] of travel with its points; few views are kept in memory.

        Turns are travel, too (``TURN_COUNTS``).
        """
        window: deque[tuple[float, View]] = deque()
        waiting: deque[tuple[float, View]] = deque()
        travel, due = 0.0, 0.0
        for view in views:
            if window:
                way, turn = apart(window[-1][1].pose, view.pose)
                if way < STEP and turn < STEP_TURN:
                    continue
                travel += way + TURN_COUNTS * turn
            window.append((travel, view))
            if travel >= due:
                waiting.append(window[-1])
                due = max(due, travel - spacing) + spacing
            while waiting and travel - waiting[0][0] > 2 * FARTHEST_VIEW:
                yield self._solved(waiting.popleft(), window)
            first = waiting[0][0] if waiting else travel
            while window[0][0] < first - 2 * FARTHEST_VIEW:
                window.popleft()
        for one in waiting:
            yield self._solved(one, window)

    def _solved(self, one: tuple[float, View], window: Iterable[tuple[float, View]]) -> tuple[View, Points]:
        travel, view = one
        earlier = [other for at, other in reversed(list(window)) if at < travel]
        later = [other for at, other in window if at > travel]
        return view, self.points(view, earlier, later)

    def points(self, view: View, earlier: Iterable[View], later: Iterable[View]) -> Points:
        """Return the points of a view, given views before and after it, the nearest first."""
        none = Points(np.empty((0, 2)), np.empty(0), np.empty(0))
        spacing = max(3, CORNER_SPACING * view.gray.shape[1])
        corners = cv2.goodFeaturesToTrack(view.gray, CORNERS, 0.001, spacing)
        if corners is None:
            return none
        corners = corners[:, 0]
        sides = [chosen_views(view, side) for side in (earlier, later)]
        if not any(sides):
            return none
        to_rays = np.linalg.inv(self.seen_intrinsics)
        others = [*sides[0], *sides[1]]
        seen = track(view, others, corners, self.seen_intrinsics)
        motions = [np.linalg.inv(other.pose) @ view.pose for other in others]
        rays = (homogeneous(corners) @ to_rays.T)[:, :2]
        observed = np.stack([(homogeneous(points) @ to_rays.T)[:, :2] for points in seen])
        solved, sigma = bundle(rays, observed, np.stack(motions), float(self.seen_intrinsics[0, 0]))
        if self.floor is not None:
            solved, sigma = beside_floor(solved, sigma, rays, view.pose[:3, :3], self.floor)
        kept = (sigma < MOST_SIGMA * solved) & (solved > 1 / FAR) & (solved < 1 / NEAR)
        return Points(corners[kept], 1 / solved[kept], sigma[kept] / solved[kept])


def homogeneous(points: np.ndarray) -> np.ndarray:
    """Points ``(N, 2)`` as ``(N, 3)`` with a last 1, float64."""
    return np.column_stack([points, np.ones(len(points))]).astype(np.float64)


def apart(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Way [m] and turn [rad] between two poses ``(4, 4)``."""
    cosine = (np.trace(one[:3, :3].T @ other[:3, :3]) - 1) / 2
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])), float(np.arccos(np.clip(cosine, -1, 1)))


def chosen_views(view: View, others: Iterable[View]) -> list[View]:
    """Return views at growing distance from ``view``, of others in the order of their distance in time."""
    found: list[View] = []
    least = NEAREST_VIEW
    for other in others:
        way, turn = apart(view.pose, other.pose)
        if way > FARTHEST_VIEW or turn > MOST_TURN or len(found) == SIDE_VIEWS:
            break
        if way >= least:
            found.append(other)
            least = max(GROWTH * way, way + STEP)
    return found


def track(
    view: View, others: Sequence[View], corners: np.ndarray, intrinsics: np.ndarray
) -> list[np.ndarray]:
    """Return where corners ``(N, 2)`` [px] of a view lie in each other view; NaN where they are lost.

    Around a corner the other view is warped as a plane at the depth that :func:`sweep` finds there, so even
    near things look alike in both.
    """
    inverse = sweep(view, others, corners, intrinsics)
    size, to_rays = view.gray.shape[::-1], np.linalg.inv(intrinsics)
    found = []
    for other in others:
        motion = np.linalg.inv(other.pose) @ view.pose
        points = np.full((len(corners), 2), np.nan)
        for one in np.unique(inverse):
            here = np.flatnonzero(inverse == one)
            plane = intrinsics @ _of_plane(motion, one) @ to_rays
            warped = cv2.warpPerspective(other.gray, plane, size, flags=_TO_VIEW)
            there, good = there_and_back(
                view.gray, warped, corners[here], THERE_AND_BACK, maxLevel=0, criteria=(3, 20, 0.03)
            )
            moved = homogeneous(there) @ plane.T
            at = moved[:, :2] / np.maximum(moved[:, 2:], 0.05)
            good &= (at > 1).all(1) & (at < np.subtract(size, 2)).all(1)
            points[here[good]] = at[good]
        found.append(points)
    return found


def there_and_back(
    one: np.ndarray, other: np.ndarray, corners: np.ndarray, most: float, **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Track corners ``(N, 2)`` [px] from a gray picture to another and back, with OpenCV's ``options``.

    Returns:
        Where they lie there ``(N, 2)``, and which come back to within ``most`` [px] ``(N,)``.
    """
    flow: Any = partial(cv2.calcOpticalFlowPyrLK, winSize=(15, 15), **options)
    given = np.ascontiguousarray(corners[:, None], np.float32)
    there, ok, _ = flow(one, other, given, None)
    back, ok_back, _ = flow(other, one, there, None)
    misses = np.linalg.norm((back - given)[:, 0], axis=1)
    return there[:, 0], (np.hstack([ok, ok_back]) > 0).all(1) & (misses < most)


def _of_plane(motion: np.ndarray, inverse: float) -> np.ndarray:
    """``(3, 3)`` from rays of a view to those of another, of a plane that faces it at an inverse depth [1/m].

    ``motion (4, 4)`` is from the view to the other [m].
    """
    return motion[:3, :3] + inverse * np.outer(motion[:3, 3], (0, 0, 1))


def sweep(view: View, others: Sequence[View], corners: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Return the inverse depth ``(N,)`` [1/m] at which other views look most like this one around corners.

    Each is warped as a plane at each depth of a grid (plane sweep); the better half of the views counts.
    """
    size = tuple(max(1, round(side * min(1.0, SWEPT_WIDTH / view.gray.shape[1]))) for side in view.gray.shape)
    matrix = resize_intrinsics(intrinsics, view.gray.shape, size)
    to_rays = np.linalg.inv(matrix)
    at = (corners + 0.5) * size[1] / view.gray.shape[1] - 0.5
    columns, rows = np.rint(at).astype(int).T
    columns, rows = columns.clip(0, size[1] - 1), rows.clip(0, size[0] - 1)
    now, unlike = _flattened(view.gray, size), MOST_DIFFERENCE * 4
    costs = np.empty((len(others), len(_STARTS), len(corners)), np.float32)
    for number, other in enumerate(others):
        motion = np.linalg.inv(other.pose) @ view.pose
        then = _flattened(other.gray, size)
        for place, inverse in enumerate(_STARTS):
            plane = matrix @ _of_plane(motion, inverse) @ to_rays
            warped = cv2.warpPerspective(then, plane, size[::-1], flags=_TO_VIEW, borderValue=unlike)
            difference = np.minimum(np.abs(warped - now), MOST_DIFFERENCE)
            costs[number, place] = cv2.blur(difference, (SWEPT_WINDOW, SWEPT_WINDOW))[rows, columns]
    half = np.sort(costs, axis=0)[: (len(others) + 1) // 2].mean(axis=0)
    return np.asarray(_STARTS[half.argmin(axis=0)])


def _flattened(gray: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A gray picture at another size without its local mean, float32, so that exposure does not count."""
    small = cv2.resize(gray, size[::-1], interpolation=cv2.INTER_AREA).astype(np.float32)
    return small - cv2.blur(small, (15, 15))


def bundle(
    rays: np.ndarray, seen: np.ndarray, motions: np.ndarray, focal: float
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for inverse depth, with poses that are known up to odometry's errors.

    Args:
        rays: ``(N, 2)`` of points in the view, x / z and y / z.
        seen: ``(V, N, 2)`` the same in the other views; NaN where a point is lost.
        motions: ``(V, 4, 4)`` from the view to each other view [m].
        focal: pixels per unit of ``rays``.

    Returns:
        Inverse depth ``(N,)`` [1/m] and its sigma, infinite where too few views agree.
    """
    count, points = len(motions), homogeneous(rays)
    turns, ways = motions[:, :3, :3].copy(), motions[:, :3, 3].copy()
    known = np.isfinite(seen).all(-1)
    seen = np.where(known[..., None], seen, 0.0)
    inverse = _first_guess(points, seen, known, turns, ways, 4 / focal)
    lengths = np.linalg.norm(ways, axis=1)
    prior = np.repeat(np.column_stack([np.full(count, TURN_ERROR), WAY_ERROR * lengths]), 3, axis=1) ** -2.0
    moved = np.zeros((count, 6))  # turn [rad] and way [m] so far
    for trial in range(10):  # Gauss-Newton; errors far above width hardly count (Geman and McClure)
        width = (3.0 if trial < 4 else 1.0) / focal
        error, by_inverse, by_pose = _errors(points, inverse, seen, turns, ways)
        squared = (error**2).sum(-1)
        weight = known / (1 + squared / width**2) ** 2 * (focal / TRACK_ERROR) ** 2
        of_point = (weight[..., None] * by_inverse**2).sum((0, 2)) + 1e-9
        across = np.einsum("vn,vnk,vnkp->vpn", weight, by_inverse, by_pose).reshape(6 * count, -1)
        of_pose = np.einsum("vn,vnkp,vnkq->vpq", weight, by_pose, by_pose)
        matrix = block_diag(*of_pose) + np.diag(prior.ravel())
        right_point = -(weight[..., None] * by_inverse * error).sum((0, 2))
        right_pose = -np.einsum("vn,vnk,vnkp->vp", weight, error, by_pose) - prior * moved
        reduced = matrix - (across / of_point) @ across.T  # the points are eliminated (Schur complement)
        step = np.linalg.solve(reduced, right_pose.ravel() - across @ (right_point / of_point))
        inverse = inverse + np.clip((right_point - across.T @ step) / of_point, -0.3 * inverse, 0.5 * inverse)
        for v, change in enumerate(step.reshape(count, 6)):
            turns[v] = cv2.Rodrigues(change[:3])[0] @ turns[v]
            ways[v] += change[3:]
            moved[v] += change
    error = _errors(points, inverse, seen, turns, ways)[0]
    agrees = known & (np.linalg.norm(error, axis=-1) * focal < SAME_POINT)
    variance = 1 / of_point
    variance += np.einsum("pn,pn->n", across, np.linalg.solve(reduced, across)) / of_point**2
    enough = (agrees.sum(0) >= min(LEAST_VIEWS, max(2, count))) & (
        agrees.sum(0) >= LEAST_SHARE * known.sum(0)
    )
    return inverse, np.where(enough, np.sqrt(variance), np.inf)


def _first_guess(
    points: np.ndarray, seen: np.ndarray, known: np.ndarray, turns: np.ndarray, ways: np.ndarray, width: float
) -> np.ndarray:
    """The inverse depth of a grid that most views agree on, errors above ``width`` counting alike."""
    costs = []
    for start in _STARTS:
        error = _errors(points, np.full(len(points), start), seen, turns, ways)[0]
        costs.append((known * np.minimum((error**2).sum(-1), width**2)).sum(0))
    return np.asarray(_STARTS[np.argmin(costs, axis=0)])


def _errors(
    points: np.ndarray, inverse: np.ndarray, seen: np.ndarray, turns: np.ndarray, ways: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By how much views miss ``points (N, 3)`` at their inverse depth, and how that changes.

    Returns:
        Errors ``(V, N, 2)``, in units of rays, and their change with inverse depth ``(V, N, 2)`` and with
        turn and way of the pose ``(V, N, 2, 6)``.
    """
    turned = points @ turns.transpose(0, 2, 1)
    moved = inverse[:, None] * ways[:, None]
    x, y, z = np.moveaxis(turned + moved, -1, 0)
    z = np.maximum(z, 0.05)
    u, v, zero = x / z, y / z, np.zeros_like(z)
    error = np.stack([u, v], axis=-1) - seen
    by_point = np.stack([np.stack([1 / z, zero, -u / z], -1), np.stack([zero, 1 / z, -v / z], -1)], axis=-2)
    a, b, c = np.moveaxis(turned, -1, 0)  # d (exp(w) t) / dw = -[t]x
    by_turn = np.stack(
        [np.stack([zero, c, -b], -1), np.stack([-c, zero, a], -1), np.stack([b, -a, zero], -1)], axis=-2
    )
    by_pose = np.concatenate([by_point @ by_turn, by_point * inverse[:, None, None]], axis=-1)
    return error, np.einsum("vnkp,vp->vnk", by_point, ways), by_pose


def beside_floor(
    inverse: np.ndarray, sigma: np.ndarray, rays: np.ndarray, rotation: np.ndarray, height: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return inverse depth and sigma, nearer to the floor where points may lie on it.

    Sigma of points below the floor is infinite. Points have ``inverse`` depth ``(N,)`` [1/m], its ``sigma``,
    and ``rays (N, 2)``; ``rotation (3, 3)`` is camera to world, z up, and ``height`` the camera's [m].
    """
    down = -(homogeneous(rays) @ rotation.T)[:, 2]
    floor = down / height
    error = np.hypot(PITCH_ERROR, HEIGHT_ERROR * down) / height
    both = np.hypot(sigma, error)
    on_floor = np.isfinite(sigma) & (down > 0) & (np.abs(inverse - floor) < 2 * both)
    share = np.where(np.isfinite(sigma), sigma, 1.0) ** 2 / both**2
    below = inverse < floor - 3 * both
    fused = np.where(on_floor, inverse + share * (floor - inverse), inverse)
    spread = np.where(on_floor, error * np.sqrt(share), sigma)
    return fused, np.where(below, np.inf, spread)

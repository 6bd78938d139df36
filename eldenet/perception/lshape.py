"""Heading of an object from the two sides that are seen: search-based L-shape fitting, and boxes on it.

Zhang, Xu, Dong, Dolan, "Efficient L-Shape Fitting for Vehicle Detection Using Laser Scanners", IV 2017: of
all rectangles around the points, the one whose edges the points are closest to.
"""

from typing import NamedTuple

import numpy as np

_ANGLES = np.arange(45) * np.pi / 90  # a rectangle is the same after a quarter turn
_CHUNK = 32  # objects at once: a few MB


class Extents(NamedTuple):
    """Points in the axes of a box: ``(N,)`` each, along the length (u) and the width (v) [m]."""

    low_u: np.ndarray
    high_u: np.ndarray
    low_v: np.ndarray
    high_v: np.ndarray


def to_axes(x: np.ndarray, z: np.ndarray, yaw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates along a box's length and width of ground points."""
    c, s = np.cos(yaw), np.sin(yaw)
    return x * c - z * s, x * s + z * c


def from_axes(u: np.ndarray, v: np.ndarray, yaw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The other way round."""
    c, s = np.cos(yaw), np.sin(yaw)
    return u * c + v * s, -u * s + v * c


def extents(points: np.ndarray, weight: np.ndarray, yaw: np.ndarray) -> Extents:
    """Extents of ``points (N, P, 3)`` with ``weight (N, P)`` along boxes of ``yaw (N,)``."""
    u, v = to_axes(points[..., 0], points[..., 2], yaw[:, None])
    gone = weight <= 0
    low = [np.where(gone, np.inf, value).min(1) for value in (u, v)]
    high = [np.where(gone, -np.inf, value).max(1) for value in (u, v)]
    return Extents(low[0], high[0], low[1], high[1])


def closeness_yaw(points: np.ndarray, weight: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Yaw ``(N,)`` in [0, pi/2) of the rectangle that the points hug.

    Args:
        points: ``(N, P, 3)`` level points [m].
        weight: ``(N, P)``, 0 for padding.
        tolerance: ``(N,)`` distance below which closer is no better [m].
    """
    yaw = np.zeros(len(points))
    for first in range(0, len(points), _CHUNK):
        part = slice(first, first + _CHUNK)
        u, v = to_axes(points[part, None, :, 0], points[part, None, :, 2], _ANGLES[None, :, None])
        use = weight[part, None, :] > 0
        gap = [_to_nearest_edge(value, use) for value in (u, v)]
        gap_to = np.maximum(np.minimum(gap[0], gap[1]), tolerance[part, None, None])
        score = (use / gap_to).sum(-1)
        yaw[part] = _ANGLES[score.argmax(1)]
    return yaw


def _to_nearest_edge(value: np.ndarray, use: np.ndarray) -> np.ndarray:
    low = np.where(use, value, np.inf).min(-1, keepdims=True)
    high = np.where(use, value, -np.inf).max(-1, keepdims=True)
    return np.asarray(np.minimum(value - low, high - value))


def length_axis(found: Extents, yaw: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Yaw ``(N,)`` or a quarter turn more, whichever lets the prior's length and width fit what is seen.

    A side that is seen face-on shows its whole length; one that is longer than the prior's does not fit.
    """
    seen = np.stack([found.high_u - found.low_u, found.high_v - found.low_v], axis=1)
    middle = from_axes((found.low_u + found.high_u) / 2, (found.low_v + found.high_v) / 2, yaw)
    ray = np.stack(middle, axis=1) / np.maximum(np.hypot(*middle), 1e-9)[:, None]
    along, across = to_axes(ray[:, 0], ray[:, 1], yaw)
    facing = np.abs(np.stack([across, along], axis=1))  # of the side that shows the extent along u, along v

    def misfit(wanted: np.ndarray) -> np.ndarray:
        excess, lack = np.maximum(seen - wanted, 0), np.maximum(wanted - seen, 0)
        return np.asarray((excess + facing**2 * lack).sum(1))

    turned = misfit(size[:, [1, 0]]) < misfit(size[:, [0, 1]])
    return np.where(turned, yaw + np.pi / 2, yaw)


def anchored(found: Extents, yaw: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Center ``(N,)`` x and z of boxes of ``size (N, 3)`` that touch the points with their seen sides."""
    centers = []
    for low, high, extent in (
        (found.low_u, found.high_u, size[:, 0]),
        (found.low_v, found.high_v, size[:, 1]),
    ):
        # A side is an anchor where the origin lies beyond it; seen end on, the points' own middle is better.
        centers.append(
            np.where(low > 0, low + extent / 2, np.where(high < 0, high - extent / 2, (low + high) / 2))
        )
    return from_axes(centers[0], centers[1], yaw)

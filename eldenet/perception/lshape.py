"""Heading of an object from its two visible sides: search-based L-shape fitting.

Zhang, Xu, Dong, Dolan, "Efficient L-Shape Fitting for Vehicle Detection Using Laser Scanners", IV 2017: of
all rectangles around the points, choose the one whose edges are closest to the points.
"""

import numpy as np

_ANGLES = np.arange(45) * np.pi / 90  # a rectangle is the same after a quarter turn
_CHUNK = 32  # objects at once: a few MB


def to_axes(ground: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Coordinates ``(..., 2)`` along the length (u) and width (v) of a box of ground points (x, z)."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, z = ground[..., 0], ground[..., 1]
    return np.stack([x * c - z * s, x * s + z * c], axis=-1)


def from_axes(axes: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Ground points (x, z) ``(..., 2)`` of coordinates along the length (u) and width (v) of a box."""
    return to_axes(axes, -yaw)  # a rotation


def extents(points: np.ndarray, weight: np.ndarray, yaw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (u, v) ``(N, 2)`` [m] of ``points (N, P, 3)`` in the axes of boxes of ``yaw (N,)``.

    :func:`length_axis` and :func:`anchored` want them from the camera, not from another origin.
    Points with ``weight (N, P)`` 0 are padding.
    """
    axes = to_axes(points[..., [0, 2]], yaw[:, None])
    padding = (weight <= 0)[..., None]
    return np.where(padding, np.inf, axes).min(1), np.where(padding, -np.inf, axes).max(1)


def closeness_yaw(points: np.ndarray, weight: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Yaw ``(N,)`` in [0, pi/2) of the rectangle whose edges are closest to the points.

    Args:
        points: ``(N, P, 3)`` level points [m].
        weight: ``(N, P)``, 0 for padding.
        tolerance: ``(N,)`` distance below which closer is no better [m].
    """
    yaw = np.zeros(len(points))
    for first in range(0, len(points), _CHUNK):
        part = slice(first, first + _CHUNK)
        axes = to_axes(points[part, None][..., [0, 2]], _ANGLES[None, :, None])  # (n, angles, P, 2)
        use = (weight[part] > 0)[:, None, :]
        low = np.where(use[..., None], axes, np.inf).min(-2, keepdims=True)
        high = np.where(use[..., None], axes, -np.inf).max(-2, keepdims=True)
        gap = np.minimum(axes - low, high - axes).min(-1)
        score = (use / np.maximum(gap, tolerance[part, None, None])).sum(-1)
        yaw[part] = _ANGLES[score.argmax(1)]
    return yaw


def length_axis(found: tuple[np.ndarray, np.ndarray], yaw: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Yaw ``(N,)``, or a quarter turn more where the class's length and width then fit the extents better.

    A side that faces the camera shows its whole length; a side longer than the class's does not fit.
    """
    low, high = found
    seen = high - low
    middle = from_axes((low + high) / 2, yaw)
    ray = middle / np.maximum(np.hypot(middle[:, 0], middle[:, 1]), 1e-9)[:, None]
    facing = np.abs(to_axes(ray, yaw)[:, ::-1])  # the sides that show the extents along u and v

    def misfit(wanted: np.ndarray) -> np.ndarray:
        """How badly sides ``(N, 2)`` [m] fit what is seen ``(N,)``."""
        excess, lack = np.maximum(seen - wanted, 0), np.maximum(wanted - seen, 0)
        return np.asarray((excess + facing**2 * lack).sum(1))

    turned = misfit(size[:, [1, 0]]) < misfit(size[:, [0, 1]])
    return np.where(turned, yaw + np.pi / 2, yaw)


def anchored(found: tuple[np.ndarray, np.ndarray], yaw: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Center (x, z) ``(N, 2)`` of boxes of ``size (N, 3)`` whose visible sides touch the points."""
    low, high = found
    half = size[:, :2] / 2
    # a side is an anchor where the origin lies beyond it; else the points' own middle is better
    middle = np.where(low > 0, low + half, np.where(high < 0, high - half, (low + high) / 2))
    return from_axes(middle, yaw)

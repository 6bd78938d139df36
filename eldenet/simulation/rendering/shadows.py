"""Shadows: what a light sees of a frame's points, cast at a fraction of the resolution."""

from typing import Any

import cv2
import numpy as np

from eldenet.simulation.rendering.camera import Hits, cast_rays

_STRIDE = 4


def shadow(
    model: Any,
    data: Any,
    light: np.ndarray,
    hits: Hits,
    size: tuple[int, int],
    *,
    stride: int = _STRIDE,
    far: float = 30.0,
) -> np.ndarray:
    """Return the visibility ``(N,)`` of a light, cast at ``1 / stride`` of the resolution and softened.

    It is 1 in the light and 0.12 in full shadow, where scattered light remains. What is farther than ``far``
    [m] from the light counts as lit.
    """
    height, width = size
    points = hits.point.reshape(3, height, width)[:, 1::stride, 1::stride]
    rows, columns = points.shape[1:]
    rays = points.reshape(3, -1).astype(np.float64) - light[:, None]
    distance = np.sqrt(np.square(rays).sum(axis=0))
    rays /= np.maximum(distance, 1e-9)
    reached, _, _ = cast_rays(model, data, light, rays.T, far, normals=False)
    lit = ((reached < 0) | (reached > distance - 0.03 - 0.004 * distance)).astype(np.float32)
    lit = cv2.GaussianBlur(lit.reshape(rows, columns), (3, 3), 0.8)
    lit = cv2.resize(lit, (width, height), interpolation=cv2.INTER_LINEAR)
    return lit.ravel() * np.float32(0.88) + np.float32(0.12)

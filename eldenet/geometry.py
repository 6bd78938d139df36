"""Pinhole geometry: intrinsics under image operations, back-projection, disparity.

Convention: pixel centres lie on whole numbers (the first pixel's centre is (0, 0)), x right, y down,
z forward, as in OpenCV. A resize by s therefore moves a point u to (u + 0.5) * s - 0.5.
"""

import numpy as np


def pinhole(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Build the ``(3, 3)`` intrinsic matrix [px]."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def resize_intrinsics(
    intrinsics: np.ndarray, size_from: tuple[int, int], size_to: tuple[int, int]
) -> np.ndarray:
    """Intrinsics after a resize; depth does not change. Sizes are ``(height, width)`` [px]."""
    sy, sx = size_to[0] / size_from[0], size_to[1] / size_from[1]
    matrix = np.array([[sx, 0.0, 0.5 * sx - 0.5], [0.0, sy, 0.5 * sy - 0.5], [0.0, 0.0, 1.0]])
    return matrix @ intrinsics


def crop_intrinsics(intrinsics: np.ndarray, top: int, left: int) -> np.ndarray:
    """Intrinsics after ``image[top:, left:]``; depth does not change."""
    shifted = np.array(intrinsics, dtype=np.float64)
    shifted[0, 2] -= left
    shifted[1, 2] -= top
    return shifted


def disparity_to_depth(disparity: np.ndarray, focal: float, baseline: float) -> np.ndarray:
    """Depth ``baseline * focal / disparity`` ``(H, W)`` float32 [m]; 0 = unknown, in both.

    Args:
        disparity: ``(H, W)`` [px of the picture that ``focal`` speaks of, however it was resized since].
        focal: fx [px].
        baseline: distance of the two cameras [m].
    """
    known = disparity > 0  # no disparity is infinitely far, which no number stands for
    depth = baseline * focal / np.where(known, disparity, 1.0).astype(np.float64)
    return np.where(known, depth, 0.0).astype(np.float32)


def crop_corner(size: tuple[int, int], crop: tuple[int, int], anchor: str) -> tuple[int, int]:
    """Top and left [px] of a crop ``(height, width)`` of a frame of ``size``.

    Convention: "center" rounds half to even, as torchvision's centre crop; "bottom" is BTS's KB crop: the
    lowest rows, ``(width - crop width) // 2`` from the left.
    """
    if anchor == "bottom":
        return size[0] - crop[0], (size[1] - crop[1]) // 2
    return round((size[0] - crop[0]) / 2), round((size[1] - crop[1]) / 2)


def resize_sparse(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Move every known point of ``depth (H, W)`` [m] to its pixel of a map of ``size`` [px].

    Nothing is interpolated or repeated. Of several points that meet in a pixel the nearest stays: it hides
    the others. 0 is unknown.
    """
    rows, cols = np.nonzero(depth)
    # a pixel's centre at u + 0.5 goes to (u + 0.5) * s, so to pixel floor((u + 0.5) * s)
    to_rows = (2 * rows + 1) * size[0] // (2 * depth.shape[0])
    to_cols = (2 * cols + 1) * size[1] // (2 * depth.shape[1])
    return nearest_points(to_rows, to_cols, depth[rows, cols], size)


def nearest_points(
    rows: np.ndarray, cols: np.ndarray, depth: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Depth map ``size`` [m] of points ``(N,)`` at whole pixels: a pixel's nearest wins, 0 is unknown."""
    points = np.full(size, np.inf, depth.dtype)
    np.minimum.at(points, (rows, cols), depth)
    points[np.isinf(points)] = 0
    return points


def back_project(depth: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Camera points ``(H, W, 3)`` [m] of a depth map ``(H, W)`` [m]: z is the depth itself."""
    rows, cols = np.indices(depth.shape, dtype=np.float64)
    x = (cols - intrinsics[0, 2]) / intrinsics[0, 0] * depth
    y = (rows - intrinsics[1, 2]) / intrinsics[1, 1] * depth
    return np.stack([x, y, depth], axis=-1)

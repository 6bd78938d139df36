"""LiDAR scans of KITTI raw as sparse depth in a camera's picture."""

from pathlib import Path

import numpy as np

from eldenet.data.array_files import read_bytes
from eldenet.geometry import nearest_points

PROJECTIONS = ("camera", "eigen")


def read_scan(path: Path) -> np.ndarray:
    """Points ``(N, 4)`` float32 of a scan: x forward, y left, z up [m], reflectance.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: naming a file that is empty, cut, or holds numbers that are no points.
    """
    content = read_bytes(path)
    if not content or len(content) % 16:
        raise ValueError(
            f"{path} is cut or is no scan ({len(content)} bytes, points are 16 each): fetch it again"
        )
    points = np.frombuffer(content, "<f4").reshape(-1, 4)
    if not np.isfinite(points).all() or not 1 < np.abs(points[:, :3]).max() <= 1000:
        raise ValueError(f"{path} holds numbers that are no points within 1 km: fetch it again")
    return points


def project_scan(
    points: np.ndarray, matrix: np.ndarray, size: tuple[int, int], projection: str = "camera"
) -> np.ndarray:
    """Sparse depth ``(H, W)`` float64 [m], 0 = unknown; in each pixel the nearest point stays.

    Convention: "camera" is what the geometry says: depth is the distance along the camera's axis, the pixel
    is the nearest one (centers on whole numbers). "eigen" is how the field's 697 test frames are made (Eigen,
    monodepth, monodepth2): one pixel up and to the left, as in KITTI's MATLAB code, and depth is the LiDAR's
    own x, 0.27 m more. Not repeated: monodepth's test for points that share a pixel also takes some of two
    pixels for one.

    Args:
        points: ``(N, 3)`` or ``(N, 4)`` in the LiDAR's frame [m].
        matrix: ``(3, 4)``, see :func:`~eldenet.data.kitti_lidar.velodyne_to_image`.
        size: ``(height, width)`` of the picture [px].
        projection: "camera" or "eigen".
    """
    ahead = points[points[:, 0] >= 0, :3].astype(np.float64)
    u, v, depth = (ahead @ matrix[:, :3].T + matrix[:, 3]).T
    front = depth > 0
    u, v, depth, forward = u[front], v[front], depth[front], ahead[front, 0]
    cols, rows = np.round(u / depth), np.round(v / depth)
    if projection == "eigen":
        cols, rows, depth = cols - 1, rows - 1, forward
    inside = (rows >= 0) & (rows < size[0]) & (cols >= 0) & (cols < size[1]) & (depth > 0)
    rows, cols = rows[inside].astype(np.int64), cols[inside].astype(np.int64)
    return nearest_points(rows, cols, depth[inside], size)

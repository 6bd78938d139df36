"""KITTI's calibration files and LiDAR scans, and the scans as sparse depth in a camera's picture.

Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR 2013, section 4. One pair of files per date:
``<date>/calib_cam_to_cam.txt`` and ``<date>/calib_velo_to_cam.txt``.
"""

from pathlib import Path

import numpy as np

from eldenet.data.array_files import read_bytes
from eldenet.geometry import PinholeCamera, nearest_points
from eldenet.system.files import read_text

#: Height of the cameras above the road [m]: IJRR 2013, figure 3.
CAMERA_HEIGHT = 1.65
CAM_TO_CAM, VELO_TO_CAM = "calib_cam_to_cam.txt", "calib_velo_to_cam.txt"
PROJECTIONS = ("camera", "eigen")


def read_calibration(path: Path) -> dict[str, np.ndarray]:
    """Return the lines ``key: numbers`` of a calibration file; the date, which is none, is skipped.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is not text or has no such line.
    """
    entries = {}
    text = read_text(path, "fetch it again, from KITTI's calibration zip of that date")
    for line in text.splitlines():
        key, _, numbers = line.partition(":")
        try:
            entries[key.strip()] = np.array([float(number) for number in numbers.split()])
        except ValueError:
            continue
    if not entries:
        raise ValueError(f"{path} has no line 'key: numbers': is it KITTI's? If so, fetch it again")
    return entries


def entry(path: Path, key: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return one entry of a calibration file as a matrix of ``shape``.

    Raises:
        ValueError: the key is missing, or has too few, too many or infinite numbers.
    """
    entries = read_calibration(path)
    if key not in entries:
        raise ValueError(f"{path} has no {key!r}, only {', '.join(sorted(entries))}: fetch it again")
    numbers = entries[key]
    if numbers.size != np.prod(shape) or not np.isfinite(numbers).all():
        raise ValueError(
            f"{path}: {key} has {numbers.size} numbers, but {np.prod(shape)} finite ones are needed: "
            "fetch it again"
        )
    return numbers.reshape(shape)


def object_camera(picture: Path) -> PinholeCamera | None:
    """Return the camera of a picture of the object benchmark, in the frame of rectified camera 0.

    ``image_2/000001.png`` has its own ``calib/000001.txt``, whose P2 is the camera. None: no such file.

    Raises:
        ValueError: the calibration is not complete.
    """
    folder, _, number = picture.parent.name.partition("_")
    calibration = picture.parent.parent / "calib" / f"{picture.stem}.txt"
    if folder != "image" or number not in ("0", "1", "2", "3") or not calibration.is_file():
        return None
    return projection_camera(calibration, f"P{number}")


def projection_camera(path: Path, key: str) -> PinholeCamera:
    """Return the camera of a projection ``(3, 4)`` in a calibration file.

    Raises:
        ValueError: the projection is missing, or that of no camera.
    """
    matrix = entry(path, key, (3, 4))
    try:
        return PinholeCamera.from_projection(matrix)
    except ValueError as error:
        raise ValueError(
            f"{path}: {key} has no focal length of a camera ({error}): fetch it again"
        ) from error


def rectified_intrinsics(folder: Path, camera: int) -> np.ndarray:
    """Return the intrinsics ``(3, 3)`` [px] of the rectified pictures of ``camera`` (0 to 3) on a date."""
    return projection_camera(folder / CAM_TO_CAM, f"P_rect_{camera:02d}").intrinsics


def velodyne_to_image(folder: Path, camera: int) -> np.ndarray:
    """Return the projection ``(3, 4)`` of homogeneous LiDAR points [m] to ``(u z, v z, z)`` in ``camera``.

    ``P_rect_0N * R_rect_00 * [R | T]``, IJRR 2013, equation 7.
    """
    rotation = np.eye(4)
    rotation[:3, :3] = entry(folder / CAM_TO_CAM, "R_rect_00", (3, 3))
    rigid = np.eye(4)
    rigid[:3, :3] = entry(folder / VELO_TO_CAM, "R", (3, 3))
    rigid[:3, 3] = entry(folder / VELO_TO_CAM, "T", (3,))
    return entry(folder / CAM_TO_CAM, f"P_rect_{camera:02d}", (3, 4)) @ rotation @ rigid


def read_scan(path: Path) -> np.ndarray:
    """Return the points ``(N, 4)`` float32 of a scan: x forward, y left, z up [m], reflectance.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is empty or truncated, its numbers cannot be points, or are not four per point.
    """
    content = read_bytes(path)
    if not content or len(content) % 16:
        raise ValueError(
            f"{path} is truncated or not a scan ({len(content)} bytes; a point has 16): fetch it again"
        )
    points = np.frombuffer(content, "<f4").reshape(-1, 4)
    if not np.isfinite(points).all() or not 1 < np.abs(points[:, :3]).max() <= 1000:
        raise ValueError(f"{path} has coordinates that are not within 1 km: fetch it again")
    low, high = points[:, 3].min(), points[:, 3].max()
    if low < 0 or high > 1:
        others = [str(n) for n in (3, 5, 6) if not len(content) % (4 * n)]
        may = f"; it may hold {' or '.join(others)} columns" if others else ""
        raise ValueError(
            f"{path}: the fourth of each four numbers is {low:g} to {high:g}, KITTI's reflectance is 0 to 1"
            f"{may}: write x, y, z [m] and reflectance as float32"
        )
    return points


def project_scan(
    points: np.ndarray, matrix: np.ndarray, size: tuple[int, int], projection: str = "camera"
) -> np.ndarray:
    """Return sparse depth ``(H, W)`` float64 [m], 0 = unknown; the nearest point in each pixel counts.

    Convention: "camera" follows the geometry: depth is the distance along the camera's axis, a point falls
    into the nearest pixel (centers on whole numbers). "eigen" is how the field's 697 test frames are made
    (Eigen, monodepth, monodepth2): one pixel up and to the left, as in KITTI's MATLAB code, and depth is the
    LiDAR's x, 0.27 m more. We do not copy monodepth's test for points that share a pixel, which mistakes some
    pairs of pixels for one.

    Args:
        points: ``(N, 3)`` or ``(N, 4)`` in the LiDAR's frame [m].
        matrix: ``(3, 4)``, see :func:`velodyne_to_image`.
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

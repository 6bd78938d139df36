"""KITTI's calibration files: intrinsics of a rectified camera, and where a LiDAR point lands in its picture.

Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR 2013, section 4. One pair of files per date:
``<date>/calib_cam_to_cam.txt`` and ``<date>/calib_velo_to_cam.txt``.
"""

from pathlib import Path

import numpy as np

from eldenet.data.array_files import read_text

CAM_TO_CAM, VELO_TO_CAM = "calib_cam_to_cam.txt", "calib_velo_to_cam.txt"


def read_calibration(path: Path) -> dict[str, np.ndarray]:
    """Lines ``key: numbers`` of a calibration file; lines without numbers (the date) are passed over.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: for a file that is no text or holds no such line.
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
        raise ValueError(f"{path} holds no line 'key: numbers': is it KITTI's? fetch it again")
    return entries


def entry(path: Path, key: str, shape: tuple[int, ...]) -> np.ndarray:
    """One entry of a calibration file, as a matrix of ``shape``.

    Raises:
        ValueError: naming the key that is missing, or has another count of numbers or one that is not finite.
    """
    entries = read_calibration(path)
    if key not in entries:
        raise ValueError(f"{path} has no {key!r}, only {', '.join(sorted(entries))}: fetch it again")
    numbers = entries[key]
    if numbers.size != np.prod(shape) or not np.isfinite(numbers).all():
        raise ValueError(
            f"{path}: {key} holds {numbers.size} numbers, {np.prod(shape)} finite ones are needed: is it cut?"
        )
    return numbers.reshape(shape)


def rectified_intrinsics(folder: Path, camera: int) -> np.ndarray:
    """Intrinsics ``(3, 3)`` [px] of the rectified pictures of ``camera`` (0 to 3) of the date in ``folder``.

    ``P_rect_0N`` is enough: files that hold only these keys do.
    """
    matrix = entry(folder / CAM_TO_CAM, f"P_rect_{camera:02d}", (3, 4))[:, :3]
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise ValueError(f"{folder / CAM_TO_CAM}: P_rect_{camera:02d} has no focal length: fetch it again")
    return np.array(matrix)


def velodyne_to_image(folder: Path, camera: int) -> np.ndarray:
    """Projection ``(3, 4)`` of homogeneous LiDAR points [m] to ``(u z, v z, z)`` of rectified ``camera``.

    ``P_rect_0N * R_rect_00 * [R | T]``, IJRR 2013, equation 7.
    """
    rotation = np.eye(4)
    rotation[:3, :3] = entry(folder / CAM_TO_CAM, "R_rect_00", (3, 3))
    rigid = np.eye(4)
    rigid[:3, :3] = entry(folder / VELO_TO_CAM, "R", (3, 3))
    rigid[:3, 3] = entry(folder / VELO_TO_CAM, "T", (3,))
    return entry(folder / CAM_TO_CAM, f"P_rect_{camera:02d}", (3, 4)) @ rotation @ rigid

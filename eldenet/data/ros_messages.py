"""Arrays of ROS messages, whoever gives the classes: ROS itself, or rosbags without ROS."""

import math
from typing import Any

import numpy as np

from eldenet.geometry import check_intrinsics

COLORS = {  # encoding -> channels, and which of them are red, green and blue
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
}
DEPTHS = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 0.001), "mono16": (np.uint16, 0.001)}


def seconds(stamp: Any) -> float:
    """Time of a ``builtin_interfaces/Time`` [s]."""
    return stamp.sec + stamp.nanosec * 1e-9


def read_color(image: Any) -> np.ndarray:
    """``(H, W, 3)`` uint8 RGB of a ``sensor_msgs/Image``.

    Raises:
        ValueError: the encoding is not one of ``COLORS``, or the data do not fit their size.
    """
    if image.encoding not in COLORS:
        raise ValueError(
            f"image has encoding {image.encoding!r}: publish {', '.join(COLORS)} (image_proc converts)"
        )
    channels, order = COLORS[image.encoding]
    pixels = _rows(image, channels).reshape(image.height, image.width, channels)
    return np.ascontiguousarray(pixels[..., list(order)])


def read_depth(image: Any) -> np.ndarray:
    """``(H, W)`` float32 [m] of a ``sensor_msgs/Image``; 0 and NaN are unknown, inf is nothing in range.

    Raises:
        ValueError: the encoding is not one of ``DEPTHS``, or the data do not fit their size.
    """
    if image.encoding not in DEPTHS:
        raise ValueError(f"depth has encoding {image.encoding!r}: publish {', '.join(DEPTHS)}")
    kind, meters = DEPTHS[image.encoding]
    stored = np.dtype(kind).newbyteorder(">" if image.is_bigendian else "<")
    values = np.ascontiguousarray(_rows(image, stored.itemsize)).view(stored)
    return np.asarray(values.astype(np.float32) * np.float32(meters))


def _rows(image: Any, pixel_bytes: int) -> np.ndarray:
    """Bytes of an image ``(H, W * pixel_bytes)``, without those that fill its rows."""
    data = np.frombuffer(image.data, np.uint8)
    used = image.width * pixel_bytes
    if not (image.height and image.width) or image.step < used or data.size < image.height * image.step:
        raise ValueError(
            f"image of {image.height} x {image.width} {image.encoding} has step {image.step} and {data.size} "
            f"bytes: its publisher must send at least {used} bytes a row"
        )
    return data[: image.height * image.step].reshape(image.height, image.step)[:, :used]


def read_intrinsics(info: Any, size: tuple[int, int], *, rectified: bool = False) -> np.ndarray:
    """Intrinsics ``(3, 3)`` [px] of pictures of ``(height, width)``: K, or P of rectified pictures.

    Raises:
        ValueError: the camera is not calibrated, its calibration is for another size, or is that of no lens.
    """
    matrix = np.array(info.k, np.float64).reshape(3, 3)
    if rectified:
        matrix = np.array(info.p, np.float64).reshape(3, 4)[:, :3]
    if not (np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise ValueError(
            f"camera_info has {'P' if rectified else 'K'} = {matrix.tolist()}: calibrate the camera "
            "(ros2 run camera_calibration cameracalibrator)"
        )
    if (info.height, info.width) != tuple(size):
        raise ValueError(
            f"camera_info is for {info.height} x {info.width}, the picture has {size[0]} x {size[1]}: "
            "publish the calibration of this size"
        )
    try:
        check_intrinsics(matrix, size)
    except ValueError as error:
        raise ValueError(f"camera_info: {error}") from error
    return matrix


def is_distorted(info: Any) -> bool:
    """Return whether the lens bends straight lines, so that only rectified pictures fit a pinhole camera."""
    return bool(np.any(np.asarray(info.d, np.float64)))


def read_pose(odometry: Any) -> tuple[float, float, float]:
    """x, y [m] and heading [rad] of a ``nav_msgs/Odometry``; NaN of a quaternion that is no rotation."""
    place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    if not abs(math.hypot(turn.x, turn.y, turn.z, turn.w) - 1) < 0.1:
        return place.x, place.y, math.nan
    yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y * turn.y + turn.z * turn.z))
    return place.x, place.y, yaw

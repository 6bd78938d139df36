"""ROS's messages without ROS: rosbags' classes, with the checks that rclpy's own classes make."""

import array
import itertools
from typing import Any

import numpy as np
from eldenet_ros.messages import Builder
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import Nodetype

# vision_msgs 4 (Humble and later), which rosbags does not know
VISION = {
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id"
    ),
    "Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
}
STORE = get_typestore(Stores.ROS2_JAZZY)
for _name, _fields in VISION.items():
    STORE.register(get_types_from_msg(_fields, f"vision_msgs/msg/{_name}"))

BUILDER = Builder(STORE.types.__getitem__)
CODES = {"uint8": "B", "float32": "f", "float64": "d"}
_FLOATS, _TEXT = ("float32", "float64"), ("string",)


def stamp(seconds: float) -> Any:
    """``builtin_interfaces/Time``."""
    return STORE.types["builtin_interfaces/msg/Time"](
        sec=int(seconds), nanosec=round((seconds - int(seconds)) * 1e9)
    )


def header(seconds: float = 12.25, frame_id: str = "camera_optical") -> Any:
    """``std_msgs/Header``."""
    return BUILDER.header(stamp(seconds), frame_id)


def image(values: np.ndarray, encoding: str, *, when: float = 12.25, padding: int = 0) -> Any:
    """``sensor_msgs/Image`` of ``(H, W)`` or ``(H, W, C)``, each row with some bytes more."""
    rows = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    return STORE.types["sensor_msgs/msg/Image"](
        header=header(when), height=values.shape[0], width=values.shape[1], encoding=encoding,
        is_bigendian=int(values.dtype.byteorder == ">"), step=rows.shape[1], data=rows.ravel(),
    )  # fmt: skip


def through_cdr(message: Any) -> Any:
    """The message as another process receives it."""
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, message.__msgtype__), message.__msgtype__)


def complaints(message: Any, where: str = "") -> list[str]:
    """What rclpy's generated classes would refuse: NumPy's numbers, wrong types, sequences it must copy."""
    found = []
    for name, (kind, about) in STORE.fielddefs[message.__msgtype__][1]:
        value, place = getattr(message, name), f"{where}.{name}"
        if kind is Nodetype.NAME:
            found += complaints(value, place)
        elif kind is Nodetype.BASE:
            expected = str if about[0] in _TEXT else float if about[0] in _FLOATS else bool
            expected = expected if about[0] in (*_TEXT, *_FLOATS, "bool") else int
            if not isinstance(value, expected):
                found.append(f"{place} is a {type(value).__name__}")
        else:
            (inner, detail), length = about
            if inner is Nodetype.NAME:
                found += itertools.chain(*(complaints(each, f"{place}[]") for each in value))
            elif kind is Nodetype.ARRAY:  # rclpy: ndarray of that type and length
                if (value.dtype, value.shape) != (np.dtype(detail[0]), (length,)):
                    found.append(f"{place} is {value.dtype} {value.shape}")
            elif not (isinstance(value, array.array) and value.typecode == CODES[detail[0]]):
                found.append(f"{place} is a {type(value).__name__}")
    return found

"""Bags of ROS 1 and ROS 2, written without ROS."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

FORMATS = ("mcap", "sqlite3", "ros1")
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
ZEROS = {"string": "", "bool": False, "float64": 0.0}

Sent = tuple[float, str, str, dict[str, Any]]
"""When [s], topic, kind such as "sensor_msgs/msg/Image", and the fields of a message but for its header."""


def write_bag(folder: Path, messages: Iterable[Sent], form: str = "mcap") -> Path:
    """Write messages with their times as stamps; return what ``source=`` takes."""
    bag: Any
    if form == "ros1":
        path, store, serialize = folder / "walk.bag", ROS1, ROS1.serialize_ros1
        bag = Writer1(path)
    else:
        path, store, serialize = folder / "walk", ROS2, ROS2.serialize_cdr
        bag = Writer2(path, version=9, storage_plugin=StoragePlugin[form.upper()])
    connections: dict[str, Any] = {}
    with bag:
        for when, topic, kind, fields in messages:
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            message = _message(store, kind, {"header": {"stamp": when}, **fields})
            bag.write(connections[topic], int(when * 1e9), serialize(message, kind))
    return path


def _message(store: Any, kind: str, given: dict[str, Any]) -> Any:
    """A message; fields that are not given are 0 or empty."""
    fields: dict[str, Any] = {}
    for name, (node, about) in store.fielddefs[kind][1]:
        value = given.get(name, given.get(name.lower()))  # ROS 1 has K where ROS 2 has k
        if node.name == "NAME" and about.endswith("/Time"):
            whole = int(value or 0)
            value = store.types[about](whole, round(((value or 0) - whole) * 1e9))
        elif node.name == "NAME":
            value = _message(store, about, value or {})
        elif node.name == "BASE":
            value = ZEROS.get(about[0], 0) if value is None else value
        else:
            (_, (number, _)), length = about
            value = np.zeros(length, number) if value is None else np.asarray(value, number).ravel()
        fields[name] = value
    return store.types[kind](**fields)


def picture(when: float, image: np.ndarray, topic: str = "/camera/image_raw", encoding: str = "rgb8") -> Sent:
    fields = {"height": image.shape[0], "width": image.shape[1], "encoding": encoding}
    fields |= {"step": image.strides[0], "data": np.ascontiguousarray(image).view(np.uint8)}
    return when, topic, "sensor_msgs/msg/Image", fields


def lens(
    when: float,
    intrinsics: np.ndarray,
    size: tuple[int, int],
    topic: str = "/camera/camera_info",
    bend: tuple[float, ...] = (),
    model: str = "plumb_bob",
) -> Sent:
    fields = {"height": size[0], "width": size[1], "distortion_model": model, "d": bend, "k": intrinsics}
    fields["p"] = np.column_stack([intrinsics, np.zeros(3)])
    return when, topic, "sensor_msgs/msg/CameraInfo", fields


def odometry(when: float, x: float, y: float, heading: float, topic: str = "/odom") -> Sent:
    turn = {"z": float(np.sin(heading / 2)), "w": float(np.cos(heading / 2))}
    pose = {"position": {"x": float(x), "y": float(y)}, "orientation": turn}
    return when, topic, "nav_msgs/msg/Odometry", {"pose": {"pose": pose}}

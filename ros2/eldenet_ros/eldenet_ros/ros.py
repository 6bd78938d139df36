"""What the nodes share of ROS: messages of its classes, the queue's rule, parameters, and the end."""

import array
import functools
import importlib
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from eldenet_ros.messages import Builder

# Only the latest: a slow board must not work through old pictures. Best effort: a reliable subscription
# receives nothing from best-effort publishers, such as most camera drivers.
LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


@functools.cache
def message(name: str) -> type:
    """Class of a message such as "sensor_msgs/msg/Image"."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def sequence(values: np.ndarray) -> array.array:
    """Numbers as rclpy takes them without checking each one."""
    numbers = array.array({"u1": "B", "f4": "f", "f8": "d"}[values.dtype.str[1:]])
    numbers.frombytes(values.tobytes())
    return numbers


BUILDER = Builder(message, sequence)


def declared(node: Node, defaults: Mapping[str, Any]) -> SimpleNamespace:
    """Declare a node's parameters and return their values."""
    return SimpleNamespace(
        **{name: node.declare_parameter(name, value).value for name, value in defaults.items()}
    )


def reported(callback: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Log a wrong message instead of ending the node; what depends on it sees no new data."""

    @functools.wraps(callback)
    def call(node: Node, *messages: Any) -> None:
        try:
            callback(node, *messages)
        except ValueError as error:
            node.get_logger().error(str(error), throttle_duration_sec=5.0)

    return call


def run(make: Callable[[], Node]) -> None:
    """Run a node until Ctrl-C or SIGTERM."""
    rclpy.init()
    try:
        rclpy.spin(make())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()

"""What the nodes share of ROS: its message classes, the queue's rule, parameters, and how a node ends."""

import array
import functools
import importlib
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import rclpy
from rclpy.exceptions import ParameterException
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


def reported(callback: Callable[..., None]) -> Callable[..., None]:
    """Log the ValueError that a wrong message raises, instead of ending the node."""

    @functools.wraps(callback)
    def call(node: Node, *messages: Any) -> None:
        try:
            callback(node, *messages)
        except ValueError as error:
            node.get_logger().error(str(error), throttle_duration_sec=5.0)

    return call


def run(make: Callable[[], Any], last: Callable[[Any], None] = lambda node: None, **options: Any) -> None:
    """Run a node until Ctrl-C or SIGTERM; a wrong parameter ends it in one line.

    Args:
        make: the node's class.
        last: what the node does before it ends, after an error too.
        options: of ``rclpy.init``.
    """
    rclpy.init(**options)
    try:
        node = _made(make)
        try:
            rclpy.spin(node)
        finally:
            last(node)
    except KeyboardInterrupt:
        pass
    except Exception:
        if rclpy.ok():  # otherwise the end came in the middle of its work
            raise
    finally:
        rclpy.try_shutdown()


def _made(make: Callable[[], Any]) -> Any:
    try:
        return make()
    except (ValueError, OSError, ImportError, ParameterException) as error:
        raise SystemExit(f"error: {error}") from error

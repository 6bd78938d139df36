"""The example node for ROS 2, with stand-ins for ROS's modules."""

import importlib.util
import math
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

NODE = Path(__file__).parents[2] / "docs/ros2_navigation_node.py"
MODULES = (
    "rclpy rclpy.node rclpy.qos rclpy.signals geometry_msgs geometry_msgs.msg nav_msgs nav_msgs.msg "
    "sensor_msgs sensor_msgs.msg"
)


class Node:
    """ROS's, as far as the example uses it."""

    def __init__(self, name: str) -> None:
        self.logger, self.sent = MagicMock(), []

    def get_logger(self):
        return self.logger

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0))

    def create_subscription(self, *arguments) -> None: ...

    def create_timer(self, *arguments) -> None: ...

    def create_publisher(self, *arguments):
        return SimpleNamespace(publish=lambda twist: self.sent.append((twist.linear.x, twist.angular.z)))


@pytest.fixture
def node(monkeypatch):
    for name in MODULES.split():
        monkeypatch.setitem(sys.modules, name, MagicMock())
    monkeypatch.setattr(sys.modules["rclpy.node"], "Node", Node)
    twist = lambda: SimpleNamespace(linear=SimpleNamespace(x=0.0), angular=SimpleNamespace(z=0.0))  # noqa: E731
    monkeypatch.setattr(sys.modules["geometry_msgs.msg"], "Twist", twist)
    spec = importlib.util.spec_from_file_location("ros2_navigation_node", NODE)
    module: ModuleType = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    node = module.NavigationNode()
    node.on_camera(SimpleNamespace(k=[110.0, 0, 80, 0, 110.0, 60, 0, 0, 1]))
    node.on_depth(depth(6.0))
    node.on_odometry(odometry(0.0))
    node.on_goal(goal(5.0))
    return node


def depth(meters: float):
    data = np.full((120, 160), meters, np.float32).tobytes()
    return SimpleNamespace(encoding="32FC1", is_bigendian=0, height=120, width=160, step=640, data=data)


def odometry(x: float):
    pose = SimpleNamespace(
        position=SimpleNamespace(x=x, y=0.0), orientation=SimpleNamespace(w=1.0, x=0, y=0, z=0)
    )
    return SimpleNamespace(pose=SimpleNamespace(pose=pose), header=SimpleNamespace(frame_id="odom"))


def goal(x: float):
    pose = SimpleNamespace(position=SimpleNamespace(x=x, y=0.0))
    return SimpleNamespace(header=SimpleNamespace(frame_id="odom"), pose=pose)


def decision(node) -> tuple[float, float]:
    node.decide()
    return node.sent[-1]


def test_the_node_drives_and_stops_while_its_data_are_not_finite(node) -> None:
    assert decision(node)[0] > 0
    for act, good, word in (
        (lambda: node.on_odometry(odometry(math.nan)), lambda: node.on_odometry(odometry(0.1)), "odometry"),
        (lambda: node.on_odometry(odometry(math.inf)), lambda: node.on_odometry(odometry(0.1)), "odometry"),
        (lambda: node.on_depth(depth(math.nan)), lambda: node.on_depth(depth(6.0)), "no value of depth"),
        (lambda: node.on_depth(depth(0.0)), lambda: node.on_depth(depth(6.0)), "no value of depth"),
    ):
        act()
        assert decision(node) == (0.0, 0.0)
        assert word in node.logger.warn.call_args.args[0]
        good()
        assert decision(node)[0] > 0


def test_the_node_rejects_a_goal_that_is_not_finite(node) -> None:
    node.on_goal(goal(math.nan))
    assert node.goal is None
    assert "not finite" in node.logger.error.call_args.args[0]
    assert decision(node) == (0.0, 0.0)

"""The nodes as processes of ROS, where rclpy is installed: what another process receives from them."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PACKAGE = Path(__file__).parents[2] / "ros2/eldenet_ros"
K = (110.0, 0.0, 80.0, 0.0, 110.0, 60.0, 0.0, 0.0, 1.0)
PHOTO = np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8)
PATIENCE = 240.0  # until a node that loads a network answers, on a busy machine [s]

pytestmark = pytest.mark.timeout(2 * PATIENCE)


class Graph:
    """Another process of the graph: publishes, keeps what it receives, and starts nodes."""

    def __init__(self, folder: Path) -> None:
        import rclpy
        from geometry_msgs.msg import PoseStamped, Twist
        from nav_msgs.msg import Odometry
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import CameraInfo, Image, LaserScan, PointCloud2

        self.rclpy, self.folder, self.started = rclpy, folder, {}
        rclpy.init()
        self.node = rclpy.create_node("test")
        self.got: dict[str, list] = {}
        queue = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
        received = {"depth/image": Image, "depth/sigma": Image, "depth/camera_info": CameraInfo}
        received |= {"depth/points": PointCloud2, "scan": LaserScan, "cmd_vel": Twist}
        for topic, kind in received.items():
            self.node.create_subscription(kind, topic, self.got.setdefault(topic, []).append, queue)
        sent = {"image": Image, "camera_info": CameraInfo, "near/image": Image, "near/info": CameraInfo}
        sent |= {"odom": Odometry, "goal_pose": PoseStamped}
        self.kinds = sent
        self.publishers = {topic: self.node.create_publisher(kind, topic, 5) for topic, kind in sent.items()}

    def start(self, name: str, *arguments: str) -> None:
        given = ["--params-file", str(PACKAGE / "config/eldenet.yaml"), *arguments]
        command = [sys.executable, "-m", f"eldenet_ros.{name}_node", "--ros-args", *given]
        with (self.folder / f"{name}.log").open("w") as log:
            self.started[name] = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text()

    def send(self, topic: str, frame: str, **fields: Any) -> None:
        message = self.kinds[topic]()
        message.header.stamp, message.header.frame_id = self.node.get_clock().now().to_msg(), frame
        for name, value in fields.items():
            setattr(message, name, value)
        self.publishers[topic].publish(message)

    def send_picture(self, topic: str, info: str, values: np.ndarray, encoding: str) -> None:
        size = {"height": values.shape[0], "width": values.shape[1]}
        self.send(info, "camera_optical", k=K, **size)
        data = {"encoding": encoding, "step": values.strides[0], "data": values.tobytes()}
        self.send(topic, "camera_optical", **size, **data)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.rclpy.spin_once(self.node, timeout_sec=0.02)

    def until(self, done: Callable[[], Any], act: Callable[[], None], seconds: float = PATIENCE) -> None:
        """Act ten times a second until it is done."""
        end = time.monotonic() + seconds
        while not done():
            for name, process in self.started.items():
                assert process.poll() is None, self.log(name)
            assert time.monotonic() < end, {topic: len(messages) for topic, messages in self.got.items()}
            act()
            self.spin(0.1)

    def stop(self) -> None:
        """End all nodes as ``ros2 launch`` does; none of them may fail."""
        for process in self.started.values():
            process.send_signal(signal.SIGTERM)
        for name, process in self.started.items():
            assert (process.wait(60), "Traceback" in self.log(name)) == (0, False), self.log(name)

    def close(self) -> None:
        for process in self.started.values():
            if process.poll() is None:
                process.kill()
                process.wait()
        self.node.destroy_node()
        self.rclpy.try_shutdown()


@pytest.fixture
def graph(tmp_path, monkeypatch) -> Iterator[Graph]:
    pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy, or its wheels (ros2/eldenet_ros/README.md)")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(PACKAGE), os.environ.get("PYTHONPATH", "")]))
    graph = Graph(tmp_path)
    yield graph
    graph.close()


def test_pictures_become_depth_points_and_a_scan_of_their_stamp(graph):
    graph.start("depth")
    graph.start("scan")
    wanted = ("depth/image", "depth/sigma", "depth/camera_info", "depth/points", "scan")
    graph.until(
        lambda: all(graph.got[topic] for topic in wanted),
        lambda: graph.send_picture("image", "camera_info", PHOTO, "rgb8"),
    )
    graph.stop()
    depth, sigma, info, cloud, scan = (graph.got[topic][-1] for topic in wanted)
    assert (depth.encoding, sigma.encoding, info.height, info.width) == ("32FC1", "32FC1", 120, 160)
    assert tuple(info.k) == K
    assert (cloud.height, cloud.width, cloud.header.frame_id) == (60, 80, "camera_optical")
    stamps = [message.header.stamp for message in graph.got["depth/image"]]
    assert scan.header.stamp in stamps
    assert cloud.header.stamp in stamps
    assert scan.header.frame_id == "camera_link"
    assert len(scan.ranges) == round((scan.angle_max - scan.angle_min) / scan.angle_increment) + 1


def test_the_driver_moves_and_stands_when_odometry_falls_silent_and_at_the_end(graph):
    graph.start("drive", "-r", "depth/image:=near/image", "-r", "depth/camera_info:=near/info")
    noise = np.random.default_rng(0)
    way = 0.0

    def see() -> None:
        """A wall that comes nearer."""
        depth = noise.normal(8.0 - way, 0.01, (120, 160)).astype(np.float32)
        graph.send_picture("near/image", "near/info", depth, "32FC1")

    def drive() -> None:
        nonlocal way
        way += 0.02
        see()
        odometry = graph.kinds["odom"]()
        odometry.pose.pose.position.x, odometry.pose.pose.orientation.w = way, 1.0
        graph.send("odom", "odom", pose=odometry.pose)

    def stands(count: int) -> bool:
        return not any(each.linear.x or each.angular.z for each in graph.got["cmd_vel"][-count:])

    graph.until(lambda: graph.got["cmd_vel"], drive)
    assert stands(1)
    goal = graph.kinds["goal_pose"]()
    goal.pose.position.x = 8.0
    graph.send("goal_pose", "odom", pose=goal.pose)
    graph.until(lambda: not stands(3), drive, seconds=30)
    assert graph.got["cmd_vel"][-1].linear.x <= 0.3 + 1e-6
    graph.until(lambda: stands(3), see, seconds=30)
    assert "stopped: odometry is" in graph.log("drive")
    graph.until(lambda: not stands(1), drive, seconds=30)
    count = len(graph.got["cmd_vel"])
    graph.stop()
    graph.spin(1)
    assert len(graph.got["cmd_vel"]) > count
    assert stands(1)


@pytest.mark.parametrize(
    ("node", "given", "said"),
    [
        ("scan", "camera_height:=1", "error: Trying to set parameter 'camera_height' to '1'"),
        ("depth", "checkpoint:=/nope", "error: source=/nope is neither"),
    ],
)
def test_a_wrong_parameter_ends_in_one_line(graph, node, given, said):
    graph.start(node, "-p", given)
    assert graph.started[node].wait(PATIENCE) == 1
    assert graph.log(node).splitlines()[-1].startswith(said)
    assert "Traceback" not in graph.log(node)

"""A ROS 2 node that drives to a goal with the packaged policy. Untested on hardware: an example.

Subscribes to a depth image (32FC1 [m] or 16UC1 [mm]) of a level forward camera with its CameraInfo, to
odometry, and to a goal in the odometry's frame; publishes velocity commands five times a second. It stops
when the goal is reached, when no goal is set, and when depth or odometry are older than half a second. Keep a
hardware emergency stop at hand, and let the base limit speed and acceleration.

The goal's distance and bearing come from odometry, so they drift with it: that is goal=odometry of
python -m eldenet.navigate, where the packaged policy reaches far fewer goals than with goal=known, the
simulation's default. On a robot that localises (in a map, by a beacon), publish the corrected pose as
odometry, or fuse its positions with the wheels' odometry in eldenet.navigation.localisation.Localiser, as
goal=fixes does.

The camera must see 69.4 degrees across, at least 46 pixels: a narrower one shows nothing in the policy's
outer columns. The node then ends with an error that says so, and a last command that stops the robot.

ros2 run needs a package around this file; for a try: python3 ros2_navigation_node.py
"""

import math

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from eldenet.navigation.policy import Navigator

PERIOD = 0.2  # the policy was trained at this rate [s]
GOAL_RADIUS = 0.5  # [m]
STALE = 0.5  # older data stop the robot [s]


class NavigationNode(Node):
    """Depth, odometry and a goal in; velocity out."""

    def __init__(self) -> None:
        super().__init__("eldenet_navigation")
        self.navigator = Navigator.load()
        self.depth: np.ndarray | None = None
        self.intrinsics: np.ndarray | None = None
        self.pose: tuple[float, float, float] | None = None
        self.goal: tuple[float, float] | None = None
        self.depth_time = self.pose_time = -math.inf
        self.create_subscription(Image, "camera/depth", self.on_depth, 1)
        self.create_subscription(CameraInfo, "camera/camera_info", self.on_camera, 1)
        self.create_subscription(Odometry, "odom", self.on_odometry, 1)
        self.create_subscription(PoseStamped, "goal_pose", self.on_goal, 1)
        self.velocity = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_timer(PERIOD, self.decide)

    def now(self) -> float:
        """[s]."""
        return self.get_clock().now().nanoseconds * 1e-9

    def on_depth(self, message: Image) -> None:
        """Take a depth image over, in metres."""
        kinds = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 0.001)}
        if message.encoding not in kinds:
            self.get_logger().error(f"depth is {message.encoding}: 32FC1 or 16UC1 is needed", once=True)
            return
        kind, metres = kinds[message.encoding]
        kind = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
        rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
        values = rows[:, : message.width * kind.itemsize].copy().view(kind)
        self.depth = values.astype(np.float64) * metres
        self.depth_time = self.now()

    def on_camera(self, message: CameraInfo) -> None:
        """Take the intrinsics over."""
        self.intrinsics = np.array(message.k).reshape(3, 3)

    def on_odometry(self, message: Odometry) -> None:
        """Take the pose over."""
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y * turn.y + turn.z * turn.z))
        self.pose = (place.x, place.y, yaw)
        self.pose_time = self.now()

    def on_goal(self, message: PoseStamped) -> None:
        """Start for a new goal; it must be given in the odometry's frame."""
        self.goal = (message.pose.position.x, message.pose.position.y)
        self.navigator.reset()

    def decide(self) -> None:
        """Publish one command."""
        command = Twist()
        fresh = self.now() - min(self.depth_time, self.pose_time) < STALE
        if fresh and self.goal is not None and self.intrinsics is not None:
            x, y, yaw = self.pose
            distance = math.dist((x, y), self.goal)
            bearing = math.remainder(math.atan2(self.goal[1] - y, self.goal[0] - x) - yaw, math.tau)
            if distance < GOAL_RADIUS:
                self.get_logger().info("goal reached")
                self.goal = None
            else:
                command.linear.x, command.angular.z = self.navigator.step(
                    self.depth, (distance, bearing), self.pose, intrinsics=self.intrinsics
                )
        if not (command.linear.x or command.angular.z):
            self.navigator.observer.last[:] = 0.0  # it stands, whatever was chosen last
        self.velocity.publish(command)


def main() -> None:
    """Run the node."""
    rclpy.init()
    node = NavigationNode()
    try:
        rclpy.spin(node)
    finally:
        node.velocity.publish(Twist())
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()

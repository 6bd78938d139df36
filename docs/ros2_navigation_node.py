"""A ROS 2 node that drives to a goal with the packaged policy: an example, not tested on hardware.

It subscribes to a depth image (32FC1 [m] or 16UC1 [mm]) of a level forward camera with its CameraInfo, to
odometry, and to a goal in the odometry's frame. It publishes velocity commands five times per second. It
stops the robot at the goal, without a goal, and when depth or odometry are older than half a second or not
finite, and logs what is missing. It rejects a goal in another frame: RViz sends goals in its "Fixed Frame",
so set that to the odometry's. After an error, Ctrl-C or SIGTERM a last command stops the robot. Keep a
hardware emergency stop within reach, and let the base limit speed and acceleration.

The robot must be at most 0.60 x 0.50 m and turn about its center, the origin of its odometry. The camera must
be level, 0.20 m ahead of the axle and CAMERA_HEIGHT above the floor: measure it, because with a height 15 cm
too great the floor looks like a wall. Objects lower than 15 cm are never seen. docs/navigation.md lists all
requirements.

The camera must cover 69.4 degrees with at least 46 pixels. With a narrower one the policy's outer columns are
empty, and the node ends with an error.

The goal's distance and bearing come from odometry, so they drift with it. This is goal=odometry of
python -m eldenet.navigate, where the packaged policy reaches far fewer goals than with goal=known, the
default of the simulation. On a robot with localization (a map, beacons), publish the corrected pose as
odometry, or fuse positions with wheel odometry (eldenet.navigation.localization.Localizer), as goal=fixes.

ros2 run needs a package around this file; to try it: python3 ros2_navigation_node.py
"""

import math
import signal

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, Image

from eldenet.navigation.policy import Navigator

CAMERA_HEIGHT = 0.40  # of the optical center, as in the simulation: set it to your robot's [m]
PERIOD = 0.2  # as in training [s]
GOAL_RADIUS = 0.5  # [m]
STALE = 0.5  # older data stop the robot [s]


class NavigationNode(Node):
    """Depth, odometry and a goal in; velocity out."""

    def __init__(self) -> None:
        super().__init__("eldenet_navigation")
        self.navigator = Navigator.load()
        self.navigator.step(np.full(40, 8.0), (5.0, 0.0), (0.0, 0.0, 0.0))  # the first step takes a second
        self.navigator.reset()
        self.depth: np.ndarray | None = None
        self.intrinsics: np.ndarray | None = None
        self.pose: tuple[float, float, float] | None = None
        self.frame: str | None = None  # of the odometry
        self.goal: tuple[float, float] | None = None
        self.depth_time = self.pose_time = -math.inf
        # best effort: a reliable subscription receives nothing from best-effort publishers
        self.create_subscription(Image, "camera/depth", self.on_depth, qos_profile_sensor_data)
        self.create_subscription(CameraInfo, "camera/camera_info", self.on_camera, qos_profile_sensor_data)
        self.create_subscription(Odometry, "odom", self.on_odometry, qos_profile_sensor_data)
        self.create_subscription(PoseStamped, "goal_pose", self.on_goal, 1)
        self.velocity = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_timer(PERIOD, self.decide)

    def now(self) -> float:
        """Current time [s]."""
        return self.get_clock().now().nanoseconds * 1e-9

    def on_depth(self, message: Image) -> None:
        """Store a depth image in meters."""
        kinds = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 0.001)}
        if message.encoding not in kinds:
            self.get_logger().error(
                f"depth has encoding {message.encoding}: publish 32FC1 or 16UC1", once=True
            )
            return
        kind, meters = kinds[message.encoding]
        kind = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
        rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
        values = rows[:, : message.width * kind.itemsize].copy().view(kind)
        self.depth = values.astype(np.float64) * meters
        self.depth_time = self.now()

    def on_camera(self, message: CameraInfo) -> None:
        """Store the intrinsics."""
        self.intrinsics = np.array(message.k).reshape(3, 3)

    def on_odometry(self, message: Odometry) -> None:
        """Store the pose."""
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y * turn.y + turn.z * turn.z))
        self.pose = (place.x, place.y, yaw)
        self.frame = message.header.frame_id
        self.pose_time = self.now()

    def on_goal(self, message: PoseStamped) -> None:
        """Start towards a new goal in the odometry's frame; stop for any other."""
        self.goal = None
        if not (math.isfinite(message.pose.position.x) and math.isfinite(message.pose.position.y)):
            self.get_logger().error("goal rejected: its position is not finite")
        elif self.frame is None:
            self.get_logger().error("goal rejected: no odometry yet; send it again later")
        elif message.header.frame_id != self.frame:
            self.get_logger().error(
                f"goal rejected: it is in frame '{message.header.frame_id}', the odometry in '{self.frame}': "
                "send it in that frame (in RViz, set Fixed Frame to it)"
            )
        else:
            self.goal = (message.pose.position.x, message.pose.position.y)
            self.navigator.reset()

    def missing(self) -> list[str]:
        """Return the topics without recent data."""
        now = self.now()
        return [
            name
            for name, there in (
                ("camera/depth", now - self.depth_time < STALE),
                ("camera/camera_info", self.intrinsics is not None),
                ("odom", now - self.pose_time < STALE),
            )
            if not there
        ]

    def decide(self) -> None:
        """Publish a command."""
        command = Twist()
        missing = self.missing()
        if missing:
            self.get_logger().warn(
                f"stopped: no recent data on {', '.join(missing)}; check its name, its publisher and "
                "ros2 topic hz",
                throttle_duration_sec=5,
            )
        elif self.goal is not None:
            x, y, yaw = self.pose
            distance = math.dist((x, y), self.goal)
            bearing = math.remainder(math.atan2(self.goal[1] - y, self.goal[0] - x) - yaw, math.tau)
            if distance < GOAL_RADIUS:
                self.get_logger().info("goal reached")
                self.goal = None
            else:
                command.linear.x, command.angular.z = self.navigator.step(
                    self.depth,
                    (distance, bearing),
                    self.pose,
                    intrinsics=self.intrinsics,
                    camera_height=CAMERA_HEIGHT,
                )
                if self.navigator.stop_reason:
                    self.get_logger().warn(f"stopped: {self.navigator.stop_reason}", throttle_duration_sec=5)
        if not (command.linear.x or command.angular.z):
            self.navigator.observer.last[:] = 0.0  # it is stopped, whatever was chosen last
        self.velocity.publish(command)


def main() -> None:
    """Run the node."""
    # rclpy's own handlers would shut it down before the last command is sent
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = NavigationNode()
    try:
        rclpy.spin(node)  # the timer wakes it up five times a second, so signals are seen
    except KeyboardInterrupt:
        pass
    finally:
        node.velocity.publish(Twist())
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()

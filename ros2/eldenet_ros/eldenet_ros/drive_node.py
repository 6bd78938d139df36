"""Drives to a goal with the packaged policy: depth, odometry and a goal in; velocity out.

Five times a second it publishes a command. It stops the robot at the goal, without a goal, and when depth or
odometry are more than ``stale`` from the clock or not finite, and says why. After an error, Ctrl-C or SIGTERM
a last command stops the robot. A process that hangs can send nothing: let the base stop by itself when
commands end, let it limit speed and acceleration, and keep a hardware emergency stop within reach.

Tested with rclpy, not on a robot. docs/robot.md says what the robot must be like.
"""

import signal
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from eldenet.data.ros_messages import read_depth, read_intrinsics, read_pose, seconds
from eldenet.navigation.planners.plan_and_steer import PlanAndSteer
from eldenet.navigation.planners.plan_when_stuck import PlanWhenStuck
from eldenet.navigation.policy import Navigator
from eldenet.simulation.robot import ROBOT
from eldenet_ros.driving import Pilot
from eldenet_ros.ros import BUILDER, LATEST, declared, message, reported, run
from eldenet_ros.scan import read_scan

PARAMETERS = {
    "policy": "",
    "plan": False,
    "plan_when_stuck": False,
    "lidar": "",
    "lidar_ahead": ROBOT.camera_ahead,
    "lidar_yaw": 0.0,
    "camera_height": ROBOT.camera_height,
    "camera_pitch": 0.0,
    "camera_roll": 0.0,
    "max_speed": 0.3,
    "latency": 0.0,
    "stale": 0.5,
    "stamped": False,
    "frame": "base_link",
}


class DriveNode(Node):
    """``depth/image``, ``.../camera_info``, ``.../sigma``, ``odom``, ``goal_pose`` -> ``cmd_vel``.

    With ``lidar``, the name of a topic, a ``LaserScan`` takes the place of ``depth/...``. The service
    ``~/reset`` begins anew after a fault.
    """

    def __init__(self) -> None:
        super().__init__("eldenet_drive")
        chosen = self.settings = declared(self, PARAMETERS)
        alone = PlanWhenStuck if chosen.plan_when_stuck else Navigator.load
        load = PlanAndSteer if chosen.plan else alone
        driver = load(chosen.policy or None, slows_within=1.0)
        driver.step(np.full(ROBOT.columns, 8.0), (5.0, 0.0), (0.0, 0.0, 0.0))  # the first step takes a second
        driver.reset()
        self.pilot = Pilot(
            driver,
            camera_height=chosen.camera_height,
            camera_pitch=chosen.camera_pitch,
            camera_roll=chosen.camera_roll,
            max_speed=chosen.max_speed,
            latency=chosen.latency,
            stale=chosen.stale,
        )
        self.stands = True
        self.info: Any = None
        self.depth: Any = None
        self.sigma: Any = None
        if chosen.lidar:
            self.create_subscription(message("sensor_msgs/msg/LaserScan"), chosen.lidar, self.on_scan, LATEST)
        else:
            self.create_subscription(
                message("sensor_msgs/msg/CameraInfo"), "depth/camera_info", self.on_info, LATEST
            )
            self.create_subscription(message("sensor_msgs/msg/Image"), "depth/image", self.on_depth, LATEST)
            self.create_subscription(message("sensor_msgs/msg/Image"), "depth/sigma", self.on_sigma, LATEST)
        self.create_subscription(message("nav_msgs/msg/Odometry"), "odom", self.on_odometry, LATEST)
        self.create_subscription(message("geometry_msgs/msg/PoseStamped"), "goal_pose", self.on_goal, 1)
        kind = "geometry_msgs/msg/TwistStamped" if chosen.stamped else "geometry_msgs/msg/Twist"
        self.velocity = self.create_publisher(message(kind), "cmd_vel", 1)
        self.create_service(Trigger, "~/reset", self.on_reset)
        self.create_timer(ROBOT.period, self.decide)

    def on_info(self, info: Any) -> None:
        """Store the calibration of the depth."""
        self.info = info

    @reported
    def on_scan(self, scan: Any) -> None:
        """Give the pilot a lidar's scan."""
        chosen = self.settings
        seen = read_scan(scan, ahead=chosen.lidar_ahead, yaw=chosen.lidar_yaw)
        self.pilot.see(seen, None, seconds(scan.header.stamp))

    @reported
    def on_depth(self, image: Any) -> None:
        """Store a depth image."""
        self.depth = image
        self.see()

    @reported
    def on_sigma(self, image: Any) -> None:
        """Store how unsure a network is of its depth."""
        self.sigma = image
        self.see()

    def see(self) -> None:
        """Give the pilot the depth image, with its sigma if a network publishes that too."""
        image, sigma = self.depth, None
        if image is None:
            return
        if self.count_publishers(self.resolve_topic_name("depth/sigma")):
            if self.sigma is None or self.sigma.header.stamp != image.header.stamp:
                return  # the other one comes soon
            sigma = read_depth(self.sigma)
        self.depth = None  # each image counts once
        depth = read_depth(image)
        intrinsics = None if self.info is None else read_intrinsics(self.info, depth.shape)
        self.pilot.see(depth, intrinsics, seconds(image.header.stamp), sigma)

    def on_odometry(self, odometry: Any) -> None:
        """Store the pose."""
        self.pilot.move(read_pose(odometry), odometry.header.frame_id, seconds(odometry.header.stamp))

    def on_goal(self, goal: Any) -> None:
        """Start toward a new goal; stop for one that is rejected."""
        place = goal.pose.position
        if wrong := self.pilot.aim(place.x, place.y, goal.header.frame_id):
            self.get_logger().error(wrong)

    def on_reset(self, request: Any, response: Any) -> Any:
        """Begin anew once a fault is over; the robot stands until it is given a goal."""
        self.pilot.reset()
        response.success, response.message = True, "send a goal"
        return response

    def decide(self) -> None:
        """Publish a command."""
        command = self.pilot.decide(self.get_clock().now().nanoseconds * 1e-9)
        if command.reason and not self.stands:
            self.get_logger().info(f"stopped: {command.reason}")
        elif command.reason:
            self.get_logger().info(f"stopped: {command.reason}", throttle_duration_sec=5.0)
        self.stands = bool(command.reason)
        self.send(command.speed, command.turn)

    def send(self, speed: float, turn: float) -> None:
        """Publish a velocity."""
        header = None
        if self.settings.stamped:
            header = BUILDER.header(self.get_clock().now().to_msg(), self.settings.frame)
        self.velocity.publish(BUILDER.velocity(speed, turn, header))


def main() -> None:
    """Run the node."""
    # rclpy's own handlers would shut it down before the last command is sent; Python's are seen because the
    # timer wakes the node up five times a second
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    run(DriveNode, lambda node: node.send(0.0, 0.0), signal_handler_options=SignalHandlerOptions.NO)


if __name__ == "__main__":
    main()

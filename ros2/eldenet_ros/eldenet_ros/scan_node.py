"""A laser scan from a depth image, for Nav2's costmaps."""

from typing import Any

from rclpy.node import Node

from eldenet.data.ros_messages import read_depth, read_intrinsics, seconds
from eldenet.navigation.ranges import HIGHEST, LOWEST
from eldenet.simulation.robot import ROBOT
from eldenet_ros.ros import BUILDER, LATEST, declared, message, reported, run
from eldenet_ros.scan import scan_depth

PARAMETERS = {
    "camera_height": ROBOT.camera_height,
    "lowest": LOWEST,
    "highest": HIGHEST,
    "range_min": ROBOT.near,
    "range_max": ROBOT.far,
    "frame": "camera_link",
}


class ScanNode(Node):
    """``depth/image`` and ``depth/camera_info`` -> ``scan``."""

    def __init__(self) -> None:
        super().__init__("eldenet_scan")
        self.settings = declared(self, PARAMETERS)
        self.info: Any = None
        self.last: float | None = None
        self.scan = self.create_publisher(message("sensor_msgs/msg/LaserScan"), "scan", 1)
        self.create_subscription(
            message("sensor_msgs/msg/CameraInfo"), "depth/camera_info", self.on_info, LATEST
        )
        self.create_subscription(message("sensor_msgs/msg/Image"), "depth/image", self.on_depth, LATEST)

    def on_info(self, info: Any) -> None:
        """Store the calibration of the depth."""
        self.info = info

    @reported
    def on_depth(self, image: Any) -> None:
        """Publish the scan of a depth image, with its stamp."""
        if self.info is None:
            raise ValueError("no depth/camera_info yet")
        depth, chosen = read_depth(image), self.settings
        ranges, half = scan_depth(
            depth,
            read_intrinsics(self.info, depth.shape),
            camera_height=chosen.camera_height,
            heights=(chosen.lowest, chosen.highest),
            near=chosen.range_min,
            far=chosen.range_max,
        )
        now = seconds(image.header.stamp)
        period = 0.0 if self.last is None else max(now - self.last, 0.0)
        self.last = now
        header = BUILDER.header(image.header.stamp, chosen.frame)
        self.scan.publish(
            BUILDER.laser_scan(header, ranges, half, chosen.range_min, chosen.range_max, period)
        )


def main() -> None:
    """Run the node."""
    run(ScanNode)


if __name__ == "__main__":
    main()

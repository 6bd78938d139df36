"""3D boxes: an image, its depth and a detector's file in; boxes with numbers out.

Tested with stand-ins for ROS's modules, not in ROS.
"""

from typing import Any

from message_filters import Subscriber, TimeSynchronizer
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from eldenet.data.ros_messages import read_color, read_depth, read_intrinsics, seconds
from eldenet.geometry import PinholeCamera
from eldenet.perception.lifter import BoxLifter
from eldenet.perception.onnx_detector import OnnxDetector
from eldenet.perception.scene import Perception
from eldenet.perception.tracking import BoxTracker
from eldenet.uncertainty import DepthEstimate
from eldenet_ros.ros import BUILDER, LATEST, declared, message, reported, run

PARAMETERS = {
    "detector": "",
    "threshold": 0.3,
    "keep": [""],
    "camera_height": 0.0,
    "depth_sigma": 0.0,
    "sigma_distribution": "",
    "track": True,
}
KEPT = 30  # pictures that wait for their depth


class BoxesNode(Node):
    """``image``, ``depth/image``, ``depth/camera_info`` (and ``depth/sigma``) -> ``detections``."""

    def __init__(self) -> None:
        super().__init__("eldenet_boxes")
        chosen = self.settings = declared(self, PARAMETERS)
        if not chosen.detector:
            raise ValueError("detector is empty: give the path of an .onnx file (docs/boxes.md)")
        keep = [name for name in chosen.keep if name]
        self.detector = OnnxDetector(chosen.detector, threshold=chosen.threshold, keep=keep or None)
        self.lifter = BoxLifter(
            camera_height=chosen.camera_height or None, depth_sigma=chosen.depth_sigma or None
        )
        self.tracker = BoxTracker() if chosen.track else None
        self.info: Any = None
        self.last: float | None = None
        image = message("sensor_msgs/msg/Image")
        self.boxes = self.create_publisher(message("vision_msgs/msg/Detection3DArray"), "detections", 1)
        self.create_subscription(
            message("sensor_msgs/msg/CameraInfo"), "depth/camera_info", self.on_info, LATEST
        )
        topics = ["image", "depth/image", *["depth/sigma"] * bool(chosen.sigma_distribution)]
        # depth has its picture's stamp and comes later
        queue = QoSProfile(depth=KEPT, reliability=ReliabilityPolicy.BEST_EFFORT)
        together = [Subscriber(self, image, topic, qos_profile=queue) for topic in topics]
        self.together = TimeSynchronizer(together, KEPT)
        self.together.registerCallback(self.on_picture)

    def on_info(self, info: Any) -> None:
        """Store the calibration of the depth."""
        self.info = info

    @reported
    def on_picture(self, image: Any, depth: Any, sigma: Any = None) -> None:
        """Find boxes and publish them, with the picture's own stamp and frame."""
        if self.info is None:
            raise ValueError("no depth/camera_info yet")
        frame, meters = read_color(image), read_depth(depth)
        camera = PinholeCamera(read_intrinsics(self.info, meters.shape))
        estimate = DepthEstimate(meters)
        if sigma is not None:
            estimate = DepthEstimate(meters, read_depth(sigma), self.settings.sigma_distribution)
        perception = Perception(None, self.detector, self.lifter, camera, tracker=self.tracker)
        now = seconds(image.header.stamp)
        since = 1 / 30 if self.last is None else max(now - self.last, 1e-3)
        self.last = now
        scene = perception(frame, depth=estimate, seconds=since)
        self.boxes.publish(BUILDER.detections(image.header, scene.boxes))


def main() -> None:
    """Run the node."""
    run(BoxesNode)


if __name__ == "__main__":
    main()

"""Depth of a camera: an image and its calibration in; depth, its sigma and a point cloud out."""

from typing import Any

from rclpy.node import Node

from eldenet.data.ros_messages import is_distorted, read_color, read_intrinsics
from eldenet.geometry import back_project
from eldenet.uncertainty import as_estimate
from eldenet_ros.network import open_predictor
from eldenet_ros.ros import BUILDER, LATEST, declared, message, reported, run

PARAMETERS = {
    "checkpoint": "eldenet_indoor",
    "engine": "auto",
    "device": "cpu",
    "threads": 0,
    "rectified": False,
    "cloud_step": 2,
}


class DepthNode(Node):
    """``image``, ``camera_info`` -> ``depth/image``, ``.../camera_info``, ``.../sigma``, ``.../points``."""

    def __init__(self) -> None:
        super().__init__("eldenet_depth")
        chosen = self.settings = declared(self, PARAMETERS)
        self.predictor = open_predictor(
            chosen.checkpoint, engine=chosen.engine, device=chosen.device, threads=chosen.threads
        )
        self.info: Any = None
        image = message("sensor_msgs/msg/Image")
        info = message("sensor_msgs/msg/CameraInfo")
        self.depth = self.create_publisher(image, "depth/image", 1)
        self.depth_info = self.create_publisher(info, "depth/camera_info", 1)
        self.cloud = self.create_publisher(message("sensor_msgs/msg/PointCloud2"), "depth/points", 1)
        self.sigma = self.create_publisher(image, "depth/sigma", 1) if self.predictor.uncertainty else None
        self.create_subscription(info, "camera_info", self.on_info, LATEST)
        self.create_subscription(image, "image", self.on_image, LATEST)

    def on_info(self, info: Any) -> None:
        """Store the calibration."""
        self.info = info

    @reported
    def on_image(self, image: Any) -> None:
        """Predict and publish, with the picture's own stamp and frame."""
        frame = read_color(image)
        if self.info is None:
            raise ValueError("no camera_info yet: depth needs the camera's focal length")
        if is_distorted(self.info) and not self.settings.rectified:
            self.get_logger().warn(
                "the pictures are distorted: take rectified ones (image_proc) and set rectified: true",
                once=True,
            )
        intrinsics = read_intrinsics(self.info, frame.shape[:2], rectified=self.settings.rectified)
        estimate = as_estimate(self.predictor(frame, intrinsics=intrinsics))
        header = image.header
        self.depth.publish(BUILDER.depth_image(header, estimate.depth))
        self.depth_info.publish(BUILDER.camera_info(header, estimate.depth.shape, intrinsics))
        if self.sigma is not None:
            self.sigma.publish(BUILDER.depth_image(header, estimate.sigma))
        if self.cloud.get_subscription_count():
            each = (slice(None, None, self.settings.cloud_step),) * 2
            points = back_project(estimate.depth, intrinsics)  # the unsure ones too: a costmap must see them
            self.cloud.publish(BUILDER.point_cloud(header, points[each], frame[each]))


def main() -> None:
    """Run the node."""
    run(DepthNode)


if __name__ == "__main__":
    main()

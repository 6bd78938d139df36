"""Arrays to ROS messages. Needs no ROS: ROS, or a library such as rosbags, gives the classes.

:mod:`eldenet.data.ros_messages` reads messages. Both keep REP 103 (an optical frame has x right,
y down, z forward, and so have depth, points and boxes here; a frame without "optical" has x forward, y left,
z up), REP 117 (inf: nothing in range) and REP 118 (32FC1 is depth in meters with NaN for unknown, 16UC1 in
millimeters with 0 for unknown).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

Z_90 = 1.64  # half of a box's interval of 90 %, in standard deviations (Gaussian 1.64, Laplacian 1.63)
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
FLOAT32 = 7  # sensor_msgs/PointField


class Builder:
    """Builds messages.

    Args:
        message: name such as "sensor_msgs/msg/Image" -> class, which takes every field by keyword.
        sequence: array -> what the classes take for a sequence of numbers without a fixed length.
    """

    def __init__(
        self,
        message: Callable[[str], Callable[..., Any]],
        sequence: Callable[[np.ndarray], Any] = np.ascontiguousarray,
    ) -> None:
        self.message, self.sequence = message, sequence

    def header(self, stamp: Any, frame_id: str) -> Any:
        """``std_msgs/Header`` with a stamp of ROS's and the name of a frame."""
        return self.message("std_msgs/msg/Header")(stamp=stamp, frame_id=frame_id)

    def depth_image(self, header: Any, depth: np.ndarray) -> Any:
        """``sensor_msgs/Image`` 32FC1 of ``(H, W)`` [m]: depth, or its sigma."""
        depth = np.ascontiguousarray(depth, dtype="<f4")
        height, width = depth.shape
        return self.message("sensor_msgs/msg/Image")(
            header=header,
            height=height,
            width=width,
            encoding="32FC1",
            is_bigendian=0,
            step=4 * width,
            data=self.sequence(depth.view(np.uint8).ravel()),
        )

    def camera_info(self, header: Any, size: tuple[int, int], intrinsics: np.ndarray) -> Any:
        """``sensor_msgs/CameraInfo`` of a pinhole camera without distortion, ``intrinsics (3, 3)`` [px]."""
        matrix = np.array(intrinsics, dtype=np.float64)
        window = self.message("sensor_msgs/msg/RegionOfInterest")(
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.message("sensor_msgs/msg/CameraInfo")(
            header=header,
            height=size[0],
            width=size[1],
            distortion_model="plumb_bob",
            d=self.sequence(np.zeros(5)),
            k=matrix.ravel(),
            r=np.eye(3).ravel(),
            p=np.column_stack([matrix, np.zeros(3)]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=window,
        )

    def point_cloud(self, header: Any, points: np.ndarray, colors: np.ndarray) -> Any:
        """``sensor_msgs/PointCloud2`` in the order of the picture; RViz shows its field "rgb".

        Args:
            header: of the picture.
            points: ``(H, W, 3)`` [m] in the optical frame; one that is not finite or not in front is NaN.
            colors: ``(H, W, 3)`` uint8 RGB.
        """
        height, width = points.shape[:2]
        known = np.isfinite(points).all(-1) & (points[..., 2] > 0)
        cloud = np.empty((height, width), POINT)
        for axis, name in enumerate("xyz"):
            cloud[name] = np.where(known, points[..., axis], np.nan)
        red, green, blue = np.moveaxis(colors.astype(np.uint32), -1, 0)
        cloud["rgb"] = red << 16 | green << 8 | blue
        field = self.message("sensor_msgs/msg/PointField")
        fields = [
            field(name=name, offset=POINT.fields[name][1], datatype=FLOAT32, count=1)  # type: ignore[index]
            for name in POINT.names or ()
        ]
        return self.message("sensor_msgs/msg/PointCloud2")(
            header=header,
            height=height,
            width=width,
            fields=fields,
            is_bigendian=False,
            point_step=POINT.itemsize,
            row_step=POINT.itemsize * width,
            data=self.sequence(cloud.view(np.uint8).ravel()),
            is_dense=bool(known.all()),
        )

    def laser_scan(
        self, header: Any, ranges: np.ndarray, half_angle: float, near: float, far: float, period: float
    ) -> Any:
        """``sensor_msgs/LaserScan``.

        Args:
            header: whose frame has x forward and z up.
            ranges: ``(N,)`` [m] from right to left, each over an equal share of the view; inf is sent from
                ``far`` on.
            half_angle: of the view, to each side [rad].
            near: least range [m].
            far: greatest range [m].
            period: between two scans [s].
        """
        step = 2 * half_angle / len(ranges)
        free = np.where(ranges >= far, np.inf, ranges)
        return self.message("sensor_msgs/msg/LaserScan")(
            header=header,
            angle_min=-half_angle + step / 2,
            angle_max=half_angle - step / 2,
            angle_increment=step,
            time_increment=0.0,
            scan_time=float(period),
            range_min=float(near),
            range_max=float(far),
            ranges=self.sequence(free.astype(np.float32)),
            intensities=self.sequence(np.zeros(0, np.float32)),
        )

    def detections(self, header: Any, boxes: Any) -> Any:
        """``vision_msgs/Detection3DArray`` of :class:`eldenet.boxes.Boxes3D`.

        A box's own axes are x along its length, y to its left, z up; its pose turns them into the optical
        frame of ``header``. The covariance is that of the distance, where depth had a sigma; elsewhere it is
        0, which ROS reads as unknown.
        """
        found = [self._detection(header, boxes, index) for index in range(len(boxes))]
        return self.message("vision_msgs/msg/Detection3DArray")(header=header, detections=found)

    def _detection(self, header: Any, boxes: Any, index: int) -> Any:
        box = boxes[index]
        # (length, left, up) axes -> optical: a quarter turn about x, then yaw about y
        c, s = math.cos(box.yaw / 2), math.sin(box.yaw / 2)
        half = math.sqrt(0.5)
        turn = self.message("geometry_msgs/msg/Quaternion")(x=c * half, y=s * half, z=-s * half, w=c * half)
        place = self.message("geometry_msgs/msg/Point")(
            **dict(zip("xyz", map(float, box.center), strict=True))
        )
        pose = self.message("geometry_msgs/msg/Pose")(position=place, orientation=turn)
        length, width, height = map(float, box.size)
        size = self.message("geometry_msgs/msg/Vector3")(x=length, y=width, z=height)
        hypothesis = self.message("vision_msgs/msg/ObjectHypothesis")(class_id=box.name, score=box.score)
        uncertain = self.message("geometry_msgs/msg/PoseWithCovariance")(
            pose=pose, covariance=_covariance(box).ravel()
        )
        result = self.message("vision_msgs/msg/ObjectHypothesisWithPose")(
            hypothesis=hypothesis, pose=uncertain
        )
        return self.message("vision_msgs/msg/Detection3D")(
            header=header,
            results=[result],
            bbox=self.message("vision_msgs/msg/BoundingBox3D")(center=pose, size=size),
            id="" if boxes.track_id is None else str(boxes.track_id[index]),
        )

    def velocity(self, speed: float, turn: float, header: Any = None) -> Any:
        """``geometry_msgs/Twist``, or TwistStamped with a header: speed [m/s], turn rate [rad/s].

        A command that is not finite stops.
        """
        if not (math.isfinite(speed) and math.isfinite(turn)):
            speed = turn = 0.0
        vector = self.message("geometry_msgs/msg/Vector3")
        twist = self.message("geometry_msgs/msg/Twist")(
            linear=vector(x=float(speed), y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=float(turn))
        )
        if header is None:
            return twist
        return self.message("geometry_msgs/msg/TwistStamped")(header=header, twist=twist)


def _covariance(box: Any) -> np.ndarray:
    """``(6, 6)`` of a box's pose: of its distance along the ground, if the depth had a sigma."""
    covariance = np.zeros((6, 6))
    if box.interval is not None and box.distance > 0:
        low, high = box.interval
        ray = np.array([box.center[0], 0.0, box.center[2]]) / box.distance
        covariance[:3, :3] = ((high - low) / 2 / Z_90) ** 2 * np.outer(ray, ray)
    return covariance

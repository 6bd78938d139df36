"""Messages hold what they promise, also after a bag was written and read."""

import math
import struct

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from support.ros import BUILDER, STORE, header, image, through_cdr

from eldenet.boxes import Boxes3D, corners_of
from eldenet.data.ros_messages import read_color, read_depth, read_intrinsics, read_pose, seconds
from eldenet.geometry import back_project, pinhole

K = pinhole(110.0, 112.0, 3.5, 2.5)
COLORS = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
DEPTH = np.linspace(0.5, 8.0, 48, dtype=np.float32).reshape(6, 8)


def boxes(**more) -> Boxes3D:
    return Boxes3D(
        center=np.array([[1.0, 0.5, 4.0], [-2.0, 0.4, 9.0]]),
        size=np.array([[4.2, 1.8, 1.5], [0.6, 0.5, 1.7]]),
        yaw=np.array([0.4, -1.2]),
        score=np.array([0.9, 0.5]),
        label=np.array([1, 0]),
        names=("person", "car"),
        **more,
    )


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_bag_of_all_messages_comes_back_as_it_was_written(tmp_path, plugin) -> None:
    points = back_project(DEPTH, K)
    sent = {
        "/depth/image": BUILDER.depth_image(header(), DEPTH),
        "/depth/camera_info": BUILDER.camera_info(header(), DEPTH.shape, K),
        "/depth/points": BUILDER.point_cloud(header(), points, COLORS),
        "/detections": BUILDER.detections(header(), boxes(track_id=np.array([3, 7]))),
        "/scan": BUILDER.laser_scan(header(), np.array([1.0, 2.0, 10.0]), 0.6, 0.3, 10.0, 0.1),
        "/cmd_vel": BUILDER.velocity(0.5, -0.2),
        "/cmd_vel_stamped": BUILDER.velocity(0.5, -0.2, header(frame_id="base_link")),
    }
    with Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as bag:
        for topic, message in sent.items():
            kind = message.__msgtype__
            connection = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(connection, 12_250_000_000, STORE.serialize_cdr(message, kind))
    with Reader(tmp_path / "bag") as bag:
        got = {
            connection.topic: STORE.deserialize_cdr(data, connection.msgtype)
            for connection, _, data in bag.messages()
        }
    assert {topic: message.__msgtype__ for topic, message in got.items()} == {
        topic: message.__msgtype__ for topic, message in sent.items()
    }
    for topic, message in got.items():
        if hasattr(message, "header"):
            frame = "base_link" if topic == "/cmd_vel_stamped" else "camera_optical"
            assert (seconds(message.header.stamp), message.header.frame_id) == (12.25, frame)
    assert (read_depth(got["/depth/image"]) == DEPTH).all()
    assert (read_intrinsics(got["/depth/camera_info"], DEPTH.shape) == K).all()
    assert (read_intrinsics(got["/depth/camera_info"], DEPTH.shape, rectified=True) == K).all()
    assert [found.id for found in got["/detections"].detections] == ["3", "7"]
    assert got["/scan"].ranges.tolist() == [1.0, 2.0, math.inf]
    assert (got["/cmd_vel"].linear.x, got["/cmd_vel"].angular.z) == (0.5, -0.2)
    assert got["/cmd_vel_stamped"].twist.linear.x == 0.5


def test_the_bytes_of_a_depth_image_are_those_of_cdr() -> None:
    message = BUILDER.depth_image(header(2.5, "cam"), np.array([[1.0, 2.0]]))
    data = bytes(STORE.serialize_cdr(message, message.__msgtype__))
    assert data[:4] == b"\x00\x01\x00\x00"  # plain CDR, little endian
    assert struct.unpack_from("<iI", data, 4) == (2, 500_000_000)
    assert struct.unpack_from("<I4s", data, 12) == (4, b"cam\0")
    assert struct.unpack_from("<II", data, 20) == (1, 2)  # height, width
    assert struct.unpack_from("<I6s", data, 28) == (6, b"32FC1\0")
    assert data[38] == 0  # little endian
    assert struct.unpack_from("<II", data, 40) == (8, 8)  # step, and the number of bytes
    assert struct.unpack_from("<2f", data, 48) == (1.0, 2.0)


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "as_sent"),
    [
        ("rgb8", COLORS),
        ("bgr8", COLORS[..., ::-1]),
        ("rgba8", np.dstack([COLORS, np.full((6, 8), 9, np.uint8)])),
        ("bgra8", np.dstack([COLORS[..., ::-1], np.full((6, 8), 9, np.uint8)])),
    ],
)
def test_every_color_encoding_is_read_as_rgb(encoding, as_sent, padding) -> None:
    assert (read_color(image(as_sent, encoding, padding=padding)) == COLORS).all()


def test_gray_pictures_are_read_as_rgb() -> None:
    assert (read_color(image(COLORS[..., 0], "mono8")) == COLORS[..., :1]).all()


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("order", "<>")
def test_depth_is_read_in_meters_of_either_byte_order(order, padding) -> None:
    millimeters = np.round(DEPTH * 1000).astype(f"{order}u2")
    for encoding, values in (("32FC1", DEPTH.astype(f"{order}f4")), ("16UC1", millimeters)):
        got = read_depth(image(values, encoding, padding=padding))
        assert got.dtype == np.float32
        assert got == pytest.approx(DEPTH, abs=6e-4)
    special = np.array([[0.0, np.nan, np.inf]], np.float32)
    assert read_depth(image(special, "32FC1")).tolist() == [[0.0, pytest.approx(np.nan, nan_ok=True), np.inf]]


def test_wrong_images_end_in_one_line() -> None:
    with pytest.raises(ValueError, match=r"yuv422.*rgb8"):
        read_color(image(COLORS, "yuv422"))
    with pytest.raises(ValueError, match=r"rgb8.*32FC1, 16UC1"):
        read_depth(image(COLORS, "rgb8"))
    short = image(DEPTH, "32FC1")
    short.data = short.data[:-1]
    with pytest.raises(ValueError, match="191 bytes"):
        read_depth(short)
    narrow = image(DEPTH, "32FC1")
    narrow.step = 31
    with pytest.raises(ValueError, match="at least 32 bytes a row"):
        read_depth(narrow)
    info = BUILDER.camera_info(header(), (6, 8), K)
    with pytest.raises(ValueError, match=r"6 x 8, the picture has 12 x 16"):
        read_intrinsics(info, (12, 16))
    for value in (0.0, math.nan, math.inf):
        info.k[0] = value
        with pytest.raises(ValueError, match="calibrate"):
            read_intrinsics(info, (6, 8))


def test_a_cloud_lies_as_its_fields_say() -> None:
    depth = DEPTH.copy()
    depth[0, :3] = np.nan, np.inf, 0.0
    cloud = through_cdr(BUILDER.point_cloud(header(), back_project(depth, K), COLORS))
    assert [(field.name, field.offset, field.datatype, field.count) for field in cloud.fields] == [
        ("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 12, 7, 1),
    ]  # fmt: skip
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (6, 8, 16, 128)
    assert (cloud.is_bigendian, cloud.is_dense) == (False, False)
    at = 2 * cloud.row_step + 5 * cloud.point_step  # row 2, column 5
    x, y, z, blue, green, red, _ = struct.unpack_from("<3f4B", cloud.data.tobytes(), at)
    assert [red, green, blue] == COLORS[2, 5].tolist()
    assert (x, y, z) == pytest.approx(
        (depth[2, 5] * (5 - 3.5) / 110, depth[2, 5] * (2 - 2.5) / 112, depth[2, 5])
    )
    assert np.isnan(np.frombuffer(cloud.data.tobytes(), "<f4").reshape(6, 8, 4)[0, :3, :3]).all()
    assert BUILDER.point_cloud(header(), back_project(DEPTH, K), COLORS).is_dense


def test_detections_enclose_the_boxes() -> None:
    found = through_cdr(BUILDER.detections(header(), boxes())).detections
    assert [each.results[0].hypothesis.class_id for each in found] == ["car", "person"]
    assert [each.results[0].hypothesis.score for each in found] == [0.9, 0.5]
    assert [each.id for each in found] == ["", ""]
    for each, corners in zip(found, corners_of(boxes().center, boxes().size, boxes().yaw), strict=True):
        q, p, size = each.bbox.center.orientation, each.bbox.center.position, each.bbox.size
        assert math.hypot(q.x, q.y, q.z, q.w) == pytest.approx(1)
        turn = np.array(
            [
                [1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y - q.z * q.w), 2 * (q.x * q.z + q.y * q.w)],
                [2 * (q.x * q.y + q.z * q.w), 1 - 2 * (q.x**2 + q.z**2), 2 * (q.y * q.z - q.x * q.w)],
                [2 * (q.x * q.z - q.y * q.w), 2 * (q.y * q.z + q.x * q.w), 1 - 2 * (q.x**2 + q.y**2)],
            ]
        )
        assert turn @ [0, 0, 1] == pytest.approx([0, -1, 0])  # up: y is down in an optical frame
        half = np.array([size.x, size.y, size.z]) / 2
        signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        mine = signs * half @ turn.T + [p.x, p.y, p.z]
        assert sorted(mine.round(6).tolist()) == sorted(corners.round(6).tolist())
        assert not each.results[0].pose.covariance.any()  # unknown


def test_a_distance_with_an_interval_gives_a_covariance_along_the_ray() -> None:
    ends = {"distance_low": np.array([3.5, 8.0]), "distance_high": np.array([4.9, 11.0])}
    first = BUILDER.detections(header(), boxes(quality=ends)).detections[0]
    covariance = first.results[0].pose.covariance.reshape(6, 6)
    ray = np.array([1.0, 0, 4.0]) / math.hypot(1, 4)
    assert ray @ covariance[:3, :3] @ ray == pytest.approx((0.7 / 1.64) ** 2)
    assert np.linalg.matrix_rank(covariance) == 1


def test_a_scan_looks_right_first_and_reads_inf_where_nothing_is() -> None:
    scan = through_cdr(BUILDER.laser_scan(header(), np.array([1.0, 2.0, 3.0, 10.0]), 0.4, 0.3, 10.0, 0.2))
    assert (scan.angle_min, scan.angle_max, scan.angle_increment) == pytest.approx((-0.3, 0.3, 0.2))
    assert scan.ranges.tolist() == [1.0, 2.0, 3.0, math.inf]
    assert (scan.range_min, scan.range_max, scan.scan_time) == pytest.approx((0.3, 10.0, 0.2))
    assert scan.intensities.size == 0


@pytest.mark.parametrize("wrong", [(math.nan, 0.1), (0.5, math.inf), (-math.inf, math.nan)])
def test_a_velocity_that_is_not_finite_is_zero(wrong) -> None:
    twist = BUILDER.velocity(*wrong)
    assert (twist.linear.x, twist.angular.z) == (0.0, 0.0)


def test_a_pose_is_read_and_a_broken_quaternion_has_no_heading() -> None:
    def odometry(x, y, z, w):
        types = STORE.types
        place = types["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=0.0)
        turn = types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
        pose = types["geometry_msgs/msg/Pose"](position=place, orientation=turn)
        both = types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36))
        return type("Odometry", (), {"pose": both})

    assert read_pose(odometry(0, 0, math.sin(0.35), math.cos(0.35))) == pytest.approx((1.0, 2.0, 0.7))
    for broken in ((0, 0, 0, 0), (0, 0, math.nan, 1), (0, 0, 1e200, 1e200)):
        assert math.isnan(read_pose(odometry(*broken))[2])

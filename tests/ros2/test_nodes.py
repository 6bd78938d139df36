"""The thin layer over ROS, with stand-ins for its modules: what is sent, and by which names."""

import importlib
import math
import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from omegaconf import OmegaConf
from support.ros import BUILDER, STORE, complaints, header, image, stamp

from eldenet.geometry import pinhole

PACKAGE = Path(__file__).parents[2] / "ros2/eldenet_ros"
NODES = ("depth", "boxes", "scan", "drive")
K = pinhole(110.0, 110.0, 80.0, 60.0)
PHOTO = np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8)


class Node:
    """ROS's, as far as the nodes use it; publishers refuse what rclpy refuses."""

    given: dict = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.name, self.logger, self.sent, self.callbacks = name, MagicMock(), {}, {}
        self.parameters: dict = {}
        self.published: set = set()  # by other nodes
        self.now = 12.3

    def declare_parameter(self, name, default):
        self.parameters[name] = default
        return SimpleNamespace(value=self.given.get(name, default))

    def get_logger(self):
        return self.logger

    def get_clock(self):
        now = SimpleNamespace(nanoseconds=int(self.now * 1e9), to_msg=lambda: stamp(self.now))
        return SimpleNamespace(now=lambda: now)

    def create_subscription(self, kind, topic, callback, queue) -> None:
        self.callbacks[topic] = callback

    def resolve_topic_name(self, topic):
        return f"/{topic}"

    def count_publishers(self, topic):
        return int(topic in self.published)

    def create_service(self, kind, name, callback) -> None:
        self.callbacks[name] = callback

    def create_timer(self, *arguments) -> None: ...

    def destroy_node(self) -> None: ...

    def create_publisher(self, kind, topic, queue):
        sent = self.sent.setdefault(topic, [])

        def publish(message) -> None:
            assert isinstance(message, kind)
            assert complaints(message) == []
            sent.append(message)

        return SimpleNamespace(publish=publish, get_subscription_count=lambda: 1)


@pytest.fixture
def ros(monkeypatch):
    """Give a function that makes a node, by its file's name and its parameters."""
    parts = ("exceptions", "node", "qos", "signals")
    for name in ("rclpy", *(f"rclpy.{part}" for part in parts), "message_filters", "std_srvs.srv"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    monkeypatch.setattr(sys.modules["rclpy.exceptions"], "ParameterException", KeyError)
    monkeypatch.setattr(sys.modules["rclpy.node"], "Node", Node)
    for package in {kind.split("/")[0] for kind in STORE.types}:
        for name in (package, f"{package}.msg"):
            monkeypatch.setitem(sys.modules, name, ModuleType(name))
    for kind, message in STORE.types.items():
        package, _, short = kind.split("/")
        setattr(sys.modules[f"{package}.msg"], short, message)
    names = [f"eldenet_ros.{name}" for name in ("ros", *(f"{each}_node" for each in NODES))]

    def forget() -> None:
        for name in names:
            sys.modules.pop(name, None)

    def make(name: str, **given):
        forget()
        monkeypatch.setattr(Node, "given", given)
        return getattr(importlib.import_module(f"eldenet_ros.{name}_node"), f"{name.title()}Node")()

    yield make
    forget()


def camera_info(intrinsics: np.ndarray = K, size: tuple[int, int] = (120, 160)):
    return BUILDER.camera_info(header(), size, intrinsics)


def odometry(x: float, when: float = 12.25):
    types = STORE.types
    place = types["geometry_msgs/msg/Point"](x=x, y=0.0, z=0.0)
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    pose = SimpleNamespace(pose=types["geometry_msgs/msg/Pose"](position=place, orientation=turn))
    return SimpleNamespace(header=header(when, "odom"), pose=pose)


def depth_image(meters: float, when: float = 12.25):
    return image(np.full((120, 160), meters, np.float32), "32FC1", when=when)


@pytest.fixture(params=["plan", "plan_when_stuck", None])
def drive(ros, request):
    node = ros("drive", **({request.param: True} if request.param else {}))
    node.on_info(camera_info())
    node.on_depth(depth_image(6.0))
    node.on_odometry(odometry(0.0))
    node.on_goal(odometry(5.0).__class__(header=header(12.25, "odom"), pose=odometry(5.0).pose.pose))
    return node


def decision(node) -> tuple[float, float]:
    node.decide()
    twist = node.sent["cmd_vel"][-1]
    return twist.linear.x, twist.angular.z


def test_the_driver_moves_and_stops_while_its_data_are_not_finite(drive) -> None:
    assert decision(drive)[0] > 0
    for act, good, word in (
        (lambda: drive.on_odometry(odometry(math.nan)), lambda: drive.on_odometry(odometry(0.1)), "odometry"),
        (lambda: drive.on_odometry(odometry(math.inf)), lambda: drive.on_odometry(odometry(0.1)), "odometry"),
        (lambda: drive.on_depth(depth_image(math.nan)), lambda: drive.on_depth(depth_image(5.9)), "no value"),
        (lambda: drive.on_depth(depth_image(0.0)), lambda: drive.on_depth(depth_image(5.9)), "no value"),
    ):
        act()
        assert decision(drive) == (0.0, 0.0)
        assert word in drive.logger.info.call_args.args[0]
        good()
        assert decision(drive)[0] > 0


@pytest.mark.parametrize("sigma_first", [True, False])
def test_the_driver_stands_while_a_network_is_unsure_of_what_it_sees(drive, sigma_first) -> None:
    drive.published = {"/depth/sigma"}
    for number, (sigma, moves) in enumerate([(0.5, True), (3.0, False), (0.5, True)], 1):
        drive.now = when = 12.3 + 0.2 * number
        both = [
            lambda when=when: drive.on_depth(depth_image(6.0, when)),
            lambda when=when, sigma=sigma: drive.on_sigma(depth_image(sigma, when)),
        ]
        for act in reversed(both) if sigma_first else both:
            act()
        drive.on_odometry(odometry(0.0, when))
        assert (decision(drive)[0] > 0) == moves
        assert ("100% of the view is unsure" in str(drive.logger.info.call_args)) == (not moves)
        drive.logger.reset_mock()


def test_depth_whose_sigma_is_missing_does_not_count(drive) -> None:
    drive.published = {"/depth/sigma"}
    drive.now = 12.9
    drive.on_odometry(odometry(0.1, 12.9))
    drive.on_depth(depth_image(6.0, 12.9))
    assert decision(drive) == (0.0, 0.0)
    assert "depth is 0.7 s old" in drive.logger.info.call_args.args[0]


@pytest.mark.parametrize("silent", ["depth", "odometry"])
def test_the_driver_stops_when_a_topic_falls_silent(drive, silent) -> None:
    assert decision(drive)[0] > 0
    drive.now = 13.0
    if silent == "depth":
        drive.on_odometry(odometry(0.1, 12.95))
    else:
        drive.on_depth(depth_image(6.0, 12.95))
    assert decision(drive) == (0.0, 0.0)
    assert f"{silent} is 0.8 s old" in drive.logger.info.call_args.args[0]


def test_a_depth_image_that_cannot_be_read_is_logged_and_does_not_count(drive) -> None:
    drive.now = 13.0
    drive.on_odometry(odometry(0.1, 12.95))
    drive.on_depth(image(np.zeros((120, 160, 3), np.uint8), "rgb8", when=12.95))
    assert "publish 32FC1" in drive.logger.error.call_args.args[0]
    assert decision(drive) == (0.0, 0.0)


def test_after_a_reset_the_driver_stands_until_there_is_a_goal(drive) -> None:
    for number in range(30):  # the odometry stands while the robot is told to drive
        drive.now = when = 12.3 + 0.2 * number
        drive.on_depth(depth_image(6.0 - 0.01 * number, when))
        drive.on_odometry(odometry(0.0, when))
        stopped = decision(drive) == (0.0, 0.0)
    assert stopped
    assert "reset() once that is over" in str(drive.logger.info.call_args)
    response = drive.callbacks["~/reset"](None, SimpleNamespace())
    assert (response.success, response.message) == (True, "send a goal")
    assert decision(drive) == (0.0, 0.0)
    assert "no goal" in str(drive.logger.info.call_args)
    drive.on_goal(SimpleNamespace(header=header(when, "odom"), pose=odometry(5.0).pose.pose))
    assert decision(drive)[0] > 0


def test_the_driver_drives_by_a_lidar_instead_of_depth(ros) -> None:
    node = ros("drive", lidar="/scan", plan=True)
    assert {topic for topic in node.callbacks if "depth" in topic} == set()
    node.on_odometry(odometry(0.0))
    node.on_goal(SimpleNamespace(header=header(12.25, "odom"), pose=odometry(5.0).pose.pose))
    for number, (distance, moves) in enumerate([(6.0, True), (math.nan, False), (6.5, True)]):
        node.now = when = 12.3 + 0.2 * number
        node.on_odometry(odometry(0.0, when))
        ranges = np.full(720, distance)
        node.callbacks["/scan"](BUILDER.laser_scan(header(when), ranges, 2.356, 0.1, 12.0, 0.1))
        assert (decision(node)[0] > 0) == moves
    node.callbacks["/scan"](BUILDER.laser_scan(header(when), ranges, 2.356, 0.1, 0.0, 0.1))
    assert "its publisher must send meters" in node.logger.error.call_args.args[0]


def test_stamped_commands_have_the_time_and_the_frame(ros) -> None:
    node = ros("drive", stamped=True, frame="base")
    node.decide()
    (message,) = node.sent["cmd_vel"]
    assert (message.header.frame_id, message.header.stamp.sec) == ("base", 12)
    assert message.twist.linear.x == 0.0


def test_the_last_command_of_the_driver_stops_the_robot(ros, monkeypatch) -> None:
    ros("drive")
    module = sys.modules["eldenet_ros.drive_node"]
    nodes = []
    monkeypatch.setattr(module, "DriveNode", lambda make=module.DriveNode: nodes.append(make()) or nodes[0])
    monkeypatch.setattr(module.signal, "signal", MagicMock())

    def crash(node) -> None:
        node.send(0.7, 0.1)
        raise RuntimeError

    sys.modules["rclpy"].spin = crash
    with pytest.raises(RuntimeError):
        module.main()
    assert [message.linear.x for message in nodes[0].sent["cmd_vel"]] == [0.7, 0.0]


@pytest.mark.parametrize("checkpoint", ["eldenet_indoor", "model_folder"])
def test_depth_and_cloud_have_the_pictures_stamp_frame_and_meters(ros, request, checkpoint) -> None:
    if checkpoint == "model_folder":
        checkpoint = str(request.getfixturevalue(checkpoint))
    node = ros("depth", checkpoint=checkpoint)
    node.on_info(camera_info())
    node.on_image(image(PHOTO, "rgb8"))
    (depth,), (info,), (cloud,) = (node.sent[f"depth/{name}"] for name in ("image", "camera_info", "points"))
    for message in (depth, info, cloud):
        assert (message.header.stamp.sec, message.header.frame_id) == (12, "camera_optical")
    meters = np.frombuffer(depth.data, np.float32).reshape(120, 160)
    assert (cloud.height, cloud.width) == (60, 80)
    z = np.frombuffer(cloud.data, np.float32).reshape(60, 80, 4)[..., 2]
    assert (z == meters[::2, ::2]).all()
    assert (info.height, info.width) == (120, 160)
    assert (info.k == K.ravel()).all()
    assert ("depth/sigma" in node.sent) == node.predictor.uncertainty


def test_meters_are_for_the_lens_of_the_calibration(ros) -> None:
    """The default network sees the lens: a longer one shows the same picture farther away."""
    medians = []
    for focal in (110.0, 220.0):
        node = ros("depth")
        node.on_info(camera_info(pinhole(focal, focal, 80.0, 60.0)))
        node.on_image(image(PHOTO, "rgb8"))
        found = np.frombuffer(node.sent["depth/image"][0].data, np.float32)
        assert found == pytest.approx(node.predictor(PHOTO, focal=focal).depth.ravel(), rel=1e-4)
        medians.append(np.median(found))
    assert medians[1] > 1.3 * medians[0]


def test_a_picture_without_calibration_is_logged(ros) -> None:
    node = ros("depth")
    node.on_image(image(PHOTO, "rgb8"))
    assert "no camera_info" in node.logger.error.call_args.args[0]
    assert node.sent["depth/image"] == []


@pytest.mark.parametrize("gray", [0, 255])
def test_a_cloud_keeps_points_that_the_network_is_unsure_of(ros, gray) -> None:
    """A costmap that reads it must see what is before a dark or covered lens."""
    node = ros("depth", cloud_step=1)
    node.on_info(camera_info())
    node.on_image(image(np.full((120, 160, 3), gray, np.uint8), "rgb8"))
    depth, sigma = (
        np.frombuffer(node.sent[name][0].data, np.float32) for name in ("depth/image", "depth/sigma")
    )
    assert (sigma > 0.3 * depth).mean() > 0.9
    z = np.frombuffer(node.sent["depth/points"][0].data, np.float32).reshape(-1, 4)[:, 2]
    assert (z == depth).all()


def test_boxes_are_published_with_a_number_in_the_pictures_frame(ros, tmp_path, monkeypatch) -> None:
    import eldenet.perception.onnx_detector
    from eldenet.boxes import Detections2D
    from eldenet.perception.detectors import FixedDetections

    seen = Detections2D(np.array([[60.0, 40.0, 100.0, 80.0]]), np.array([0.8]), np.array([0]), ("car",))
    monkeypatch.setattr(
        eldenet.perception.onnx_detector, "OnnxDetector", lambda path, **_: FixedDetections([seen] * 3)
    )
    node = ros("boxes", detector="any.onnx", sigma_distribution="laplace")
    assert node.lifter.depth_sigma is None  # the default of the depth's source
    node.on_info(camera_info())
    for number in range(3):
        when = 12.25 + number / 10
        parts = [image(PHOTO, "rgb8", when=when)]
        parts += [image(np.full((120, 160), value, np.float32), "32FC1", when=when) for value in (6.0, 0.5)]
        node.on_picture(*parts)
    found = node.sent["detections"][-1]
    assert (found.header.frame_id, found.header.stamp.nanosec) == ("camera_optical", 450_000_000)
    (car,) = found.detections
    assert car.results[0].hypothesis.class_id == "car"
    assert car.id.isdigit()
    assert 5 < car.bbox.center.position.z < 9


def test_boxes_without_a_detector_end_in_one_line(ros) -> None:
    with pytest.raises(ValueError, match=r"detector is empty: .*\.onnx"):
        ros("boxes")


def test_a_scan_has_the_stamp_of_its_depth_and_a_frame_of_its_own(ros) -> None:
    node = ros("scan", frame="camera_link")
    node.on_info(camera_info())
    node.on_depth(depth_image(2.0))
    node.on_depth(depth_image(2.0, 12.5))
    scan = node.sent["scan"][-1]
    assert (scan.header.stamp.nanosec, scan.header.frame_id) == (500_000_000, "camera_link")
    assert scan.scan_time == pytest.approx(0.25)
    assert min(scan.ranges) == pytest.approx(2.0, rel=0.01)


def test_the_yaml_has_every_parameter_with_its_default(ros) -> None:
    stored = OmegaConf.to_container(OmegaConf.load(PACKAGE / "config/eldenet.yaml"))
    assert list(stored) == [f"eldenet_{name}" for name in ("depth", "scan", "boxes", "drive")]
    for name in NODES:
        try:
            ros(name)
        except ValueError:
            assert name == "boxes"
        defaults = sys.modules[f"eldenet_ros.{name}_node"].PARAMETERS
        assert stored[f"eldenet_{name}"]["ros__parameters"] == defaults


def test_no_beam_of_the_scan_is_lost_in_nav2s_costmap() -> None:
    def parameters(file: str, *names: str) -> dict:
        found = OmegaConf.to_container(OmegaConf.load(PACKAGE / "config" / file))
        for name in names:
            found = found[name]
        return found["ros__parameters"]

    scan = parameters("eldenet.yaml", "eldenet_scan")
    source = parameters("nav2_costmap.yaml", "local_costmap", "local_costmap")["obstacle_layer"]["scan"]
    assert source["inf_is_valid"]
    assert source["obstacle_min_range"] < scan["range_min"]
    assert source["obstacle_max_range"] < scan["range_max"]
    assert source["min_obstacle_height"] < scan["camera_height"] < source["max_obstacle_height"]


@pytest.fixture
def launched(monkeypatch):
    """Give a function that starts the launch file by its arguments; returns the options of its nodes."""
    for name in ("ament_index_python.packages", "launch", "launch.actions", "launch.conditions",
                 "launch.substitutions", "launch_ros.actions",
                 "launch_ros.parameter_descriptions"):  # fmt: skip
        monkeypatch.setitem(sys.modules, name, MagicMock())
    sys.modules["ament_index_python.packages"].get_package_share_directory = lambda name: PACKAGE
    sys.modules["launch"].LaunchDescription = list
    sys.modules["launch.actions"].DeclareLaunchArgument = lambda name, **options: (name, options)
    sys.modules["launch.actions"].OpaqueFunction = lambda function: function
    sys.modules["launch.conditions"].IfCondition = {"true": True, "True": True}.get
    sys.modules["launch.substitutions"].LaunchConfiguration = lambda name: SimpleNamespace(
        perform=lambda context: context[name]
    )
    sys.modules["launch_ros.actions"].Node = dict
    sys.modules["launch_ros.parameter_descriptions"].ParameterValue = lambda value, value_type: (
        value_type,
        value,
    )

    def start(**given: str) -> dict[str, dict]:
        file = runpy.run_path(str(PACKAGE / "launch/eldenet.launch.py"))
        *declared, nodes = file["generate_launch_description"]()
        defaults = {name: options["default_value"] for name, options in declared}
        assert set(given) <= set(defaults)
        return {node["executable"]: node for node in nodes(defaults | given) if node["condition"]}

    return start


def test_the_launch_file_starts_the_installed_nodes_with_their_topics(launched, monkeypatch) -> None:
    started = launched(drive="true", detector="/boxes.onnx")
    assert set(started) == set(NODES)
    setup: dict = {}
    monkeypatch.setitem(
        sys.modules, "setuptools", SimpleNamespace(setup=lambda **options: setup.update(options))
    )
    runpy.run_path(str(PACKAGE / "setup.py"))
    scripts = dict(line.split(" = ") for line in setup["entry_points"]["console_scripts"])
    for name, options in started.items():
        target, function = scripts[name].split(":")
        assert f"def {function}(" in (PACKAGE / f"{target.replace('.', '/')}.py").read_text()
        assert options["name"] == f"eldenet_{name}"
        assert Path(options["parameters"][0]).is_file()
        source = (PACKAGE / f"eldenet_ros/{name}_node.py").read_text()
        for topic, _ in options["remappings"]:
            assert f'"{topic}"' in source


def test_an_argument_of_the_launch_file_counts_only_where_it_is_given(launched) -> None:
    assert set(launched()) == {"depth", "scan"}
    assert launched(drive="true", params="mine.yaml")["drive"]["parameters"] == ["mine.yaml"]
    own = launched(drive="true", depth="false", lidar="/scan", detector="/it's.onnx")
    assert own["drive"]["parameters"][1:] == [{"lidar": (str, "/scan")}]
    assert own["boxes"]["parameters"][1:] == [{"detector": (str, "/it's.onnx")}]
    assert set(own) == {"scan", "boxes", "drive"}


def test_documented_arguments_of_the_launch_file_exist(launched) -> None:
    pages = [*PACKAGE.glob("*.md"), *PACKAGE.glob("config/*.yaml"), *PACKAGE.parents[1].glob("docs/*.md")]
    text = "\n".join(page.read_text() for page in pages)
    lines = re.findall(r"ros2 launch eldenet_ros eldenet\.launch\.py(.*)", text)
    assert len(lines) > 4
    for line in lines:
        launched(**dict(re.findall(r"(\w+):=(\S+)", line)))


def test_the_package_names_what_it_imports() -> None:
    named = set(re.findall(r"<exec_depend>(\w+)<", (PACKAGE / "package.xml").read_text()))
    for file in [*PACKAGE.glob("eldenet_ros/*.py"), *PACKAGE.glob("launch/*.py")]:
        text = file.read_text()
        imported = set(re.findall(r"^(?:from|import) (\w+)", text, re.M))
        imported |= {kind.split("/")[0] for kind in re.findall(r'"(\w+/msg)/\w+"', text)}
        ours = {"eldenet", "eldenet_ros", "numpy", *sys.stdlib_module_names}
        assert imported - ours <= named, file.name

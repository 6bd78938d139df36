"""Depth and a scan of one camera; with ``detector:=`` boxes, with ``drive:=true`` the driver."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = "eldenet_ros"
ARGUMENTS = {
    "image": ("/camera/image_raw", "the camera's pictures"),
    "camera_info": ("/camera/camera_info", "their calibration"),
    "depth_image": ("/depth/image", "depth: of the network, or of a depth camera with depth:=false"),
    "depth_info": ("/depth/camera_info", "its calibration"),
    "depth": ("true", "predict depth; false: a depth camera publishes it"),
    "scan": ("true", "publish a LaserScan for Nav2"),
    "detector": ("", "an .onnx file: publish 3D boxes"),
    "drive": ("false", "publish cmd_vel: the robot moves as soon as it gets a goal"),
    "lidar": ("", "topic of a lidar's LaserScan, such as /scan: drive by it instead of depth"),
    "odom": ("/odom", "odometry of the driver"),
    "cmd_vel": ("/cmd_vel", "its commands"),
    "params": (str(Path(get_package_share_directory(PACKAGE)) / "config/eldenet.yaml"), "parameters"),
}


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    declared = (
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    )
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes for the arguments that were given; an empty one leaves the parameters as they are."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    depth = [("depth/image", given["depth_image"]), ("depth/camera_info", given["depth_info"])]
    picture, base = ("image", given["image"]), [("odom", given["odom"]), ("cmd_vel", given["cmd_vel"])]

    def node(name: str, condition: str, remappings: list, argument: str = "") -> Node:
        # as text: launch reads a bare value as YAML
        own = [{argument: ParameterValue(given[argument], value_type=str)}] if given.get(argument) else []
        return Node(
            package=PACKAGE,
            executable=name,
            name=f"eldenet_{name}",
            output="screen",
            condition=IfCondition(condition),
            parameters=[given["params"], *own],
            remappings=remappings,
        )

    return [
        node("depth", given["depth"], [picture, ("camera_info", given["camera_info"]), *depth]),
        node("scan", given["scan"], depth),
        node("boxes", str(bool(given["detector"])), [picture, *depth], "detector"),
        node("drive", given["drive"], [*depth, *base], "lidar"),
    ]

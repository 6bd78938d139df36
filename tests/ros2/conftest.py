"""The ROS package lies beside ours; colcon installs it on a robot."""

import sys
from pathlib import Path

ROS_PACKAGE = Path(__file__).parents[2] / "ros2/eldenet_ros"
if str(ROS_PACKAGE) not in sys.path:
    sys.path.insert(0, str(ROS_PACKAGE))

"""An ament_python package: ``colcon build`` installs it."""

from glob import glob

from setuptools import setup

NAME = "eldenet_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
    ],
    install_requires=["setuptools"],
    maintainer="The eldenet authors",
    maintainer_email="eldenet@users.noreply.github.com",
    description="Depth of one camera, point clouds, 3D boxes, laser scans and a driver, by eldenet.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"{name} = {NAME}.{name}_node:main" for name in ("depth", "boxes", "scan", "drive")
        ]
    },
)

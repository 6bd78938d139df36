"""Small recordings in the layouts of phones, depth cameras and robots, written by the tests.

Frame ``i`` has a picture of gray ``20 * i`` and a depth of ``1 + i / 4`` meters, so that a wrong pair shows.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import OpenEXR

SIZE = (48, 64)  # of the pictures
CAMERA = (60.0, 61.0, 31.0, 24.0)  # of the pictures: fx, fy, cx, cy
COUNT = 6
POSE = [[1, 0, 0, 0.5], [0, 1, 0, 0.25], [0, 0, 1, -2], [0, 0, 0, 1]]  # camera to world, axes of ARKit


class Recorder(NamedTuple):
    """A layout: what writes it with depth maps of a size, and the settings that read it."""

    write: Callable[[Path, tuple[int, int]], None]
    settings: tuple[str, ...]
    has_camera: bool = True


def picture(path: Path, i: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((*SIZE, 3), 20 * i, np.uint8))


def meters(i: int) -> float:
    return 1 + i / 4


def depth(path: Path, i: int, size: tuple[int, int], scale: float = 0.001) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".exr":
        pixels = np.full(size, meters(i), np.float32)
        OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, {"R": pixels}).write(str(path))
    else:
        assert cv2.imwrite(str(path), np.full(size, round(meters(i) / scale), np.uint16))


def confidence(path: Path, size: tuple[int, int]) -> None:
    """The left half is high, the right half low."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.zeros(size, np.uint8)
    values[:, : size[1] // 2] = 2
    assert cv2.imwrite(str(path), values)


def columns(camera: tuple[float, ...] = CAMERA) -> list[float]:
    """The nine numbers of the intrinsics column by column, as ARKit and Open3D write them."""
    fx, fy, cx, cy = camera
    return [fx, 0, 0, 0, fy, 0, cx, cy, 1]


def rows(camera: tuple[float, ...] = CAMERA) -> list[float]:
    fx, fy, cx, cy = camera
    return [fx, 0, cx, 0, fy, cy, 0, 0, 1]


def text(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content))


def record3d(root: Path, size: tuple[int, int]) -> None:
    for i in range(COUNT):
        picture(root / f"rgb/{i}.jpg", i)
        depth(root / f"depth/{i}.exr", i, size)
    text(root / "metadata.json", {"w": SIZE[1], "h": SIZE[0], "K": columns(), "fps": 60})


def stray_scanner(root: Path, size: tuple[int, int]) -> None:
    for i in range(COUNT):
        picture(root / f"rgb/{i:06d}.jpg", i)
        depth(root / f"depth/{i:06d}.png", i, size)
        confidence(root / f"confidence/{i:06d}.png", size)
    fx, fy, cx, cy = CAMERA
    text(root / "camera_matrix.csv", f"{fx}, 0.0, {cx}\n0.0, {fy}, {cy}\n0.0, 0.0, 1.0\n")


def scanner_app(root: Path, size: tuple[int, int]) -> None:
    for i in range(COUNT):
        picture(root / f"frame_{i:05d}.jpg", i)
        depth(root / f"depth_{i:05d}.png", i, size)
        confidence(root / f"conf_{i:05d}.png", size)
        record = {"intrinsics": rows(), "cameraPoseARFrame": np.ravel(POSE).tolist(), "time": i / 10}
        text(root / f"frame_{i:05d}.json", record)


def arkit_scenes(root: Path, size: tuple[int, int]) -> None:
    for i in range(COUNT):
        time = 6789.123 + i / 10
        picture(root / f"lowres_wide/4201_{time:.3f}.png", i)
        depth(root / f"lowres_depth/4201_{time + 0.004:.3f}.png", i, size)
        confidence(root / f"confidence/4201_{time + 0.004:.3f}.png", size)
        camera = " ".join(map(str, (SIZE[1], SIZE[0], *CAMERA)))
        text(root / f"lowres_wide_intrinsics/4201_{time:.3f}.pincam", camera)


def polycam(root: Path, size: tuple[int, int]) -> None:
    names = ("fx", "fy", "cx", "cy")
    for i in range(COUNT):
        name = str(1442008525605 + 100_000 * i)
        picture(root / f"keyframes/images/{name}.jpg", i)
        depth(root / f"keyframes/depth/{name}.png", i, size)
        confidence(root / f"keyframes/confidence/{name}.png", size)
        camera = dict(zip(names, CAMERA, strict=True)) | {"width": SIZE[1], "height": SIZE[0]}
        camera |= {f"t_{row}{column}": POSE[row][column] for row in range(3) for column in range(4)}
        text(root / f"keyframes/cameras/{name}.json", camera)


def nerfstudio(root: Path, size: tuple[int, int]) -> None:
    frames = []
    for i in range(COUNT):
        picture(root / f"images/frame_{i:05d}.jpg", i)
        depth(root / f"depths/depth_{i:05d}.png", i, size)
        files = {"file_path": f"./images/frame_{i:05d}.jpg", "depth_file_path": f"depths/depth_{i:05d}.png"}
        frames.append({**files, "transform_matrix": POSE})
    camera = dict(zip(("fl_x", "fl_y", "cx", "cy"), CAMERA, strict=True))
    text(root / "transforms.json", {**camera, "w": SIZE[1], "h": SIZE[0], "frames": frames})


def tum(root: Path, size: tuple[int, int]) -> None:
    lists = {"rgb": ["# color images"], "depth": ["# depth maps"]}
    for i in range(COUNT):
        times = {"rgb": 1305031102.175304 + i / 30, "depth": 1305031102.160407 + i / 30}
        picture(root / f"rgb/{times['rgb']:.6f}.png", i)
        depth(root / f"depth/{times['depth']:.6f}.png", i, size, 1 / 5000)
        for kind, time in times.items():
            lists[kind].append(f"{time:.6f} {kind}/{time:.6f}.png")
    for kind, lines in lists.items():
        text(root / f"{kind}.txt", "\n".join(lines) + "\n")
    pairs = (f"{one} {other}" for one, other in zip(lists["rgb"][1:], lists["depth"][1:], strict=True))
    text(root / "associations.txt", "\n".join(pairs) + "\n")


def open3d(root: Path, size: tuple[int, int]) -> None:
    """What Open3D's readers write for a RealSense or an Azure Kinect."""
    for i in range(COUNT):
        picture(root / f"color/{i:05d}.jpg", i)
        depth(root / f"depth/{i:05d}.png", i, size)
    camera = {"width": SIZE[1], "height": SIZE[0], "intrinsic_matrix": columns()}
    text(root / "camera_intrinsic.json", camera)


def prefixes(root: Path, size: tuple[int, int]) -> None:
    for i in range(COUNT):
        picture(root / f"color_{i:04d}.png", i)
        depth(root / f"depth_{i:04d}.png", i, size)


def suffixes(root: Path, size: tuple[int, int]) -> None:
    """7-Scenes: a folder for each sequence, all in one."""
    for i in range(COUNT):
        stem = f"seq-{i % 3 + 1:02d}/frame-{i:06d}"
        picture(root / f"{stem}.color.png", i)
        depth(root / f"{stem}.depth.png", i, size)


def scenes(root: Path, size: tuple[int, int]) -> None:
    """ScanNet's exported scenes."""
    for i in range(COUNT):
        scene = f"scene000{i % 3}_00"
        picture(root / f"{scene}/color/{i}.jpg", i)
        depth(root / f"{scene}/depth/{i}.png", i, size)


def clock(root: Path, size: tuple[int, int]) -> None:
    """Frames of a ROS bag: nanoseconds as names, and more pictures than depth maps."""
    for i in range(COUNT):
        stamp = 1700000000_000000000 + i * 33_000_000
        picture(root / f"camera/color/{stamp}.png", i)
        if i != 2:
            depth(root / f"camera/depth/{stamp + 4_000_000}.png", i, size)


def in_order(root: Path, size: tuple[int, int]) -> None:
    for i in range(COUNT):
        picture(root / f"left/IMG_{8 + i}.jpg", i)  # IMG_10 comes after IMG_9
        depth(root / f"range/scan{i + 100}.png", i, size)


def table(root: Path, size: tuple[int, int]) -> None:
    lines = ["rgb,depth_mm,fx,fy,cx,cy,scene"]
    for i in range(COUNT):
        picture(root / f"a/{i}.jpg", i)
        depth(root / f"b/{i + 1}.png", i, size)
        lines.append(f"a/{i}.jpg,b/{i + 1}.png,{','.join(map(str, CAMERA))},room{i % 2}")
    text(root / "pairs.csv", "\n".join(lines) + "\n")


RECORDERS = {
    "record3d": Recorder(
        record3d, ("images=rgb", "depths=depth", "encoding=meters", "intrinsics=metadata.json")
    ),
    "stray_scanner": Recorder(
        stray_scanner,
        ("images=rgb", "depths=depth", "confidence=confidence", "intrinsics=camera_matrix.csv"),
    ),
    "scanner_app": Recorder(
        scanner_app,
        (
            "images='frame_*.jpg'",
            "depths='depth_*.png'",
            "confidence='conf_*.png'",
            "intrinsics='frame_*.json'",
        ),
    ),
    "arkit_scenes": Recorder(
        arkit_scenes,
        (
            "images=lowres_wide",
            "depths=lowres_depth",
            "confidence=confidence",
            "intrinsics=lowres_wide_intrinsics",
            "pair_by=time",
        ),
    ),
    "polycam": Recorder(
        polycam,
        (
            "images=keyframes/images",
            "depths=keyframes/depth",
            "confidence=keyframes/confidence",
            "intrinsics=keyframes/cameras",
        ),
    ),
    "nerfstudio": Recorder(nerfstudio, ("csv=transforms.json",)),
    "tum": Recorder(tum, ("images=rgb.txt", "depths=depth.txt", "encoding=tum"), has_camera=False),
    "associations": Recorder(tum, ("csv=associations.txt", "encoding=tum"), has_camera=False),
    "open3d": Recorder(open3d, ("images=color", "depths=depth", "intrinsics=camera_intrinsic.json")),
    "prefixes": Recorder(prefixes, ("images='color_*.png'", "depths='depth_*.png'"), has_camera=False),
    "suffixes": Recorder(
        suffixes, ("images='seq-*/frame-*.color.png'", "depths='seq-*/frame-*.depth.png'"), has_camera=False
    ),
    "scenes": Recorder(scenes, ("images='*/color'", "depths='*/depth'"), has_camera=False),
    "clock": Recorder(
        clock, ("images=camera/color", "depths=camera/depth", "pair_by=time"), has_camera=False
    ),
    "in_order": Recorder(in_order, ("images=left", "depths=range", "pair_by=order"), has_camera=False),
    "table": Recorder(table, ("csv=pairs.csv",)),
}
"""Layouts by name. ``settings`` are those of ``data=folder``, without ``data.``."""

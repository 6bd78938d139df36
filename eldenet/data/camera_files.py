"""Cameras as recorders store them beside their frames: intrinsics, the size they describe, and the pose."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eldenet.geometry import check_intrinsics, intrinsic_matrix, resize_intrinsics, same_aspect
from eldenet.system.errors import reading, warn_once
from eldenet.system.files import parse_json, read_text

CAMERA_ENDINGS = (".json", ".txt", ".csv", ".yaml", ".yml", ".pincam")
CENTRAL = 0.1  # how far from the middle a principal point may lie that tells the size, as a share of the side
_MATRICES = ("intrinsic_matrix", "intrinsics", "camera_matrix", "K", "cam_K")
_NUMBERS = (("fx", "fl_x"), ("fy", "fl_y"), ("cx",), ("cy",))
_BENT = ("distortion_coefficients", "distortion", "D")  # of ROS and OpenCV; others name each one
_BENDS = ("k1", "k2", "p1", "p2", "k3", "k4")  # in OpenCV's order
_STRAIGHT = 0.02  # coefficients up to this move a corner by less than a hundredth of the picture
_SIDES = (("height", "h", "image_height"), ("width", "w", "image_width"))


class Camera(NamedTuple):
    """A frame's camera as it is stored."""

    matrix: np.ndarray  # intrinsics (3, 3) [px]
    size: tuple[int, int] | None = None  # (height, width) [px] that they describe; None: not stated
    # camera to world (4, 4) [m], camera axes x right, y down, z forward; None: not stated
    pose: np.ndarray | None = None

    def at_size(self, size: tuple[int, int], depth_size: tuple[int, int]) -> np.ndarray:
        """Return the intrinsics ``(3, 3)`` of a picture of ``size`` with a depth map of ``depth_size`` [px].

        Where no size is stated, the principal point says which of the two the intrinsics describe.

        Raises:
            ValueError: they may describe both or neither, have another aspect, or are those of no camera.
        """
        described = self.size or self._described(size, depth_size)
        if not same_aspect(described, size):
            raise ValueError(
                f"the intrinsics describe pictures of {_text(described)}, this one is {_text(size)} (width x "
                "height): give the intrinsics of these pictures"
            )
        matrix = self.matrix if described == size else resize_intrinsics(self.matrix, described, size)
        check_intrinsics(matrix, size)
        return matrix

    def _described(self, size: tuple[int, int], depth_size: tuple[int, int]) -> tuple[int, int]:
        if size == depth_size:
            return size
        point = self.matrix[[1, 0], 2] + 0.5
        central = [s for s in (size, depth_size) if (np.abs(point / s - 0.5) <= CENTRAL).all()]
        if len(central) == 1:
            return central[0]
        kind = "both" if central else "neither"
        raise ValueError(
            f"the principal point ({point[1] - 0.5:g}, {point[0] - 0.5:g}) may be that of {kind} of the "
            f"picture ({_text(size)}) and the depth map ({_text(depth_size)}): say which size the intrinsics "
            "describe, data.intrinsics={fx: ..., fy: ..., cx: ..., cy: ..., width: ..., height: ...}"
        )


def _text(size: tuple[int, int]) -> str:
    return f"{size[1]}x{size[0]}"


def read_camera(path: Path) -> Camera:
    """Read one camera: JSON, a calibration of ROS or OpenCV (YAML), or a text file of numbers.

    Numbers are a matrix (3 x 3, 4 x 4, separated by spaces or commas), ``fx fy cx cy``, or ARKitScenes's
    ``width height fx fy cx cy``.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged, or holds no camera.
    """
    text = read_text(path, "give a file with the camera's intrinsics")
    ending = path.suffix.lower()
    if ending == ".json":
        return camera_of(parse_json(text, path), path)
    if ending in (".yaml", ".yml"):
        import yaml

        # OpenCV's FileStorage begins with a directive that YAML lacks, and has types of its own
        plain = re.sub(r"^%YAML:1\.0|!!opencv-(nd-)?matrix", "", text)
        with reading(path, "YAML file"):
            record = yaml.safe_load(plain)
        return camera_of(record, path)
    with reading(path, "list of numbers"):
        numbers = [float(word) for word in text.replace(",", " ").split()]
    if len(numbers) == 6:
        return Camera(intrinsic_matrix(numbers[2:]), (int(numbers[1]), int(numbers[0])))
    return Camera(_matrix(numbers, path))


def camera_of(record: Any, source: object) -> Camera:
    """Return the camera that a JSON record states, as ARKit's apps, Nerfstudio and Open3D write it.

    Convention: their poses have the axes of OpenGL and ARKit (x right, y up, z back), which are turned here.
    Distortion is not undone: a line says so.

    Raises:
        ValueError: it states none, or no numbers, or that of a fisheye lens; names ``source``.
    """
    record = record if isinstance(record, Mapping) else {}
    if "FISHEYE" in str(record.get("camera_model", "")):
        raise ValueError(
            f"{source} describes a fisheye lens ({record['camera_model']}), intrinsics describe a pinhole: "
            "undistort the pictures first"
        )
    stored: Any = _first(record, _MATRICES)
    sized = record
    if isinstance(stored, Mapping):
        sized = {**record, **stored}  # a table of its own states its size, too
        stored = stored.get("data", [_first(stored, names) for names in _NUMBERS])
    if stored is None:
        stored = [_first(record, names) for names in _NUMBERS]
    sides = [_first(sized, names) for names in _SIDES]
    with reading(source, "camera with width and height"):
        size = None if None in sides else (int(sides[0]), int(sides[1]))
    if bends := _distortion(sized):
        warn_once(
            f"the camera's calibration states distortion ({bends}), which is not undone: give rectified "
            "pictures and their intrinsics (ROS: projection_matrix)"
        )
    return Camera(_matrix(stored, source), size, _pose(record, source))


def _first(record: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((record[name] for name in names if name in record), None)


def _distortion(record: Mapping[str, Any]) -> str:
    """What a calibration says of a lens that bends straight lines, in words; empty where it does not."""
    stored: Any = _first(record, _BENT)
    if isinstance(stored, Mapping):
        stored = stored.get("data")
    found = dict(zip(_BENDS, stored, strict=False)) if isinstance(stored, list) else record
    bends = {name: found[name] for name in _BENDS if isinstance(found.get(name), int | float)}
    return ", ".join(f"{name}={value:g}" for name, value in bends.items() if abs(value) > _STRAIGHT)


def _matrix(stored: Any, source: object) -> np.ndarray:
    """The matrix of 4, 9 or 16 numbers; nine are rows (as written) or columns (ARKit, Open3D)."""
    try:
        values = np.asarray(stored, np.float64)
        if values.size == 16:
            values = values.reshape(4, 4)[:3, :3]
        if values.size == 9:
            values = values.reshape(3, 3)
            if not values[:2, 2].any():  # the principal point stands in the last row
                values = values.T
            if values[2].tolist() != [0, 0, 1]:  # such as that of a pose
                raise ValueError
        return intrinsic_matrix(values)
    except (TypeError, ValueError):
        raise ValueError(
            f"{source} states no intrinsics: fx, fy, cx, cy [px] or a matrix (K, intrinsics, "
            "intrinsic_matrix) are expected"
        ) from None


def _pose(record: Mapping[str, Any], source: object) -> np.ndarray | None:
    stored: Any = _first(record, ("transform_matrix", "cameraPoseARFrame"))
    if stored is None and "t_00" in record:  # Polycam
        stored = [[record[f"t_{row}{column}"] for column in range(4)] for row in range(3)] + [[0, 0, 0, 1]]
    if stored is None:
        return None
    with reading(source, "pose of 16 numbers"):
        pose = np.asarray(stored, np.float64).reshape(4, 4)
    return pose * [1.0, -1.0, -1.0, 1.0]  # the camera's y and z axes are columns


def given_camera(intrinsics: Any) -> Camera:
    """Return the camera that a setting states: ``[fx, fy, cx, cy]``, ``(3, 3)``, or a table with the size.

    Raises:
        ValueError: it states none.
    """
    if isinstance(intrinsics, Mapping):
        return camera_of(intrinsics, f"intrinsics={dict(intrinsics)}")
    return Camera(intrinsic_matrix(intrinsics))

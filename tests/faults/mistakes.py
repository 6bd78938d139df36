"""Numbers in another unit, and files as the world has them: each is refused, warned of, or read rightly.

A further one is a function below with ``@mistake``: it draws one case and returns what a user does, and the
right result; ``REFUSED`` where a line must come instead.
"""

import functools
import sys
import unicodedata
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from PIL import Image
from support.rooms_network import trained

from eldenet.geometry import PinholeCamera, intrinsic_matrix, pinhole

from .campaign import CLEAR, Outcome, digest_of, in_processes, judge

ROS_PACKAGE = str(Path(__file__).parents[2] / "ros2/eldenet_ros")
REFUSED = object()
Case = tuple[Callable[[], Any], Any]
Draw = Callable[[Path, np.random.Generator], Case]
MISTAKES: dict[str, Draw] = {}
SIZES = ((480, 640), (720, 1280), (375, 1242), (1920, 1080))


def mistake(draw: Draw) -> Draw:
    """Put a function that draws a case into ``MISTAKES`` under its name."""
    MISTAKES[draw.__name__.replace("_", " ")] = draw
    return draw


def try_all(folder: Path, count: int) -> dict[str, list[Outcome]]:
    """Outcomes of ``count`` drawn cases of each mistake."""

    def one(name: str, number: int) -> Outcome:
        place = folder / f"{name} {number}"
        place.mkdir(parents=True)
        use, right = MISTAKES[name](place, np.random.default_rng([zlib.crc32(name.encode()), number]))
        found = judge(use, ("",), "" if right is REFUSED else digest_of(right))
        in_one_line = found.what != CLEAR or "\n" not in found.said
        return found if in_one_line else Outcome("raw", found.said)

    return {name: in_processes([partial(one, name, n) for n in range(count)]) for name in MISTAKES}


# --- lenses ---------------------------------------------------------------------------------------------


@functools.cache
def _predictor() -> Any:
    from eldenet.deploy.predictor import DepthPredictor

    return DepthPredictor(trained(), steady=False)


def _predict(intrinsics: Any, size: tuple[int, int]) -> Any:
    return _predictor()(np.zeros((*size, 3), np.uint8), intrinsics=intrinsics)


def _drive(intrinsics: Any, size: tuple[int, int]) -> Any:
    from eldenet.navigation.ranges import depth_to_ranges

    return depth_to_ranges(np.full(size, 2.0), intrinsics)


def _lift(intrinsics: Any, size: tuple[int, int]) -> Any:
    from eldenet.boxes import Detections2D
    from eldenet.perception.lifter import BoxLifter

    found = Detections2D(np.array([[20.0, 20.0, 60.0, 60.0]]), np.ones(1), np.zeros(1, np.int64), ("car",))
    camera = PinholeCamera(intrinsic_matrix(intrinsics))
    return BoxLifter("paper")(np.full(size, 9.0), found, camera)


def _ros(intrinsics: Any, size: tuple[int, int]) -> Any:
    if ROS_PACKAGE not in sys.path:
        sys.path.insert(0, ROS_PACKAGE)
    from eldenet.data.ros_messages import read_intrinsics

    matrix = intrinsic_matrix(intrinsics, check=False)
    return read_intrinsics(SimpleNamespace(k=matrix.ravel(), height=size[0], width=size[1]), size)


def _data(folder: Path, intrinsics: Any, size: tuple[int, int]) -> Any:
    from eldenet.data.folder import FolderDataset

    for part, picture in (
        ("images", np.zeros((*size, 3), np.uint8)),
        ("depths", np.full(size, 2000, np.uint16)),
    ):
        (folder / part).mkdir()
        cv2.imwrite(str(folder / part / "a.png"), picture)
    return FolderDataset(folder, intrinsics=np.asarray(intrinsics).tolist(), max_depth=10.0)[0]


def _in_another_unit(change: Callable[[np.ndarray, tuple[int, int], np.random.Generator], Any]) -> Draw:
    def draw(folder: Path, rng: np.random.Generator) -> Case:
        height, width = SIZES[rng.integers(len(SIZES))]
        focal = width / 2 / np.tan(np.radians(rng.uniform(60, 100)) / 2)
        center = (np.array([width, height]) - 1) / 2 * rng.uniform(0.95, 1.05, 2)
        given = change(pinhole(focal, focal * rng.uniform(0.98, 1.02), *center), (height, width), rng)
        entries = (_predict, _drive, _lift, _ros, partial(_data, folder))
        entry = entries[rng.integers(len(entries))]
        return lambda: entry(given, (height, width)), REFUSED

    return draw


def _with_focal(matrix: np.ndarray, focal: float) -> np.ndarray:
    return pinhole(focal, focal, *matrix[:2, 2])


def _times(*factors: float) -> np.ndarray:
    return np.diag([*factors, 1.0])


CHANGES: dict[str, Callable[[np.ndarray, tuple[int, int], np.random.Generator], Any]] = {
    "fx in mm": lambda matrix, size, rng: _with_focal(matrix, rng.uniform(2, 60)),
    "fx in micrometers": lambda matrix, size, rng: _with_focal(matrix, 1000 * rng.uniform(20, 60)),
    "fx of 1e300": lambda matrix, size, rng: _with_focal(matrix, 1e300),
    "all in mm of the sensor": lambda matrix, size, rng: _times(6 / size[1], 6 / size[1]) @ matrix,
    "divided by the width": lambda matrix, size, rng: _times(1 / size[1], 1 / size[1]) @ matrix,
    "divided by both sides": lambda matrix, size, rng: _times(1 / size[1], 1 / size[0]) @ matrix,
    "the whole matrix divided": lambda matrix, size, rng: matrix / size[1],
    "transposed": lambda matrix, size, rng: matrix.T,
    "the identity": lambda matrix, size, rng: np.eye(3),
    "a skew": lambda matrix, size, rng: matrix + np.diag([rng.uniform(20, 90), 0], 1),
    "of half the size": lambda matrix, size, rng: _times(0.5, 0.5) @ matrix,
    "of a quarter of the size": lambda matrix, size, rng: _times(0.25, 0.25) @ matrix,
    "of twice the size": lambda matrix, size, rng: _times(2, 2) @ matrix,
}
MISTAKES |= {f"intrinsics: {name}": _in_another_unit(change) for name, change in CHANGES.items()}


@mistake
def a_field_of_view_in_radians(folder: Path, rng: np.random.Generator) -> Case:
    fov = float(np.radians(rng.uniform(10, 150)))
    return lambda: _predictor()(np.zeros((48, 64, 3), np.uint8), fov=fov), REFUSED


@mistake
def an_exif_of_no_lens(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.deploy.lens import exif_focal

    exif = Image.Exif()
    exif[0x8769] = {0xA405: int(rng.integers(1000, 60000))}
    Image.new("RGB", (64, 48)).save(folder / "a.jpg", exif=exif)
    return lambda: exif_focal(folder / "a.jpg", (48, 64)), REFUSED


# --- other numbers --------------------------------------------------------------------------------------


@mistake
def a_camera_height_in_centimeters(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.navigation.ranges import depth_to_ranges
    from eldenet.perception.lifter import BoxLifter

    height = rng.uniform(21, 250)
    if rng.random() < 0.5:
        return lambda: BoxLifter(camera_height=height), REFUSED
    return lambda: depth_to_ranges(
        np.full((48, 64), 2.0), (40, 40, 31.5, 23.5), camera_height=height
    ), REFUSED


@mistake
def a_bearing_in_degrees(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.navigation.on_robot import check_bearing

    bearing = rng.uniform(8, 180) * rng.choice([-1, 1])
    return lambda: check_bearing(bearing, rng.uniform(-1.5, 1.5)), REFUSED


@mistake
def a_latency_in_milliseconds(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.navigation.latency import check_latency

    return lambda: check_latency(rng.uniform(5, 900)), REFUSED


@mistake
def float_depth_in_millimeters(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.data.io import read_depth
    from eldenet.navigation.ranges import depth_to_ranges

    depth = rng.uniform(300, 9000, (48, 64)).astype(np.float32)
    np.save(folder / "a.npy", depth)
    if rng.random() < 0.5:
        return lambda: read_depth(folder / "a.npy", "meters"), REFUSED
    return lambda: depth_to_ranges(depth, (40, 40, 31.5, 23.5)), REFUSED


# --- files ----------------------------------------------------------------------------------------------


def _pixels(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(0, 255, (12, 16, 3), dtype=np.uint8)


@mistake
def a_turned_tiff(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.data.io import read_image, read_raw_depth

    pixels, tags = _pixels(rng), {0x112: int(rng.integers(1, 9))}
    if rng.random() < 0.5:
        pixels = pixels[..., 0].astype(np.uint16)
    Image.fromarray(pixels).save(folder / "a.tif", tiffinfo=tags)
    read = read_image if pixels.ndim == 3 else read_raw_depth
    return lambda: read(folder / "a.tif"), pixels


@mistake
def a_scan_of_other_columns(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.data.kitti_calibration import read_scan

    points = rng.uniform((3, -9, -2, 0, 0, 0), (60, 9, 1, 1, 255, 64), (120, 6)).astype(np.float32)
    points[:, : rng.choice([3, 5, 6])].tofile(folder / "a.bin")
    return lambda: read_scan(folder / "a.bin"), REFUSED


@mistake
def a_video_behind_a_photo(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.data.io import read_image

    cv2.imwrite(str(folder / "a.jpg"), cv2.resize(_pixels(rng), (800, 600)))
    alone = read_image(folder / "a.jpg")
    tail = rng.bytes(5000) + b"\xff\xda" * 30_000
    (folder / "a.jpg").write_bytes((folder / "a.jpg").read_bytes() + tail)
    return lambda: read_image(folder / "a.jpg"), alone


@mistake
def a_ppm_of_a_low_peak(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.data.io import read_image

    peak = int(rng.integers(1, 255))
    numbers = rng.integers(0, peak + 1, (4, 5, 3), dtype=np.uint8)
    (folder / "a.ppm").write_bytes(b"P6\n5 4\n%d\n" % peak + numbers.tobytes())
    return lambda: read_image(folder / "a.ppm"), np.floor(numbers * 255.0 / peak + 0.5).astype(np.uint8)


@mistake
def pictures_of_other_formats(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.data.paths import OTHER_PICTURES, visible_files

    (folder / f"a{rng.choice(OTHER_PICTURES)}").touch()
    return lambda: visible_files(folder, (".jpg",)), REFUSED


@mistake
def names_in_two_forms_of_unicode(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.data.folder import FolderDataset

    name = "".join(rng.choice(list("éüñçåö"), 4))
    forms = rng.permutation(["NFC", "NFD"])
    for part, form in zip(("images", "depths"), forms, strict=True):
        (folder / part).mkdir()
        picture = _pixels(rng) if part == "images" else np.full((12, 16), 2000, np.uint16)
        cv2.imwrite(str(folder / part / f"{unicodedata.normalize(form, name)}.png"), picture)
    return lambda: FolderDataset(folder, max_depth=10.0).names, [unicodedata.normalize("NFC", name)]


@mistake
def a_picture_that_shows_nothing(folder: Path, rng: np.random.Generator) -> Case:
    sides = int(rng.integers(1, 8)), int(rng.integers(1, 640))
    return lambda: _predictor()(np.zeros((*sides, 3), np.uint8)), REFUSED


@mistake
def a_projection_of_zeros(folder: Path, rng: np.random.Generator) -> Case:
    from eldenet.data.kitti_calibration import projection_camera

    numbers = np.zeros(12) if rng.random() < 0.5 else np.outer([1, 2, 3], rng.uniform(1, 9, 4)).ravel()
    (folder / "000001.txt").write_text("P2: " + " ".join(map(str, numbers)) + "\n")
    return lambda: projection_camera(folder / "000001.txt", "P2"), REFUSED

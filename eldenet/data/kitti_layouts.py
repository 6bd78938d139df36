"""Where KITTI's files lie: every layout that people have on disk, as a list of frames."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from eldenet.data.array_files import read_text

PICTURES = (".png", ".jpg", ".jpeg")
DEPTH_KINDS = ("groundtruth", "velodyne_raw")
_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_\d{4}_sync")

DEPTH_TREE = """
train/<drive>/proj_depth/{groundtruth,velodyne_raw}/image_0{2,3}/0000000005.png
val/<drive>/...       (also below data_depth_annotated and data_depth_velodyne, or without train and val)
data_rgb/{train,val}/<drive>/image_0{2,3}/data/0000000005.png    (Ma and Karaman; or KITTI raw: data.raw_root)
"""
RAW_TREE = """
<date>/<drive>/image_0{2,3}/data/0000000000.png or .jpg      (such as 2011_09_26/2011_09_26_drive_0001_sync)
<date>/<drive>/velodyne_points/data/0000000000.bin
<date>/calib_cam_to_cam.txt, calib_velo_to_cam.txt
"""
SELECTION_TREE = """
val_selection_cropped/image/<drive>_image_0000000005_image_02.png  (as 2011_09_26_drive_0002_sync_image_...)
val_selection_cropped/groundtruth_depth/<drive>_groundtruth_depth_0000000005_image_02.png
val_selection_cropped/{velodyne_raw,intrinsics}/...
"""


class Place(NamedTuple):
    """What names a frame: drive, camera (2 left, 3 right), number in the recording."""

    drive: str
    camera: int
    number: str

    @property
    def date(self) -> str:
        """The day of the recording: its calibration and its frames' size."""
        return self.drive[:10]

    @property
    def name(self) -> str:
        """Name of the frame in reports: the same in every layout."""
        return f"{self.drive}/image_{self.camera:02d}/{self.number}"


class Line(NamedTuple):
    """A line of a list of frames.

    Attributes:
        place: of the picture.
        has_truth: False where the list says ``None`` for the improved ground truth.
    """

    place: Place
    has_truth: bool


def is_drive(name: str) -> bool:
    """Whether ``name`` is a drive's folder, such as ``2011_09_26_drive_0001_sync``."""
    return _DRIVE.fullmatch(name) is not None


def drive_of(name: str) -> str:
    """The drive of a frame's name: frames of one drive must not be on two sides of a split."""
    return name.partition("/")[0]


def listed(folder: Path) -> frozenset[str]:
    """Names in ``folder``; empty where there is no such folder."""
    return frozenset(os.listdir(folder)) if folder.is_dir() else frozenset()


class Listing(dict[Path, frozenset[str]]):
    """Names in folders, each folder read once: tens of thousands of frames take a moment."""

    def __missing__(self, folder: Path) -> frozenset[str]:
        self[folder] = listed(folder)
        return self[folder]


def depth_maps(root: Path, kind: str, parts: Sequence[str], cameras: Sequence[int]) -> dict[Place, Path]:
    """Depth maps of the devkit below ``root``, however its zip files were unpacked.

    Args:
        root: with or without ``data_depth_annotated`` or ``data_depth_velodyne``.
        kind: "groundtruth" or "velodyne_raw".
        parts: "train" and "val", or "" for drives that lie there without either.
        cameras: 2 and 3.

    Raises:
        ValueError: one map lies in two places.
    """
    archive = "data_depth_annotated" if kind == "groundtruth" else "data_depth_velodyne"
    found: dict[Place, Path] = {}
    for folder in (root / base / part for base in ("", archive) for part in parts):
        for drive in sorted(filter(is_drive, listed(folder))):
            for camera in cameras:
                maps = folder / drive / "proj_depth" / kind / f"image_{camera:02d}"
                for file in sorted(name for name in listed(maps) if name.endswith(".png")):
                    place = Place(drive, camera, file[:-4])
                    if place in found:
                        raise ValueError(
                            f"{found[place]} and {maps / file} are the same frame: unpack it once only"
                        )
                    found[place] = maps / file
    return found


def picture_of(place: Place, roots: Sequence[Path], names: Listing) -> Path | None:
    """The color picture of a frame: KITTI raw's layout, Ma and Karaman's, or drives side by side."""
    drive, camera = place.drive, f"image_{place.camera:02d}"
    for root in roots:
        for above in (place.date, "data_rgb/train", "data_rgb/val", "train", "val", ""):
            folder = root / above / drive / camera / "data"
            for ending in PICTURES:
                if f"{place.number}{ending}" in names[folder]:
                    return folder / f"{place.number}{ending}"
    return None


def scans(root: Path, cameras: Sequence[int]) -> dict[Place, Path]:
    """LiDAR scans of KITTI raw, once for each camera."""
    found = {}
    for date in sorted(listed(root)):
        for drive in sorted(filter(is_drive, listed(root / date))):
            folder = root / date / drive / "velodyne_points" / "data"
            for file in sorted(name for name in listed(folder) if name.endswith(".bin")):
                for camera in cameras:
                    found[Place(drive, camera, file[:-4])] = folder / file
    return found


def selection(root: Path, kind: str) -> tuple[dict[Place, Path], dict[Place, Path]]:
    """Pictures and depth maps of ``val_selection_cropped``.

    Raises:
        ValueError: a file's name says no frame.
    """
    word = "groundtruth_depth" if kind == "groundtruth" else kind
    return _selected(root / "image", "image"), _selected(root / word, word)


def _selected(folder: Path, word: str) -> dict[Place, Path]:
    pattern = re.compile(rf"(?P<drive>.+_sync)_{word}_(?P<number>\d+)_image_(?P<camera>0[23])\.png")
    found = {}
    for file in sorted(listed(folder)):
        match = pattern.fullmatch(file)
        if match is None or not is_drive(match["drive"]):
            raise ValueError(
                f"{folder / file} is no name of the selection, such as 2011_09_26_drive_0002_sync_{word}_"
                "0000000005_image_02.png: take it out of the folder"
            )
        found[Place(match["drive"], int(match["camera"]), match["number"])] = folder / file
    return found


def frame_list(file: str | Path) -> list[Line]:
    """Frames of a list that the user has: BTS's, or monodepth2's.

    BTS: ``<date>/<drive>/image_02/data/0000000069.png <depth or None> [focal]``, ``/`` in front or not. Its
    focal length is not used: the calibration knows it better. monodepth2: ``<date>/<drive> 69 l`` (or ``r``).

    Raises:
        FileNotFoundError: there is no such list.
        ValueError: naming a line that is neither, or a frame that is there twice.
    """
    path = Path(file).expanduser()
    lines = []
    content = read_text(path, "name the list of frames (BTS's or monodepth2's)")
    for number, text in enumerate(content.splitlines(), 1):
        if text.strip():
            lines.append(_line(text.split(), f"{path}, line {number}: {text[:200]!r}"))
    if not lines:
        raise ValueError(f"{path} is empty: fetch the list again")
    place, times = Counter(line.place for line in lines).most_common(1)[0]
    if times > 1:
        raise ValueError(f"{path} names {place.name} {times} times: every frame counts once")
    return lines


def _line(cells: Sequence[str], where: str) -> Line:
    pieces = cells[0].strip("/").split("/")
    drive = next((piece for piece in pieces if is_drive(piece)), None)
    if drive is not None and len(cells) == 3 and cells[2] in ("l", "r") and cells[1].isdecimal():
        return Line(Place(drive, 2 if cells[2] == "l" else 3, f"{int(cells[1]):010d}"), True)
    camera = re.search(r"image_0([23])", cells[0])
    stem = Path(pieces[-1]).stem
    if drive is None or camera is None or not stem.isdecimal() or len(cells) not in (1, 2, 3):
        raise ValueError(
            f"{where} is neither '<date>/<drive>/image_02/data/<number>.png <depth or None> <focal>' nor "
            "'<date>/<drive> <number> l'"
        )
    return Line(Place(drive, int(camera[1]), stem), len(cells) == 1 or cells[1] != "None")

"""KITTI's frames: where their files lie in every layout in use, and what the layouts share."""

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, Unpack

import numpy as np

from eldenet.data.base import FileDataset, SampleOptions, check_pair
from eldenet.data.io import read_depth, read_image
from eldenet.data.kitti_calibration import CAM_TO_CAM, rectified_intrinsics
from eldenet.data.paths import names_in
from eldenet.system.checks import one_of
from eldenet.system.errors import some_of
from eldenet.system.files import read_text
from eldenet.types import Frame

PICTURES = (".png", ".jpg", ".jpeg")
DEPTH_KINDS = ("groundtruth", "velodyne_raw")
_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_\d{4}_sync")

#: Frames whose names come with the package: a setting may name a list instead of a file.
LISTS = {
    file.name.removesuffix(".txt.xz"): file
    for file in sorted((Path(__file__).parent / "kitti_lists").glob("*.txt.xz"))
}

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
    """A frame: drive, camera (2 left, 3 right) and number in the recording."""

    drive: str
    camera: int
    number: str

    @property
    def date(self) -> str:
        """The day of the recording, which decides calibration and size."""
        return self.drive[:10]

    @property
    def name(self) -> str:
        """Name of the frame in reports, the same in every layout."""
        return f"{self.drive}/image_{self.camera:02d}/{self.number}"


def is_drive(name: str) -> bool:
    """Whether ``name`` is a drive's folder, such as ``2011_09_26_drive_0001_sync``."""
    return _DRIVE.fullmatch(name) is not None


def depth_maps(root: Path, kind: str, parts: Sequence[str], cameras: Sequence[int]) -> dict[Place, Path]:
    """Find the devkit's depth maps below ``root``, however its zip files were unpacked.

    ``kind`` is "groundtruth" or "velodyne_raw"; ``parts`` are "train" and "val", or "" for drives that are in
    neither.

    Raises:
        ValueError: a map is in two places.
    """
    archive = "data_depth_annotated" if kind == "groundtruth" else "data_depth_velodyne"
    found: dict[Place, Path] = {}
    for folder in (root / base / part for base in ("", archive) for part in parts):
        for drive in sorted(filter(is_drive, names_in(folder))):
            for camera in cameras:
                maps = folder / drive / "proj_depth" / kind / f"image_{camera:02d}"
                for file in sorted(name for name in names_in(maps) if name.endswith(".png")):
                    place = Place(drive, camera, file[:-4])
                    if place in found:
                        raise ValueError(
                            f"{found[place]} and {maps / file} are the same frame: remove one of them"
                        )
                    found[place] = maps / file
    return found


def pictures_of(places: Sequence[Place], roots: Sequence[Path]) -> dict[Place, Path]:
    """Find the frames' color pictures in KITTI raw's layout, Ma and Karaman's, or drives side by side."""
    names = cache(names_in)  # each folder is read once, so tens of thousands of frames take a moment
    found = ((place, _picture_of(place, roots, names)) for place in places)
    return {place: picture for place, picture in found if picture is not None}


def _picture_of(place: Place, roots: Sequence[Path], names: Callable[[Path], frozenset[str]]) -> Path | None:
    drive, camera = place.drive, f"image_{place.camera:02d}"
    for root in roots:
        for above in (place.date, "data_rgb/train", "data_rgb/val", "train", "val", ""):
            folder = root / above / drive / camera / "data"
            for ending in PICTURES:
                if f"{place.number}{ending}" in names(folder):
                    return folder / f"{place.number}{ending}"
    return None


def scans(root: Path, cameras: Sequence[int]) -> dict[Place, Path]:
    """Find the LiDAR scans of KITTI raw, once for each camera."""
    found = {}
    for date in sorted(names_in(root)):
        for drive in sorted(filter(is_drive, names_in(root / date))):
            folder = root / date / drive / "velodyne_points" / "data"
            for file in sorted(name for name in names_in(folder) if name.endswith(".bin")):
                for camera in cameras:
                    found[Place(drive, camera, file[:-4])] = folder / file
    return found


def selected(folder: Path, word: str) -> dict[Place, Path]:
    """Find the files of one kind in ``val_selection_cropped``; ``word`` is part of their names.

    Raises:
        ValueError: a file's name is not of the selection.
    """
    pattern = re.compile(rf"(?P<drive>.+_sync)_{word}_(?P<number>\d+)_image_(?P<camera>0[23])\.png")
    found = {}
    for file in sorted(names_in(folder)):
        match = pattern.fullmatch(file)
        if match is None or not is_drive(match["drive"]):
            raise ValueError(
                f"{folder / file} is not named as in the selection (2011_09_26_drive_0002_sync_{word}_"
                "0000000005_image_02.png): remove it from the folder"
            )
        found[Place(match["drive"], int(match["camera"]), match["number"])] = folder / file
    return found


def frame_list(file: str | Path) -> dict[Place, bool]:
    """Read a list of frames in BTS's or monodepth2's format: place -> whether it has improved ground truth.

    ``file`` may be one of :data:`LISTS`: ``eigen_697``, ``eigen_652`` or ``zhou``.

    BTS: ``<date>/<drive>/image_02/data/0000000069.png <depth or None> [focal]``, with or without ``/`` in
    front. Its focal length is not used: the calibration is more exact. monodepth2: ``<date>/<drive> 69 l``
    (or ``r``).

    Raises:
        FileNotFoundError: there is no such list.
        ValueError: a line is in neither format, or a frame is listed twice.
    """
    path = LISTS.get(str(file)) or Path(file).expanduser()
    places: dict[Place, bool] = {}
    content = read_text(path, f"give {', '.join(LISTS)}, or a list in BTS's or monodepth2's format")
    for number, text in enumerate(content.splitlines(), 1):
        if text.strip():
            where = f"{path}, line {number}: {text[:200]!r}"
            place, has_truth = _line(text.split(), where)
            if place in places:
                raise ValueError(f"{where} lists {place.name} again: remove all but one")
            places[place] = has_truth
    if not places:
        raise ValueError(f"{path} is empty: fetch the list again")
    return places


def _line(cells: Sequence[str], where: str) -> tuple[Place, bool]:
    pieces = cells[0].strip("/").split("/")
    drive = next((piece for piece in pieces if is_drive(piece)), None)
    if drive is not None and len(cells) == 3 and cells[2] in ("l", "r") and cells[1].isdecimal():
        return Place(drive, 2 if cells[2] == "l" else 3, f"{int(cells[1]):010d}"), True
    camera = re.search(r"image_0([23])", cells[0])
    stem = Path(pieces[-1]).stem
    if drive is None or camera is None or not stem.isdecimal() or len(cells) not in (1, 2, 3):
        raise ValueError(
            f"{where} is neither '<date>/<drive>/image_02/data/<number>.png <depth or None> <focal>' nor "
            "'<date>/<drive> <number> l'"
        )
    return Place(drive, int(camera[1]), stem), len(cells) == 1 or cells[1] != "None"


def refuse_missing_drives(
    root: Path, places: Sequence[Place], pictures: Mapping[Place, Path], sources: Mapping[Place, Path]
) -> None:
    """Raise FileNotFoundError if whole drives are missing; up to ten files are named one by one later."""
    whole = [place for place in places if place in pictures and place in sources]
    drives, found = {place.drive for place in places}, {place.drive for place in whole}
    missing = sorted(drives - found)
    if not missing or len(places) - len(whole) <= 10:
        return
    raise FileNotFoundError(
        f"{root} lacks pictures or depth of {len(missing)} of {len(drives)} drives ({some_of(missing)}): "
        f"{len(whole)} of {len(places)} frames are left. Fetch these drives, or take the frames that are "
        "left (data.on_error=skip)"
    )


class KITTIFrames(FileDataset):
    """Frames of a picture and a file of sparse depth each: a map, or a LiDAR scan.

    Args:
        root: of the data set, for messages.
        pictures: files of the frames' pictures, without missing ones.
        sources: files of the frames' depth, without missing ones.
        places: the frames, in order.
        cameras: file of each frame's intrinsics, if it has its own.
        without_depth: frames of a list that have no depth, for messages.
        frames: how many frames there must be; None for any number.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 80 m unless given.
    """

    frame_lists = ("names", "files", "places")
    depth_range = (1e-3, 80.0)

    def __init__(
        self,
        root: Path,
        pictures: Mapping[Place, Path],
        sources: Mapping[Place, Path],
        places: Sequence[Place],
        *,
        cameras: Mapping[Place, Path] = MappingProxyType({}),
        without_depth: Sequence[Place] = (),
        frames: int | None = None,
        **options: Unpack[SampleOptions],
    ) -> None:
        if without_depth:
            logging.getLogger("eldenet").info(
                "%s: %d frames, such as %s, have no depth (None in the list): %d frames remain",
                type(self).__name__,
                len(without_depth),
                without_depth[0].name,
                len(places),
            )
        if frames is not None and places and len(places) != frames:
            raise ValueError(
                f"{len(places)} frames instead of {frames} ({len(without_depth)} without depth in the list): "
                "check the list and that the data set is complete; for your own list, set data.frames=null"
            )
        if options.get("on_error") != "skip":
            refuse_missing_drives(root, places, pictures, sources)
        self.places = list(places)
        self.intrinsics: dict[tuple[str, int], np.ndarray] = {}
        # whole paths; a missing file gets a name that is nowhere below the root, so it counts as missing
        files = [
            (
                str(pictures.get(place) or f"{place.name} (no picture)"),
                str(sources.get(place) or f"{place.name} (no depth)"),
                *([str(cameras[place])] if place in cameras else []),
            )
            for place in places
        ]
        super().__init__(root, [place.name for place in places], files, **options)

    def size_group(self, index: int) -> str:
        """Return the date: KITTI's frames are rectified, and cropped, per date."""
        return self.places[index].date

    def frame_settings(self) -> dict[str, object]:
        """Return the calibration, which is read at the start."""
        return {f"{date} {camera}": matrix.tolist() for (date, camera), matrix in self.intrinsics.items()}

    def load_frame(self, index: int) -> Frame:
        """Read one picture and its sparse depth."""
        picture, source, *_ = self.frame_files(index)
        image = read_image(picture, gray=False)
        depth = self.read_sparse(index, (image.shape[0], image.shape[1]))
        check_pair(image.shape, picture, depth.shape, source)
        return Frame(image, depth, self.camera_of(index), self.names[index])

    def camera_of(self, index: int) -> np.ndarray | None:
        """Return the intrinsics ``(3, 3)`` of a frame on disk [px], None if unknown."""
        place = self.places[index]
        return self.intrinsics.get((place.date, place.camera))

    def read_sparse(self, index: int, size: tuple[int, int]) -> np.ndarray:
        """Return the depth ``(H, W)`` [m] of a frame whose picture has ``size`` [px]."""
        return read_depth(self.root / self.files[index][1], "kitti")

    def calibrate(self, folders: Sequence[Path], calibration: str) -> dict[tuple[str, int], Path]:
        """Read the intrinsics of every date and camera; return the folder of the calibration files of each.

        ``calibration`` is "required", or "optional" to leave out dates that have none in ``folders``.

        Raises:
            FileNotFoundError: a required file is missing.
            ValueError: a file is damaged, or ``calibration`` is unknown.
        """
        one_of("calibration", calibration, ("required", "optional"))
        found = {}
        for date, camera in sorted({(place.date, place.camera) for place in self.places}):
            candidates = [folder / date for folder in folders]
            folder = next((f for f in candidates if (f / CAM_TO_CAM).is_file()), None)
            if folder is not None:
                self.intrinsics[date, camera] = rectified_intrinsics(folder, camera)
                found[date, camera] = folder
            elif calibration == "required":
                raise FileNotFoundError(
                    f"{CAM_TO_CAM} of {date} is in none of {', '.join(map(str, candidates))}: fetch KITTI's "
                    "calibration zip of that date, or do without intrinsics (data.calibration=optional)"
                )
        return found

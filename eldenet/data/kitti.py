"""KITTI in the layouts in use: the depth devkit, KITTI raw with its LiDAR scans, the cropped selection.

Geiger et al., IJRR 2013 (raw); Uhrig et al., "Sparsity Invariant CNNs", 3DV 2017 (the devkit's ground truth).
Depth consists of sparse points, which nothing here interpolates. Frames differ in size by date, so a
protocol's crop is a fraction of the frame's size.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

import numpy as np

from eldenet.data.base import SampleOptions
from eldenet.data.kitti_calibration import PROJECTIONS, project_scan, read_scan, velodyne_to_image
from eldenet.data.kitti_files import (
    DEPTH_KINDS,
    DEPTH_TREE,
    RAW_TREE,
    SELECTION_TREE,
    KITTIFrames,
    Place,
    depth_maps,
    frame_list,
    pictures_of,
    scans,
    selected,
)
from eldenet.data.paths import find_root, incomplete
from eldenet.data.splits import hold_out
from eldenet.geometry import intrinsic_matrix
from eldenet.system.checks import one_of
from eldenet.system.errors import reading
from eldenet.system.files import read_text

_SPLITS = ("train", "val", "trainval", "test", "all")
_GROUND_TRUTH = {"groundtruth": "improved", "velodyne_raw": "sparse"}


class KITTIDepth(KITTIFrames):
    """The depth devkit's maps, with the pictures of KITTI raw or of Ma and Karaman's ``data_rgb``.

    The maps may be unpacked with or without ``train`` and ``val``, merged, or below ``data_depth_annotated``.
    Eigen's test split with improved ground truth is ``split="test"`` with ``list_file="eigen_652"``, or with
    BTS's list: of its 697 lines 45 say ``None`` and are left out, 652 remain.

    Args:
        root: the folder with the maps; None for ``$ELDENET_DATA/kitti/depth``.
        raw_root: the folder of the pictures (``<date>/<drive>/image_02/data``) and calibration files; None
            looks into ``root`` and beside it.
        depth: "groundtruth" (eleven scans, cleaned: "improved") or "velodyne_raw" (one scan: "sparse").
        split: "train" and "val" share no drive (:func:`~eldenet.data.splits.hold_out`) and are parts of the
            devkit's ``train``, "trainval" is both together; "test" is the devkit's ``val``; "all" takes all.
        cameras: 2 (left), 3 (right) or both.
        list_file: list of frames, in any part (:func:`~eldenet.data.kitti_files.frame_list`); "train" and
            "val" are then parts of the list.
        exclude_list: list whose drives are left out: Eigen's test drives are in the devkit's ``train``.
        frames: how many frames there must be, such as Eigen's 652; None for any number.
        calibration: "required", or "optional" to give frames no intrinsics if the files are missing.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 80 m unless given.

    Raises:
        FileNotFoundError: files are missing.
        ValueError: a setting is unknown, a line of a list is wrong, or the number of frames is another.
    """

    where_files_are = " (data.raw_root is the folder of the pictures)"

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        raw_root: str | Path | None = None,
        depth: str = "groundtruth",
        split: str = "train",
        cameras: Sequence[int] = (2,),
        list_file: str | Path | None = None,
        exclude_list: str | Path | None = None,
        frames: int | None = None,
        calibration: str = "required",
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, _SPLITS)
        one_of("depth", depth, DEPTH_KINDS)
        folder = find_root(root, "kitti/depth", [], DEPTH_TREE)
        picture_roots = [folder, folder.parent / "raw", folder.parent]
        if raw_root is not None:
            picture_roots = [find_root(raw_root, None, [], RAW_TREE, "data.raw_root")]
        parts = {"test": ("val",), "all": ("train", "val", "")}.get(split, ("train", ""))
        chosen = _checked(cameras)
        if list_file is not None:  # a list decides on parts and cameras
            parts, chosen = ("train", "val", ""), (2, 3)
        maps = depth_maps(folder, depth, parts, chosen)
        if list_file is None and not maps:
            raise incomplete(f"{folder} has no {depth} maps for split={split!r}", DEPTH_TREE)
        given = dict.fromkeys(maps, True) if list_file is None else frame_list(list_file)
        without = [place for place in given if depth == "groundtruth" and not given[place]]
        places = _split([place for place in given if place not in without], split, exclude_list)
        self.ground_truth = _GROUND_TRUTH[depth]
        pictures = pictures_of(places, picture_roots)
        super().__init__(folder, pictures, maps, places, without_depth=without, frames=frames, **options)
        self.calibrate(picture_roots, calibration)


class KITTIRaw(KITTIFrames):
    """KITTI raw: pictures with one LiDAR scan each, which is projected into the picture.

    Eigen's 697 test frames are ``split="test"`` with ``list_file="eigen_697"`` and ``projection="eigen"``.

    Args:
        root: the folder with the dates; None for ``$ELDENET_DATA/kitti/raw``.
        projection: "camera" or "eigen", see :func:`~eldenet.data.kitti_calibration.project_scan`.
        split: "train" and "val" share no drive (:func:`~eldenet.data.splits.hold_out`); "trainval", "test"
            and "all" take every frame.
        cameras: 2 (left), 3 (right) or both.
        list_file: list of frames (:func:`~eldenet.data.kitti_files.frame_list`); None takes every scan.
        exclude_list: list whose drives are left out, such as the list of the test frames.
        frames: how many frames there must be, such as Eigen's 697; None for any number.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 80 m unless given.

    Raises:
        FileNotFoundError: files are missing.
        ValueError: a setting is unknown, a line of a list is wrong, or the number of frames is another.
    """

    ground_truth = "sparse"

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        projection: str = "camera",
        split: str = "train",
        cameras: Sequence[int] = (2,),
        list_file: str | Path | None = None,
        exclude_list: str | Path | None = None,
        frames: int | None = None,
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, _SPLITS)
        one_of("projection", projection, PROJECTIONS)
        folder = find_root(root, "kitti/raw", [], RAW_TREE)
        sources = scans(folder, _checked(cameras) if list_file is None else (2, 3))
        if not sources:
            raise incomplete(f"{folder} has no velodyne_points", RAW_TREE)
        places = _split(list(sources if list_file is None else frame_list(list_file)), split, exclude_list)
        pictures = pictures_of(places, [folder])
        super().__init__(folder, pictures, sources, places, frames=frames, **options)
        self.projection = projection
        calibrated = self.calibrate([folder], "required")
        self.matrices = {key: velodyne_to_image(where, key[1]) for key, where in calibrated.items()}

    def frame_settings(self) -> dict[str, object]:
        """Return calibration and projection."""
        matrices = {f"scan {date} {camera}": m.tolist() for (date, camera), m in self.matrices.items()}
        return {**super().frame_settings(), **matrices, "projection": self.projection}

    def read_sparse(self, index: int, size: tuple[int, int]) -> np.ndarray:
        """Project the frame's scan."""
        place = self.places[index]
        matrix = self.matrices[place.date, place.camera]
        points = read_scan(self.root / self.files[index][1])
        return project_scan(points, matrix, size, self.projection).astype(np.float32)


class KITTISelection(KITTIFrames):
    """``val_selection_cropped``: 1,000 frames of the devkit's ``val``, cut to 1216 x 352 by KITTI itself.

    Args:
        root: the folder with ``val_selection_cropped``, or that folder; None for
            ``$ELDENET_DATA/kitti/depth_selection``.
        depth: "groundtruth" ("improved") or "velodyne_raw" ("sparse").
        frames: how many frames there must be, 1000 in the official set; None for any number.
        calibration: "required", or "optional" to give frames no intrinsics if ``intrinsics/`` is missing.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 80 m unless given.

    Raises:
        FileNotFoundError: files are missing.
        ValueError: a setting or a file name is wrong, or the number of frames is another.
    """

    where_files_are = " (data.calibration=optional does without intrinsics/)"

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        depth: str = "groundtruth",
        frames: int | None = 1000,
        calibration: str = "required",
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("depth", depth, DEPTH_KINDS)
        one_of("calibration", calibration, ("required", "optional"))
        folder = find_root(root, "kitti/depth_selection", [], SELECTION_TREE, "data.selection_root")
        if (folder / "val_selection_cropped").is_dir():
            folder = folder / "val_selection_cropped"
        word = "groundtruth_depth" if depth == "groundtruth" else depth
        pictures, maps = selected(folder / "image", "image"), selected(folder / word, word)
        if not (pictures or maps):
            raise incomplete(f"{folder} has no frames", SELECTION_TREE, "check data.selection_root")
        self.ground_truth = _GROUND_TRUTH[depth]
        places = sorted({*pictures, *maps})
        cameras = {place: folder / "intrinsics" / f"{path.stem}.txt" for place, path in pictures.items()}
        if calibration == "optional":
            cameras = {place: path for place, path in cameras.items() if path.is_file()}
        super().__init__(folder, pictures, maps, places, cameras=cameras, frames=frames, **options)

    def camera_of(self, index: int) -> np.ndarray | None:
        """Return the intrinsics of the cropped picture, from a separate file."""
        if len(self.files[index]) < 3:
            return None
        file = self.root / self.files[index][2]
        text = read_text(file)
        with reading(file, "matrix of nine numbers"):
            camera = np.array([float(number) for number in text.split()]).reshape(3, 3)
        try:
            return intrinsic_matrix(camera)
        except ValueError as error:
            raise ValueError(f"{file} must hold fx 0 cx, 0 fy cy, 0 0 1 ({error}): fetch it again") from error


def _checked(cameras: Sequence[int]) -> Sequence[int]:
    """The cameras in order, once each."""
    if not cameras or not set(cameras) <= {2, 3}:
        raise ValueError(f"cameras={list(cameras)}: give [2] (left color), [3] (right color) or [2, 3]")
    return sorted(set(cameras))


def _split(places: Sequence[Place], split: str, exclude_list: str | Path | None) -> list[Place]:
    """The places of a split, without the drives of ``exclude_list``."""
    if exclude_list is not None:
        tested = {place.drive for place in frame_list(exclude_list)}
        places = [place for place in places if place.drive not in tested]
    return [places[i] for i in hold_out([place.name for place in places], split)]

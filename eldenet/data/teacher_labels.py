"""``teacher_labels``: photographs without depth, labeled once by a trained network."""

import json
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any, Protocol, Unpack

import cv2
import numpy as np
import torch

from eldenet.data.base import FileDataset, SampleOptions, check_pair
from eldenet.data.io import IMAGE_ENDINGS, depth_encoding, read_depth, read_image
from eldenet.data.paths import default_cache, visible_files
from eldenet.geometry import pinhole, resize_image
from eldenet.system.digests import digest_of
from eldenet.system.files import part_file, read_json, write_json
from eldenet.system.progress import open_console, progress_bar
from eldenet.types import Frame

#: Version of the labels: raise it when the same teacher would label the same picture in another way.
VERSION = 3
BATCH = 16
LARGEST = 65.535  # [m], in 16-bit millimeters
MILLIMETERS = depth_encoding({"scale": 1e-3, "dtype": "uint16"})  # "mm" refuses close-ups as probably meters


class Labeler(Protocol):
    """A trained network: images ``(B, 3, H, W)`` RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m]."""

    input_size: tuple[int, int] | None

    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        """Return depth [m]."""

    @property
    def signature(self) -> dict[str, Any]:
        """Facts that distinguish this network from others."""


class TeacherLabels(FileDataset):
    """Pictures of a folder with the depth that a teacher sees in them.

    Photos are turned upright, as their EXIF tag says. The teacher sees the largest centered part of a picture
    that has the shape of its input, and that part is the frame. Labels are stored as 16-bit PNG [mm] of the
    picture's size, 0 around that part, in a folder of the cache, beside ``teacher.json``; another teacher
    gets another folder. A picture that changes (size or time) is labeled again.

    Args:
        root: folder of pictures of any size, also in folders below it. Hidden files and folders do not count.
        teacher: labels pictures that have no label yet, or changed since.
        mirror: average with the mirrored label of the mirrored picture.
        focal: focal length of the teacher's training camera, or canonical camera [widths]. A network that is
            not told a focal length sees every picture as that camera's, so its meters are right for it. None:
            unknown.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 0.001 to 65 m unless given.

    Raises:
        FileNotFoundError: the folder does not exist.
        ValueError: it has no pictures, or the teacher no ``input_size``.
    """

    ground_truth = "raw"
    depth_range = (1e-3, LARGEST)

    def __init__(
        self,
        root: str | Path | None,
        *,
        teacher: Labeler,
        mirror: bool = True,
        focal: float | None = None,
        **options: Unpack[SampleOptions],
    ) -> None:
        if root is None or not Path(root).expanduser().is_dir():
            given = "null" if root is None else root
            raise FileNotFoundError(f"data.photographs={given} is not a folder: give a folder of pictures")
        pictures_folder = Path(root).expanduser()
        files = find_pictures(pictures_folder)
        super().__init__(pictures_folder, files, [[file] for file in files], **options)
        if teacher.input_size is None:
            raise ValueError("teacher: give its input_size, [height, width] in pixels")
        self.seen_shape, self.focal = teacher.input_size, focal
        self.note = {
            "pictures": str(pictures_folder.resolve()),
            "teacher": teacher.signature,
            "mirror": mirror,
            "unit": "mm",
        }
        digest = digest_of(json.dumps(self.note, sort_keys=True))[:16]
        self.folder = default_cache() / "labels" / digest
        self._label_missing(teacher, mirror)

    def label_file(self, index: int) -> Path:
        """Return where the label of picture ``index`` lies."""
        return self.folder / f"{self.files[index][0]}.png"

    def frame_files(self, index: int) -> Sequence[Path]:
        """Return picture and label."""
        return [*super().frame_files(index), self.label_file(index)]

    def frame_settings(self) -> dict[str, object]:
        """Return the camera that labels are meant for."""
        return {"focal": self.focal}

    def load_frame(self, index: int) -> Frame:
        """Read one picture and its label."""
        picture, label = self.frame_files(index)
        image, depth = read_image(picture, upright=True), read_depth(label, MILLIMETERS)
        check_pair(image.shape, picture, depth.shape, label)
        top, left, rows, cols = centered_box((depth.shape[0], depth.shape[1]), self.seen_shape)
        part = (slice(top, top + rows), slice(left, left + cols))
        intrinsics = None
        if self.focal is not None:
            fx = self.focal * cols
            intrinsics = pinhole(fx, fx, (cols - 1) / 2, (rows - 1) / 2)
        return Frame(np.ascontiguousarray(image[part]), depth[part], intrinsics, self.names[index])

    def size_group(self, index: int) -> Hashable:
        """Return the picture: any two may differ in size."""
        return None if self.resize_on_load is not None else index

    def _label_missing(self, teacher: Labeler, mirror: bool) -> None:
        record = self.folder / "pictures.json"  # file -> stamp of the picture that its label is of
        try:
            known: dict[str, str] = read_json(record)
        except (ValueError, OSError):  # there is none yet
            known = {}
        stamps = {file: _stamp(self.root / file) for (file,) in self.files}
        missing = [
            index
            for index, (file,) in enumerate(self.files)
            if known.get(file) != stamps[file] or not self.label_file(index).is_file()
        ]
        if not missing:
            return
        labeled = dict(known)
        write_json(self.folder / "teacher.json", {"version": VERSION, **self.note})

        reasons: dict[int, str] = {}
        title = f"labeling pictures in {self.root.name}"
        try:
            with progress_bar(open_console(stderr=True), title, len(missing), unit="pictures") as bar:
                for start in range(0, len(missing), BATCH):
                    indices = missing[start : start + BATCH]
                    unreadable = self._label(indices, teacher, mirror)
                    files = [self.files[index][0] for index in indices if index not in unreadable]
                    labeled |= {file: stamps[file] for file in files}
                    reasons |= unreadable
                    bar.advance(len(indices))
        finally:
            if labeled != known:
                write_json(record, labeled)
        self.leave_out(reasons)

    def _label(self, indices: Sequence[int], teacher: Labeler, mirror: bool) -> dict[int, str]:
        """Label these pictures and return why some cannot be read."""
        pictures, unreadable = {}, {}
        for index in indices:
            try:
                pictures[index] = read_image(self.root / self.files[index][0], upright=True)
            except (ValueError, OSError) as error:
                if self.on_error != "skip":
                    raise
                unreadable[index] = str(error)
        labels = label_pictures(teacher, list(pictures.values()), mirror) if pictures else []
        for index, label in zip(pictures, labels, strict=True):
            with part_file(self.label_file(index)) as unfinished:
                cv2.imwrite(str(unfinished), label)
        return unreadable


def _stamp(picture: Path) -> str:
    """Return a text that changes when a picture is replaced by another one of the same name."""
    try:
        found = picture.stat()
    except OSError:  # reported when it is read
        return ""
    return f"version {VERSION}: {found.st_size} {found.st_mtime_ns}"


def find_pictures(folder: Path) -> list[str]:
    """Return the pictures in ``folder`` and below, relative to it; hidden files and folders do not count.

    Raises:
        ValueError: there are none.
    """
    files = sorted(path.relative_to(folder).as_posix() for path in visible_files(folder, IMAGE_ENDINGS))
    if not files:
        raise ValueError(
            f"data.photographs={folder} has no pictures: give a folder of {', '.join(IMAGE_ENDINGS)} files; "
            "hidden files and folders do not count"
        )
    return files


def label_pictures(teacher: Labeler, pictures: Sequence[np.ndarray], mirror: bool) -> list[np.ndarray]:
    """Return a label ``(H, W)`` uint16 [mm] for each picture ``(H, W, 3)`` uint8; 0 around what it saw."""
    assert teacher.input_size is not None
    boxes = [centered_box((picture.shape[0], picture.shape[1]), teacher.input_size) for picture in pictures]
    seen = [
        resize_image(picture[top : top + rows, left : left + cols], teacher.input_size)
        for picture, (top, left, rows, cols) in zip(pictures, boxes, strict=True)
    ]
    images = torch.from_numpy(np.stack(seen).transpose(0, 3, 1, 2).copy()).float().div_(255.0)
    depth = teacher(images)
    if mirror:
        depth = (depth + teacher(images.flip(-1)).flip(-1)) / 2
    labels = []
    for picture, (top, left, rows, cols), one in zip(pictures, boxes, depth[:, 0].numpy(), strict=True):
        label = np.zeros(picture.shape[:2], np.uint16)
        meters = cv2.resize(one.astype(np.float32), (cols, rows), interpolation=cv2.INTER_LINEAR)
        label[top : top + rows, left : left + cols] = np.rint(meters.clip(1e-3, LARGEST) * 1000)
        labels.append(label)
    return labels


def centered_box(size: tuple[int, int], shape: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return ``(top, left, height, width)`` [px] of the largest centered part of ``size`` with this shape."""
    height, width = size
    rows, cols = (
        min(height, round(width * shape[0] / shape[1])),
        min(width, round(height * shape[1] / shape[0])),
    )
    return (height - rows) // 2, (width - cols) // 2, rows, cols

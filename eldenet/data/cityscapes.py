"""Cityscapes: the official files with a camera per frame, and MTAN's small ``.npy`` set.

Cordts et al., "The Cityscapes Dataset for Semantic Urban Scene Understanding", CVPR 2016. Depth comes from
stereo (SGM): it has holes, and its error grows with distance.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

import numpy as np

from eldenet.data.array_files import read_array
from eldenet.data.base import FileDataset, SampleOptions, check_pair
from eldenet.data.cityscapes_labels import CLASS_IDS, read_label_array, read_label_ids, wanted_labels
from eldenet.data.io import DepthEncoding, decode_depth, read_depth, read_image, read_raw_depth
from eldenet.data.paths import find_root, incomplete, missing_files
from eldenet.geometry import disparity_to_depth, pinhole, resize_intrinsics
from eldenet.system.checks import one_of
from eldenet.system.errors import reading
from eldenet.system.files import parse_json, read_text
from eldenet.types import Frame

CITYSCAPES_SIZE = (1024, 2048)  # the pictures that disparity [px] and cameras refer to
# p = 0 is unknown; p = 1 is a disparity of 0, infinitely far, which counts as unknown too
DISPARITY = DepthEncoding("cityscapes disparity", 1 / 256, -1.0, lowest_peak=256)

CITYSCAPES_TREE = """
leftImg8bit/{train,val,test}/<city>/<city>_000000_000019_leftImg8bit.png
disparity/{train,val,test}/<city>/<city>_000000_000019_disparity.png       (16 bits)
camera/{train,val,test}/<city>/<city>_000000_000019_camera.json
gtFine/{train,val,test}/<city>/<city>_000000_000019_gtFine_labelIds.png    (optional: for errors by class)
(each also below its zip's name: disparity_trainvaltest/disparity/..., disparity_trainvaltest/...)
"""
MTAN_TREE = """
train/image/0.npy ... 2974.npy     (128, 256, 3) float, 0 to 1
train/depth/0.npy ...              (128, 256, 1) float, inverse depth, 0 = unknown
val/image/0.npy ... 499.npy, val/depth/0.npy ...
train/label/0.npy ..., val/label/...   (optional: (128, 256), classes, -1 = none; or label_7, label_19)
"""
_LOG = logging.getLogger("eldenet")
STREET_RANGE = (1.0, 80.0)  # [m]
WIDEST = 3.0  # baseline of cameras on one car [m]
KINDS = {"leftImg8bit": ".png", "disparity": ".png", "camera": ".json"}


class Cityscapes(FileDataset):
    """The official layout: left picture, disparity and camera of each frame.

    Convention: depth = baseline x fx / d with d = (p - 1) / 256 [px of the full 2048 x 1024 picture] and
    p > 0; each frame has its own baseline and fx. Resized files keep their disparity values.

    Args:
        root: the folder with ``leftImg8bit``, ``disparity`` and ``camera``, each possibly below its zip's
            name; None for ``$ELDENET_DATA/cityscapes``.
        split: "train" and "val", parts of the official training frames that share no city, "trainval" for
            both, "official_val" (500 frames) or "official_test" (1,525).
        val_cities: cities of the official training part that are for validation.
        labels: also read ``gtFine``'s 19 classes, for errors by class: True, False, or "auto" if they exist.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1 to 80 m unless given.

    Raises:
        FileNotFoundError: files are missing.
        ValueError: the split or a city is unknown.
    """

    depth_range = STREET_RANGE

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        split: str = "train",
        val_cities: Sequence[str] = ("darmstadt", "ulm"),
        labels: bool | str = False,
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, ("train", "val", "trainval", "official_val", "official_test"))
        root = find_root(root, "cityscapes", [], CITYSCAPES_TREE)
        part = split.removeprefix("official_") if split.startswith("official_") else "train"
        places = {kind: _place(root, kind, part) for kind in KINDS}
        names = sorted(
            {
                f"{part}/{path.parent.name}/{path.stem.removesuffix(f'_{kind}')}"
                for kind in ("leftImg8bit", "disparity")
                for path in (root / places[kind]).glob(f"*/*_{kind}.png")
            }
        )
        if not names:
            raise incomplete(f"{root} has no <city>/*_leftImg8bit.png of {part!r}", CITYSCAPES_TREE)
        if split in ("train", "val"):
            cities = {name.split("/")[1] for name in names}
            unknown = sorted(set(val_cities) - cities)
            if unknown or not cities - set(val_cities):
                raise ValueError(
                    f"val_cities={list(val_cities)}: give some, but not all, of {', '.join(sorted(cities))}"
                )
            names = [name for name in names if (name.split("/")[1] in val_cities) == (split == "val")]
        kinds = [(places[kind], f"{kind}{ending}") for kind, ending in KINDS.items()]
        gt_fine = next((place for place in _places("gtFine", part) if (root / place).is_dir()), None)
        found = gt_fine is not None
        if found and labels == "auto":  # incomplete labels are not read: depth alone is scored
            lost = missing_files(root, [f"{gt_fine}/{_below(n)}_gtFine_labelIds.png" for n in names])
            found = not lost
            if lost:
                _LOG.warning(
                    "labels=auto: no labels are read, because %d are missing, such as %s", len(lost), lost[0]
                )
        if wanted_labels(labels, found, f"gtFine/{part} in {root}"):
            self.class_names = tuple(CLASS_IDS)
            kinds.append((str(gt_fine), "gtFine_labelIds.png"))
        files = [tuple(f"{place}/{_below(name)}_{kind}" for place, kind in kinds) for name in names]
        super().__init__(root, names, files, **options)

    def load_frame(self, index: int) -> Frame:
        """Read one frame."""
        image_file, disparity_file, camera_file, *label_file = self.frame_files(index)
        image, disparity = read_image(image_file, gray=False), read_depth(disparity_file, DISPARITY)
        check_pair(image.shape, image_file, disparity.shape, disparity_file)
        intrinsics, baseline = read_stereo_camera(camera_file)
        depth = disparity_to_depth(disparity, intrinsics[0, 0], baseline)
        intrinsics = resize_intrinsics(intrinsics, CITYSCAPES_SIZE, (image.shape[0], image.shape[1]))
        labels = read_label_ids(label_file[0]) if label_file else None
        if labels is not None:
            check_pair(labels.shape, label_file[0], depth.shape, disparity_file)
        return Frame(image, depth, intrinsics, self.names[index], labels)


def read_stereo_camera(path: Path) -> tuple[np.ndarray, float]:
    """Return intrinsics ``(3, 3)`` [px at 2048 x 1024] and baseline [m] of a ``*_camera.json``.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is truncated, or a number is missing or impossible.
    """
    text = read_text(path, "fetch camera_trainvaltest.zip")
    with reading(path, "Cityscapes camera"):
        content = parse_json(text, path)
        camera = content["intrinsic"]
        fx, fy, cx, cy = (float(camera[key]) for key in ("fx", "fy", "u0", "v0"))
        baseline = float(content["extrinsic"]["baseline"])
    if not (min(fx, fy, baseline) > 0 and np.isfinite([fx, fy, cx, cy, baseline]).all()):
        raise ValueError(
            f"{path}: fx={fx}, fy={fy}, baseline={baseline} must be above 0, and u0={cx}, v0={cy} "
            "finite: fetch it again"
        )
    if baseline > WIDEST:
        raise ValueError(f"{path}: baseline={baseline} is wider than a car: give it in meters")
    return pinhole(fx, fy, cx, cy), baseline


def _place(root: Path, kind: str, part: str) -> str:
    """Folder of one kind of file, relative to ``root``, however its zip was unpacked."""
    places = _places(kind, part)
    found = next((place for place in places if (root / place).is_dir()), None)
    if found is None:
        lost = f"{root} has none of {', '.join(places)} (fetch {kind}_trainvaltest.zip)"
        raise incomplete(lost, CITYSCAPES_TREE)
    return found


def _places(kind: str, part: str) -> list[str]:
    return [f"{kind}/{part}", f"{kind}_trainvaltest/{kind}/{part}", f"{kind}_trainvaltest/{part}"]


def _below(name: str) -> str:
    return name.partition("/")[2]


class CityscapesMTAN(FileDataset):
    """MTAN's 128 x 256 arrays (Dropbox, Kaggle): pictures in [0, 1] and inverse depth.

    Liu et al., "End-to-End Multi-Task Learning with Attention", CVPR 2019.

    Convention: the set does not document its unit. From its range (0.49 = 126 px) we infer that a value v is
    p / 65535, p as in the official disparity files; then depth = baseline x focal x 256 / (65535 v - 1). The
    set lacks the frames' cameras, so even then meters are approximate, and there are no intrinsics. Pictures
    are converted to 8 bits.

    Args:
        root: the folder with ``train`` and ``val``; None for ``$ELDENET_DATA/cityscapes_mtan``.
        split: "train" and "val", parts of the set's training frames, "trainval" for both, or "official_val"
            for its 500 validation frames, on which papers report.
        val_frames: how many of the training frames are for validation: those with the highest numbers.
        inverse_scale: baseline x fx x 256 / 65535 [m], with 0.22 m and 2262.52 px (at 2048 pixels of width).
        labels: also read ``label`` (or ``label_19``, ``label_7``), for errors by class: True, False, or
            "auto" if they exist. The set does not name its classes.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1 to 80 m unless given.

    Raises:
        FileNotFoundError: files are missing.
        ValueError: the split is unknown, or ``val_frames`` leaves no training frame.
    """

    depth_range = STREET_RANGE

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        split: str = "train",
        val_frames: int = 150,
        inverse_scale: float = 1.944383,
        labels: bool | str = False,
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, ("train", "val", "trainval", "official_val"))
        if not inverse_scale > 0:
            raise ValueError(f"inverse_scale={inverse_scale} [m]: it must be above 0")
        root = find_root(root, "cityscapes_mtan", ["train", "val"], MTAN_TREE)
        part = "val" if split == "official_val" else "train"
        stems = {path.stem for kind in ("image", "depth") for path in (root / part / kind).glob("*.npy")}
        wrong = sorted(stem for stem in stems if not stem.isdecimal())
        if wrong:
            raise ValueError(f"{root / part}: {wrong[0]}.npy must be named by its number, such as 0.npy")
        numbers = sorted(int(stem) for stem in stems)
        if split in ("train", "val"):
            if not 0 < val_frames < max(len(numbers), 1):
                raise ValueError(f"val_frames={val_frames}: give at least 1 and fewer than {len(numbers)}")
            numbers = numbers[-val_frames:] if split == "val" else numbers[:-val_frames]
        kinds = ["image", "depth"]
        found = [kind for kind in ("label", "label_19", "label_7") if (root / part / kind).is_dir()]
        if wanted_labels(labels, bool(found), f"{part}/label in {root}"):
            self.class_names = tuple(f"class {number}" for number in range(len(CLASS_IDS)))
            kinds.append(found[0])
        self.constant = inverse_scale * 65535
        self.encoding = DepthEncoding("MTAN inverse depth", dtype="float", decode=self._meters)
        names = [f"{part}/{number}" for number in numbers]
        files = [tuple(f"{part}/{kind}/{n}.npy" for kind in kinds) for n in numbers]
        super().__init__(root, names, files, **options)

    def _meters(self, inverse: np.ndarray) -> np.ndarray:
        steps = inverse.astype(np.float64) * 65535 - 1  # of 1/256 px; up to 0 is infinitely far
        return np.where(steps > 1e-6, self.constant / np.maximum(steps, 1e-6), 0.0)

    def frame_settings(self) -> dict[str, object]:
        """Return the constant that converts inverse depth to meters."""
        return {"constant": self.constant}

    def load_frame(self, index: int) -> Frame:
        """Read one frame."""
        image_file, depth_file, *label_file = self.frame_files(index)
        image, inverse = read_array(image_file), read_raw_depth(depth_file)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype.kind != "f":
            raise ValueError(f"{image_file} is {image.shape} {image.dtype}, expected (H, W, 3) float")
        if not (image.min(initial=0) >= -1e-3 and image.max(initial=0) <= 1.001):  # NaN fails too
            raise ValueError(
                f"{image_file} ranges from {image.min()} to {image.max()}, expected 0 to 1: is it normalized?"
            )
        check_pair(image.shape, image_file, inverse.shape, depth_file)
        if inverse.max(initial=0) > 1:
            raise ValueError(
                f"{depth_file} reaches {inverse.max()}, but inverse depth is at most 1: is it in meters?"
            )
        depth = decode_depth(inverse, self.encoding, depth_file)
        labels = read_label_array(label_file[0], len(self.class_names)) if label_file else None
        if labels is not None:
            check_pair(labels.shape, label_file[0], depth.shape, depth_file)
        image = (image.clip(0, 1) * 255).round().astype(np.uint8)
        return Frame(image, depth, None, self.names[index], labels)

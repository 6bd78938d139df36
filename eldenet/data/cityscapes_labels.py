"""Semantic labels of Cityscapes as class numbers: the official label pictures, and MTAN's arrays."""

from pathlib import Path

import numpy as np

from eldenet.data.array_files import read_array
from eldenet.data.io import read_raw_depth

NO_CLASS = 255
CLASS_IDS = {
    "road": 7, "sidewalk": 8, "building": 11, "wall": 12, "fence": 13, "pole": 17, "traffic light": 19,
    "traffic sign": 20, "vegetation": 21, "terrain": 22, "sky": 23, "person": 24, "rider": 25, "car": 26,
    "truck": 27, "bus": 28, "train": 31, "motorcycle": 32, "bicycle": 33,
}  # fmt: skip
"""The 19 scored classes, in the order of the official train ids 0 to 18, with their label ids."""
_CLASS_OF_ID = np.full(256, NO_CLASS, np.uint8)
_CLASS_OF_ID[list(CLASS_IDS.values())] = np.arange(len(CLASS_IDS))


def read_label_ids(path: Path) -> np.ndarray:
    """Read a ``*_gtFine_labelIds.png`` as classes ``(H, W)`` uint8, 0 to 18, 255 = none.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or holds no label ids.
    """
    ids, largest = read_raw_depth(path), max(CLASS_IDS.values())
    if ids.dtype != np.uint8 or (ids[ids != NO_CLASS] > largest).any():
        raise ValueError(
            f"{path} holds {ids.dtype} up to {ids.max(initial=0)}, expected label ids 0 to {largest} in "
            "8 bits: is it *_gtFine_labelIds.png? If not, fetch gtFine_trainvaltest.zip"
        )
    return _CLASS_OF_ID[ids]


def read_label_array(path: Path, classes: int) -> np.ndarray:
    """Read an ``.npy`` of whole numbers as classes ``(H, W)`` uint8; below 0 and 255 become 255 = none.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or holds numbers that are not classes.
    """
    values = read_array(path)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    known = (values >= 0) & (values != NO_CLASS)
    fit = values.ndim == 2 and values.dtype.kind in "iuf" and np.isfinite(values).all()
    if not fit or (values[known] >= classes).any() or (values[known] % 1 != 0).any():
        raise ValueError(
            f"{path} is {values.shape} {values.dtype}, expected (H, W) of whole numbers 0 to {classes - 1} "
            "or -1 for none: fetch it again, or set data.labels=false"
        )
    return np.where(known, values, NO_CLASS).astype(np.uint8)


def wanted_labels(labels: bool | str, found: bool, where: str) -> bool:
    """Whether to read labels; ``labels`` is True, False or "auto", which reads them if they exist.

    Raises:
        FileNotFoundError: ``labels`` is True and there are none.
        ValueError: ``labels`` is anything else.
    """
    if labels not in (True, False, "auto"):
        raise ValueError(f"labels={labels!r}: give true, false or auto")
    if labels is True and not found:
        raise FileNotFoundError(f"labels=true, but there is no {where}: fetch the labels, or set labels=auto")
    return found and labels is not False

"""An image into a network's input, and the network's boxes back into the image."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eldenet.geometry import from_corner
from eldenet.perception.iou import iou_2d

_PAD = 114  # gray, as in the training of YOLO's family


class Placement(NamedTuple):
    """Where an image lies in a network's input: ``input = image * scale + shift``, (x, y) each.

    Attributes:
        scale: ``(2,)``.
        shift: ``(2,)`` [input px].
        size: ``(height, width)`` of the image [px].
    """

    scale: np.ndarray
    shift: np.ndarray
    size: tuple[int, int]


def fit_image(image: np.ndarray, size: tuple[int, int], letterbox: str) -> tuple[np.ndarray, Placement]:
    """Resize an image into ``(height, width)`` [px]; return the input ``(H, W, 3)`` and the placement.

    ``letterbox`` is "topleft" or "center" (aspect kept, padded), or "stretch".
    """
    import cv2

    height, width = image.shape[:2]
    if letterbox == "stretch":
        scale = np.array([size[1] / width, size[0] / height])
        resized = np.asarray(cv2.resize(image, (size[1], size[0])))
        return resized, Placement(scale, np.zeros(2), (height, width))
    ratio = min(size[0] / height, size[1] / width)
    inner = (max(1, round(height * ratio)), max(1, round(width * ratio)))
    left, top = ((size[1] - inner[1]) // 2, (size[0] - inner[0]) // 2) if letterbox == "center" else (0, 0)
    padded = np.full((*size, 3), _PAD, np.uint8)
    padded[top : top + inner[0], left : left + inner[1]] = cv2.resize(image, (inner[1], inner[0]))
    # not ``ratio``, for sides are rounded to whole pixels: half a pixel here is up to two of a large image
    scale = np.array([inner[1] / width, inner[0] / height])
    return padded, Placement(scale, np.array([left, top], np.float64), (height, width))


def select_boxes(
    xyxy: np.ndarray,
    score: np.ndarray,
    placement: Placement,
    *,
    threshold: float,
    nms: float,
    between_classes: float = 1.0,
    keep: Sequence[int] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes ``(N, 4)`` [image px], scores ``(N,)`` and labels ``(N,)`` of a network's output, best first.

    Boxes are cut to the image; those that are then at most 1 px wide or high are dropped.

    Args:
        xyxy: ``(A, 4)`` of every anchor [input px, counted from the corner].
        score: ``(A, classes)``.
        placement: of the image in the input.
        threshold: boxes below this score are dropped.
        nms: IoU above which the worse of two boxes of a class is dropped.
        between_classes: the same for two boxes of different classes; 1: keep both.
        keep: indices of the classes to keep; None: all.
    """
    import cv2

    label = score.argmax(1)
    best = score[np.arange(len(score)), label]
    kept = (best >= threshold) & np.isfinite(xyxy).all(1)
    xyxy, best, label = xyxy[kept], best[kept], label[kept]
    xyxy = (xyxy - np.tile(placement.shift, 2)) / np.tile(placement.scale, 2)
    xyxy = from_corner(np.clip(xyxy, 0, np.tile(placement.size[::-1], 2)))
    corner_and_size = np.concatenate([xyxy[:, :2], xyxy[:, 2:] - xyxy[:, :2]], axis=1)
    # torchvision's NMS would load torch, which takes seconds and which an exported network does not need
    found = cv2.dnn.NMSBoxesBatched(corner_and_size.tolist(), best.tolist(), label.tolist(), 0.0, nms)
    chosen = np.array(found, int)
    chosen = chosen[cross_class_nms(xyxy[chosen], label[chosen], between_classes)]
    chosen = chosen[(xyxy[chosen, 2:] - xyxy[chosen, :2] > 1).all(1)]
    if keep is not None:  # last: a box that lost to one of an unwanted class must not come back
        chosen = chosen[np.isin(label[chosen], keep)]
    return xyxy[chosen], best[chosen], label[chosen].astype(np.int64)


def cross_class_nms(xyxy: np.ndarray, label: np.ndarray, max_iou: float) -> np.ndarray:
    """Indices ``(K,)`` of the boxes to keep: of two of different classes with an IoU above this, the first.

    A pick-up that is detected as a car and as a truck would become two objects in one place.
    """
    twins = (iou_2d(xyxy, xyxy) > max_iou) & (label[:, None] != label[None])
    kept: list[int] = []
    for index in range(len(label)):
        if not twins[index, kept].any():
            kept.append(index)
    return np.array(kept, int)

"""A frame into a network's input, and a network's boxes back into the frame."""

from collections.abc import Sequence

import numpy as np

from eldenet.geometry import from_corner
from eldenet.perception.iou import iou_2d

_PAD = 114  # gray, as in training


def fit_picture(
    frame: np.ndarray, size: tuple[int, int], letterbox: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Resize a frame into ``(height, width)``; returns picture, scale (x, y) and shift (x, y) [px]."""
    import cv2

    height, width = frame.shape[:2]
    if letterbox == "stretch":
        scale = np.array([size[1] / width, size[0] / height])
        return np.asarray(cv2.resize(frame, (size[1], size[0]))), scale, np.zeros(2)
    ratio = min(size[0] / height, size[1] / width)
    inner = (max(1, round(height * ratio)), max(1, round(width * ratio)))
    left, top = ((size[1] - inner[1]) // 2, (size[0] - inner[0]) // 2) if letterbox == "center" else (0, 0)
    picture = np.full((*size, 3), _PAD, np.uint8)
    picture[top : top + inner[0], left : left + inner[1]] = cv2.resize(frame, (inner[1], inner[0]))
    # of whole pixels, so not quite the ratio: up to half a pixel there is up to two in a large frame
    scale = np.array([inner[1] / width, inner[0] / height])
    return picture, scale, np.array([left, top], np.float64)


def in_frame(
    xyxy: np.ndarray,
    score: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    size: tuple[int, int],
    *,
    threshold: float,
    nms: float,
    between_classes: float = 1.0,
    keep: Sequence[int] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes ``(N, 4)`` [frame px], scores ``(N,)`` and labels ``(N,)`` of a network's answer, best first.

    Args:
        xyxy: ``(A, 4)`` of every anchor [input px, counted from its corner].
        score: ``(A, classes)``.
        scale: (x, y) of :func:`fit_picture`.
        shift: (x, y) of :func:`fit_picture` [input px].
        size: ``(height, width)`` of the frame [px].
        threshold: boxes below this score are dropped.
        nms: see :func:`class_wise_nms`.
        between_classes: see :func:`one_class_each`.
        keep: numbers of the classes to keep; None: all.
    """
    label = score.argmax(1)
    best = score[np.arange(len(score)), label]
    kept = (best >= threshold) & np.isfinite(xyxy).all(1)
    xyxy, best, label = xyxy[kept], best[kept], label[kept]
    xyxy = (xyxy - np.tile(shift, 2)) / np.tile(scale, 2)
    xyxy = from_corner(np.clip(xyxy, 0, np.tile([size[1], size[0]], 2)))
    chosen = class_wise_nms(xyxy, best, label, nms)
    chosen = chosen[one_class_each(xyxy[chosen], label[chosen], between_classes)]
    chosen = chosen[(xyxy[chosen, 2:] - xyxy[chosen, :2] > 1).all(1)]
    if keep is not None:  # last: what lost to a class that is not wanted must not come back
        chosen = chosen[np.isin(label[chosen], keep)]
    return xyxy[chosen], best[chosen], label[chosen].astype(np.int64)


def class_wise_nms(xyxy: np.ndarray, score: np.ndarray, label: np.ndarray, threshold: float) -> np.ndarray:
    """Numbers of the boxes to keep, best first: non-maximum suppression within each class."""
    import torch
    from torchvision.ops import batched_nms

    kept = batched_nms(*(torch.from_numpy(np.ascontiguousarray(a)) for a in (xyxy, score, label)), threshold)
    return np.asarray(kept.numpy())


def one_class_each(xyxy: np.ndarray, label: np.ndarray, threshold: float) -> np.ndarray:
    """Numbers of the boxes to keep: of two of different classes with a larger IoU than this, the first.

    A pick-up that is found as a car and as a truck would become two objects in one place. 1: keep all.
    """
    if threshold >= 1:
        return np.arange(len(label))
    twins = (iou_2d(xyxy, xyxy) > threshold) & (label[:, None] != label[None])
    kept: list[int] = []
    for number in range(len(label)):
        if not twins[number, kept].any():
            kept.append(number)
    return np.array(kept, int)

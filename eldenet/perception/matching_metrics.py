"""How good 3D boxes are: center accuracy and match rates, with confidence intervals.

Definitions. A true and a predicted object are a pair if the detector found the object: 2D IoU of 0.5 or
more, one to one, the largest overlaps first. **Center accuracy**: mean over pairs of
``max(0, 1 - |c - c*| / |c*|)`` with c* the true center in the level frame. **Match rate**: share of pairs
whose boxes overlap by at least a quarter (or a half) in BEV or 3D, or whose centers are at most 0.5, 1, 2 or
4 m apart. **Recall**: the same, over all true objects. Yaw is compared modulo pi.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Self

import numpy as np

from eldenet.boxes import ArrayRows, Boxes3D, wrap_half
from eldenet.evaluation.bootstrap import mean_interval
from eldenet.perception.iou import box_ious, iou_2d

PAIR_OVERLAP = 0.5
BINS = (0.0, 10.0, 20.0, 40.0, np.inf)  # [m]


@dataclass(frozen=True)
class Pairs(ArrayRows):
    """Pairs of true and predicted objects, over any number of frames.

    Attributes:
        frame: ``(P,)`` index of each pair's frame.
        truth: ``(P,)`` index of the true object in its frame.
        distance: ``(P,)`` of the true center [m].
        error: ``(P,)`` between the centers [m].
        depth_error: ``(P,)`` along z [m], signed.
        bev: ``(P,)`` BEV IoU.
        iou: ``(P,)`` 3D IoU.
        yaw: ``(P,)`` error [rad], modulo pi.
        truths: number of true objects, found or not.
    """

    frame: np.ndarray
    truth: np.ndarray
    distance: np.ndarray
    error: np.ndarray
    depth_error: np.ndarray
    bev: np.ndarray
    iou: np.ndarray
    yaw: np.ndarray
    truths: int

    def __len__(self) -> int:
        return len(self.error)

    @property
    def accuracy(self) -> np.ndarray:
        """``(P,)`` center accuracy of each pair."""
        return np.asarray(np.maximum(0.0, 1.0 - self.error / self.distance))

    def select(self, chosen: np.ndarray | slice) -> Self:
        """The pairs that ``chosen (P,)`` picks; ``truths`` counts these, so recalls become match rates."""
        pairs = super().select(chosen)
        return replace(pairs, truths=len(pairs))

    @classmethod
    def join(cls, parts: Sequence["Pairs"]) -> "Pairs":
        """The pairs of several frames, numbered in order."""
        if not parts:
            index, value = np.zeros(0, int), np.zeros(0)
            return cls(index, index, *(value,) * 6, truths=0)
        arrays = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)[:-1]}
        arrays["frame"] = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        return cls(**arrays, truths=sum(part.truths for part in parts))


def pair_up(truth_xyxy: np.ndarray, found_xyxy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices ``(P,)`` of true and found 2D boxes: one to one, the largest overlaps first, of any class."""
    overlap = iou_2d(truth_xyxy, found_xyxy)
    rows, columns = [], []
    while overlap.size and overlap.max() >= PAIR_OVERLAP:
        row, column = np.unravel_index(int(overlap.argmax()), overlap.shape)
        rows.append(int(row))
        columns.append(int(column))
        overlap[row], overlap[:, column] = -1, -1
    return np.array(rows, int), np.array(columns, int)


def compare(truth: Boxes3D, predicted: Boxes3D, rows: np.ndarray, columns: np.ndarray) -> Pairs:
    """Pairs of one frame: ``truth[rows]`` against ``predicted[columns]``, indices ``(P,)`` each."""
    first, second = truth.select(rows), predicted.select(columns)
    bev, iou = box_ious(first, second)
    offset = second.center - first.center
    return Pairs(
        frame=np.zeros(len(rows), int),
        truth=rows,
        distance=np.linalg.norm(first.center, axis=1),
        error=np.linalg.norm(offset, axis=1),
        depth_error=offset[:, 2],
        bev=np.diagonal(bev).copy(),
        iou=np.diagonal(iou).copy(),
        yaw=np.abs(wrap_half(second.yaw - first.yaw)),
        truths=len(truth),
    )


def summary(pairs: Pairs) -> dict[str, float]:
    """Metrics over pairs; shares and accuracy in [0, 1], lengths in meters, yaw in degrees."""
    if not len(pairs):
        return {"pairs": 0.0, "truths": float(pairs.truths)}
    figures = {
        "pairs": float(len(pairs)),
        "truths": float(pairs.truths),
        "accuracy": float(pairs.accuracy.mean()),
        "median_error": float(np.median(pairs.error)),
        "depth_accuracy": float(np.maximum(0, 1 - np.abs(pairs.depth_error) / pairs.distance).mean()),
        "bev_iou": float(pairs.bev.mean()),
        "median_yaw": float(np.degrees(np.median(pairs.yaw))),
    }
    for name, values, limits in (("bev", pairs.bev, (0.25, 0.5)), ("3d", pairs.iou, (0.25, 0.5, 0.7))):
        for limit in limits:
            figures[f"{name}>{limit}"] = float((values >= limit).mean())
            figures[f"recall {name}>{limit}"] = float((values >= limit).sum() / max(pairs.truths, 1))
    for limit in (0.5, 1, 2, 4):
        figures[f"within {limit} m"] = float((pairs.error <= limit).mean())
    return figures


def by_distance(pairs: Pairs) -> list[tuple[float, float, dict[str, float]]]:
    """``(from, to, summary)`` of each bin of the true distance [m].

    There are no recalls and no number of true objects: the distances of unpaired ones are unknown here.
    """
    parts = []
    for low, high in pairwise(BINS):
        figures = summary(pairs.select((pairs.distance >= low) & (pairs.distance < high)))
        kept = {key: value for key, value in figures.items() if key != "truths" and "recall" not in key}
        parts.append((low, high, kept))
    return parts


def bootstrap(values: np.ndarray, groups: np.ndarray) -> tuple[float, float]:
    """95 % interval of the mean of ``values (P,)`` by bootstrap over whole frames ``groups (P,)``.

    The objects of a frame share its errors. With a single frame, objects are drawn instead, and the interval
    is too narrow. ``values`` may be differences of two methods on the same pairs.
    """
    alone = len(np.unique(groups)) == 1
    return mean_interval(values, None if alone else groups)

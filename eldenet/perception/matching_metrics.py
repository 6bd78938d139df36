"""What boxes are worth: center accuracy and match rates, with intervals.

Definitions. A truth and a prediction are a pair if the detector found it: 2D IoU of 0.5 or more, one to one,
the largest overlaps first. **Center accuracy**: mean over pairs of ``max(0, 1 - |c - c*| / |c*|)``, c* the
true center in the level frame. **Match rate**: share of pairs whose boxes overlap by at least a quarter (or a
half) from above or in space, or whose centers are at most 0.5, 1, 2 or 4 m apart. **Recall**: the same, over
all truths. Yaw is compared modulo pi.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from eldenet.boxes import Boxes3D, wrap_half
from eldenet.evaluation.bootstrap import bootstrap_interval
from eldenet.perception.iou import box_ious, iou_2d

PAIR_OVERLAP = 0.5
BINS = (0.0, 10.0, 20.0, 40.0, np.inf)  # [m]


@dataclass(frozen=True)
class Pairs:
    """Pairs of truths and predictions, over any number of frames.

    Attributes:
        frame: ``(P,)`` number of the frame of each pair.
        truth: ``(P,)`` number of the truth in its frame.
        distance: ``(P,)`` of the true center [m].
        error: ``(P,)`` between the centers [m].
        depth_error: ``(P,)`` along z [m], signed.
        bev: ``(P,)`` IoU from above.
        iou: ``(P,)`` IoU in space.
        yaw: ``(P,)`` error [rad], modulo pi.
        truths: how many truths there were, found or not.
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

    def select(self, chosen: np.ndarray) -> "Pairs":
        """Those that ``chosen`` picks; ``truths`` counts theirs alone, so recalls are match rates."""
        arrays = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name != "truths"}
        return Pairs(**arrays, truths=len(arrays["error"]))

    @classmethod
    def join(cls, parts: Sequence["Pairs"]) -> "Pairs":
        """Of several frames, numbered in order; of none, no pairs."""
        if not parts:
            none = np.zeros(0)
            return cls(none.astype(int), none.astype(int), none, none, none, none, none, none, 0)
        arrays = {
            f.name: np.concatenate([getattr(part, f.name) for part in parts])
            for f in fields(cls)
            if f.name not in ("truths", "frame")
        }
        frame = np.concatenate([np.full(len(part), number) for number, part in enumerate(parts)])
        return cls(frame=frame, truths=sum(part.truths for part in parts), **arrays)


def pair_up(
    truth_xyxy: np.ndarray, found_xyxy: np.ndarray, least: float = PAIR_OVERLAP
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers ``(P,)`` of truths and of finds: one to one, the largest 2D overlaps first, of any class."""
    overlap = iou_2d(truth_xyxy, found_xyxy)
    rows, columns = [], []
    while overlap.size and overlap.max() >= least:
        row, column = np.unravel_index(int(overlap.argmax()), overlap.shape)
        rows.append(int(row))
        columns.append(int(column))
        overlap[row], overlap[:, column] = -1, -1
    return np.array(rows, int), np.array(columns, int)


def compare(truth: Boxes3D, predicted: Boxes3D, rows: np.ndarray, columns: np.ndarray) -> Pairs:
    """Pairs of one frame: ``truth[rows]`` against ``predicted[columns]``."""
    first, second = truth.select(rows), predicted.select(columns)
    bev, iou = box_ious(first, second)
    away = second.center - first.center
    return Pairs(
        np.zeros(len(rows), int),
        rows,
        np.linalg.norm(first.center, axis=1),
        np.linalg.norm(away, axis=1),
        away[:, 2],
        np.diagonal(bev).copy(),
        np.diagonal(iou).copy(),
        np.abs(wrap_half(second.yaw - first.yaw)),
        len(truth),
    )


def summary(pairs: Pairs) -> dict[str, float]:
    """Figures over pairs; shares and accuracy in [0, 1], lengths in meters, yaw in degrees."""
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


def by_distance(pairs: Pairs, bins: Sequence[float] = BINS) -> list[tuple[float, float, dict[str, float]]]:
    """``(from, to, summary)`` of each bin of the true distance [m].

    Without recalls and the number of truths: of truths that no pair holds the distance is not known here.
    """
    parts = []
    for low, high in pairwise(bins):
        figures = summary(pairs.select((pairs.distance >= low) & (pairs.distance < high)))
        known = {key: value for key, value in figures.items() if key != "truths" and "recall" not in key}
        parts.append((low, high, known))
    return parts


def bootstrap(
    values: np.ndarray, groups: np.ndarray, *, draws: int = 2000, share: float = 0.95, seed: int = 0
) -> tuple[float, float]:
    """Interval of a mean, drawing whole frames: objects of one frame share its errors.

    With a single frame objects are drawn instead, which is too sure of itself.

    Args:
        values: ``(P,)``, or differences of two methods on the same pairs.
        groups: ``(P,)`` frame of each.
        draws: resamples.
        share: of the resampled means that the interval holds.
        seed: of the draws.
    """
    if not len(values):
        return float("nan"), float("nan")
    names, number = np.unique(groups, return_inverse=True)
    if len(names) == 1:
        number = np.arange(len(values))
    count = int(number.max()) + 1
    total, size = np.bincount(number, values, count), np.bincount(number, minlength=count)
    return bootstrap_interval(
        lambda chosen: float(total[chosen].sum() / size[chosen].sum()),
        count,
        draws=draws,
        share=share,
        seed=seed,
    )

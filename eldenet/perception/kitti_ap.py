"""Average precision as KITTI's object benchmark defines it: 2D, from above (BEV), in space (3D).

Geiger et al., CVPR 2012; Simonelli et al., ICCV 2019 (40 recall points). Convention: R40 is the mean over the
points 1/40 ... 1 (official since October 2019), R11 over 0, 0.1 ... 1. The point at recall 0 is the precision
at the highest threshold.

Rules: an object counts at a difficulty if its 2D box is higher than the least height, and it is neither more
occluded nor more truncated than allowed; others are ignored, as are objects of a neighboring class (Van for
Car, Person_sitting for Pedestrian): neither found nor missed. Detections lower than the least height are
ignored, whatever their class, as in the benchmark's code. In 2D, detections that lie in DontCare areas are no
false positives.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from eldenet.perception.iou import box_ious, iou_2d
from eldenet.perception.kitti_object import KittiLabels

POINTS = 41
NEIGHBOR = {"car": "van", "pedestrian": "person_sitting"}


class Difficulty(NamedTuple):
    """Least 2D height [px], most occlusion and truncation that still count."""

    height: float
    occluded: int
    truncated: float


DIFFICULTIES = {
    "easy": Difficulty(40, 0, 0.15),
    "moderate": Difficulty(25, 1, 0.30),
    "hard": Difficulty(25, 2, 0.50),
}
#: Overlap needed, by class: the official one, and the looser one of BEV and 3D in much of the literature.
STRICT = {"Car": 0.7, "Pedestrian": 0.5, "Cyclist": 0.5}
LOOSE = {"Car": 0.5, "Pedestrian": 0.25, "Cyclist": 0.25}
METRICS = ("2d", "bev", "3d")


class _Frame(NamedTuple):
    overlap: np.ndarray  # (truths, detections)
    truth: np.ndarray  # 0 counts, 1 ignored
    detected: np.ndarray  # 0 counts, 1 ignored
    score: np.ndarray
    dont_care: np.ndarray  # (detections,) share of each that a DontCare area covers


def average_precision(
    truths: Sequence[KittiLabels],
    detections: Sequence[KittiLabels],
    *,
    kind: str = "Car",
    difficulty: str = "moderate",
    metric: str = "3d",
    min_overlap: float | None = None,
) -> dict[str, float]:
    """AP in percent over frames: ``{"R40": ..., "R11": ...}``; NaN where no object counts.

    Args:
        truths: labels of every frame.
        detections: results of the same frames, in the same order.
        kind: "Car", "Pedestrian" or "Cyclist".
        difficulty: "easy", "moderate" or "hard".
        metric: "2d", "bev" or "3d".
        min_overlap: IoU above which a detection fits; None: the official one.

    Raises:
        ValueError: unknown words, or lists of different lengths.
    """
    if difficulty not in DIFFICULTIES or metric not in METRICS:
        raise ValueError(
            f"difficulty={difficulty!r}, metric={metric!r}: give {list(DIFFICULTIES)}, {METRICS}"
        )
    if len(truths) != len(detections):
        raise ValueError(f"{len(truths)} frames of labels, {len(detections)} of detections")
    if min_overlap is None:
        if kind not in STRICT:
            raise ValueError(f"kind={kind!r} has no official overlap: give min_overlap")
        min_overlap = STRICT[kind]
    rules = DIFFICULTIES[difficulty]
    frames = [_prepare(t, d, kind, rules, metric) for t, d in zip(truths, detections, strict=True)]
    count = sum(int((frame.truth == 0).sum()) for frame in frames)
    if not count:
        return {"R40": float("nan"), "R11": float("nan")}
    matched = np.concatenate([_matched_scores(frame, min_overlap) for frame in frames])
    precision = np.zeros(POINTS)
    for index, threshold in enumerate(_thresholds(matched, count)):
        right, wrong = np.sum([_counts(frame, min_overlap, threshold, metric) for frame in frames], axis=0)
        precision[index] = right / max(right + wrong, 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    return {"R40": 100 * float(precision[1:].mean()), "R11": 100 * float(precision[::4].mean())}


def _prepare(truth: KittiLabels, found: KittiLabels, kind: str, rules: Difficulty, metric: str) -> _Frame:
    kinds = np.array([name.lower() for name in truth.types], dtype=object)
    areas = truth.select(kinds == "dontcare")
    related = (kinds == kind.lower()) | (kinds == NEIGHBOR.get(kind.lower(), ""))
    truth, kinds = truth.select(related), kinds[related]
    small = np.abs(found.xyxy[:, 3] - found.xyxy[:, 1]) < rules.height
    wanted = np.array([name.lower() == kind.lower() for name in found.types], bool).reshape(-1)
    found, small = found.select(wanted | small), small[wanted | small]
    too_hard = (
        (truth.xyxy[:, 3] - truth.xyxy[:, 1] <= rules.height)
        | (truth.occluded > rules.occluded)
        | (truth.truncated > rules.truncated)
    )
    ignored = too_hard | (kinds != kind.lower())
    covered = iou_2d(found.xyxy, areas.xyxy, of_first=True) if metric == "2d" else np.zeros((len(found), 0))
    if metric == "2d":
        overlap = iou_2d(truth.xyxy, found.xyxy)
    else:
        overlap = box_ious(truth.boxes, found.boxes)[METRICS.index(metric) - 1]
    dont_care = covered.max(1, initial=0.0)
    return _Frame(overlap, ignored.astype(int), small.astype(int), found.score, dont_care)


def _matched_scores(frame: _Frame, min_overlap: float) -> np.ndarray:
    """Scores of the detections that find a counted object, each object taking the highest score that fits."""
    free = np.ones(len(frame.score), bool)
    scores = []
    for row, overlap in enumerate(frame.overlap):
        fits = free & (overlap > min_overlap)
        if not fits.any():
            continue
        best = int(np.argmax(np.where(fits, frame.score, -np.inf)))
        free[best] = False
        if frame.truth[row] == 0 and frame.detected[best] == 0:
            scores.append(frame.score[best])
    return np.array(scores)


def _thresholds(scores: np.ndarray, count: int) -> list[float]:
    """Scores at which recall comes nearest to 0, 1/40, 2/40 ..."""
    scores = np.sort(scores)[::-1]
    chosen, recall = [], 0.0
    for index, score in enumerate(scores):
        here = (index + 1) / count
        after = (index + 2) / count if index < len(scores) - 1 else here
        if after - recall < recall - here and index < len(scores) - 1:
            continue
        chosen.append(float(score))
        recall += 1 / (POINTS - 1)
    return chosen


def _counts(frame: _Frame, min_overlap: float, threshold: float, metric: str) -> tuple[int, int]:
    """Right and wrong detections at a threshold: each object takes the free one that overlaps most.

    One that counts goes before one that is ignored.
    """
    free = frame.score >= threshold
    right = 0
    for row, overlap in enumerate(frame.overlap):
        fits = free & (overlap > min_overlap)
        if not fits.any():
            continue
        counted = fits & (frame.detected == 0)
        # of those too small to count the first one is taken, of the others the one that overlaps most
        best = int(np.argmax(np.where(counted, overlap, -1.0))) if counted.any() else int(np.argmax(fits))
        free[best] = False
        right += int(frame.truth[row] == 0 and frame.detected[best] == 0)
    left = free & (frame.detected == 0)
    if metric == "2d":
        left &= frame.dont_care <= min_overlap
    return right, int(left.sum())


def kitti_table(
    truths: Sequence[KittiLabels],
    detections: Sequence[KittiLabels],
    *,
    overlaps: Mapping[str, float] = STRICT,
    kinds: Sequence[str] = ("Car", "Pedestrian", "Cyclist"),
) -> list[dict[str, float | str]]:
    """One row per class, metric and difficulty: ``{"class", "metric", "difficulty", "R40", "R11"}``.

    Convention: 2D always needs the official overlap, as the benchmark's code has it.
    """
    rows: list[dict[str, float | str]] = []
    for kind in kinds:
        for metric in METRICS:
            for difficulty in DIFFICULTIES:
                overlap = STRICT[kind] if metric == "2d" else overlaps[kind]
                value = average_precision(
                    truths, detections, kind=kind, difficulty=difficulty, metric=metric, min_overlap=overlap
                )
                rows.append({"class": kind, "metric": metric, "difficulty": difficulty, **value})
    return rows

"""Average precision as KITTI's object benchmark defines it: 2D, bird's-eye view (BEV) and 3D.

Geiger et al., CVPR 2012; Simonelli et al., ICCV 2019 (40 recall points). Convention: R40 is the mean over the
points 1/40 ... 1 (official since October 2019), R11 over 0, 0.1 ... 1. The point at recall 0 is the precision
at the highest threshold. Fewer than 41 counted objects have fewer thresholds, and the points beyond them are
0: even results without a mistake then stay below 100 %.

Rules: an object counts at a difficulty if its 2D box is higher than the minimum height and the object is
neither more occluded nor more truncated than allowed. Other objects are ignored (neither found nor missed),
and so are those of a neighboring class (Van for Car, Person_sitting for Pedestrian). Detections lower than
the minimum height are ignored, whatever their class, as in the benchmark's code. In 2D, detections in
DontCare areas are not false positives.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldenet.perception.iou import box_ious, iou_2d
from eldenet.perception.kitti_object import KittiLabels, read_labels
from eldenet.system.checks import one_of

POINTS = 41
NEIGHBOR = {"car": "van", "pedestrian": "person_sitting"}


class Difficulty(NamedTuple):
    """Minimum 2D height [px], maximum occlusion and truncation of the objects that count."""

    height: float
    occluded: int
    truncated: float


DIFFICULTIES = {
    "easy": Difficulty(40, 0, 0.15),
    "moderate": Difficulty(25, 1, 0.30),
    "hard": Difficulty(25, 2, 0.50),
}
#: Required IoU by class: the official one, and the looser one for BEV and 3D in much of the literature.
STRICT = {"Car": 0.7, "Pedestrian": 0.5, "Cyclist": 0.5}
LOOSE = {"Car": 0.5, "Pedestrian": 0.25, "Cyclist": 0.25}
METRICS = ("2d", "bev", "3d")


class _Frame(NamedTuple):
    overlap: np.ndarray  # (truths, detections)
    truth_counts: np.ndarray  # (truths,) bool; the others are ignored
    found_counts: np.ndarray  # (detections,) bool
    score: np.ndarray  # (detections,)
    dont_care: np.ndarray  # (detections,) share in a DontCare area; 0 but in 2D


def average_precision(
    truths: Sequence[KittiLabels],
    detections: Sequence[KittiLabels],
    *,
    kind: str = "Car",
    difficulty: str = "moderate",
    metric: str = "3d",
    min_overlap: float | None = None,
) -> dict[str, float]:
    """AP over frames [%]: ``{"R40": ..., "R11": ...}``; NaN if no object counts.

    Args:
        truths: labels of every frame.
        detections: results of the same frames, in the same order.
        kind: "Car", "Pedestrian" or "Cyclist"; any class with ``min_overlap``.
        difficulty: "easy", "moderate" or "hard".
        metric: "2d", "bev" or "3d".
        min_overlap: IoU above which a detection matches; None: the official one.

    Raises:
        KeyError: unknown difficulty or class.
        ValueError: unknown metric, or lists of different lengths.
    """
    one_of("metric", metric, METRICS)
    overlap = STRICT[kind] if min_overlap is None else min_overlap
    rules = DIFFICULTIES[difficulty]
    frames = [_prepare(t, d, kind, rules, metric) for t, d in zip(truths, detections, strict=True)]
    count = sum(int(frame.truth_counts.sum()) for frame in frames)
    if not count:
        return {"R40": float("nan"), "R11": float("nan")}
    matched = np.concatenate([_matched_scores(frame, overlap) for frame in frames])
    precision = np.zeros(POINTS)
    for index, threshold in enumerate(_thresholds(matched, count)):
        right, wrong = np.sum([_true_and_false(frame, overlap, threshold) for frame in frames], axis=0)
        precision[index] = right / max(right + wrong, 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    return {"R40": 100 * float(precision[1:].mean()), "R11": 100 * float(precision[::4].mean())}


def precision_rows(results: Mapping[Path, Path]) -> list[list[str]]:
    """AP (R40) [%] of pictures that have labels, rows of class and metric, then easy, moderate and hard.

    Where too few objects count, a cell also says the most that they allow: "5.0 of 7.5".

    Args:
        results: picture ``.../image_2/000000.png``, whose labels are ``.../label_2/000000.txt`` -> its result
            file, as :func:`~eldenet.perception.kitti_object.write_labels` writes it.

    Raises:
        ValueError: a file is damaged.
    """
    labels = {
        picture: picture.parent.parent / "label_2" / f"{picture.stem}.txt"
        for picture in results
        if picture.parent.name == "image_2"
    }
    pairs = [(read_labels(file), read_labels(results[one])) for one, file in labels.items() if file.is_file()]
    truths, found = [truth for truth, _ in pairs], [result for _, result in pairs]
    rows = []
    for kind in STRICT if pairs else ():
        most = [
            average_precision(truths, truths, kind=kind, difficulty=difficulty, metric="2d")["R40"]
            for difficulty in DIFFICULTIES
        ]
        for metric in METRICS:
            precisions = [
                average_precision(truths, found, kind=kind, difficulty=difficulty, metric=metric)["R40"]
                for difficulty in DIFFICULTIES
            ]
            cells = [
                "-" if math.isnan(one) else f"{one:.1f}" + f" of {limit:.1f}" * (limit < 100)
                for one, limit in zip(precisions, most, strict=True)
            ]
            rows.append([f"{kind}, {metric} over {STRICT[kind]:g}", *cells])
    return rows


def _prepare(truth: KittiLabels, found: KittiLabels, kind: str, rules: Difficulty, metric: str) -> _Frame:
    kinds = np.array([name.lower() for name in truth.types], dtype=object)
    areas = truth.select(kinds == "dontcare")
    related = (kinds == kind.lower()) | (kinds == NEIGHBOR.get(kind.lower(), ""))
    truth, kinds = truth.select(related), kinds[related]
    small = np.abs(found.xyxy[:, 3] - found.xyxy[:, 1]) < rules.height
    wanted = np.array([name.lower() == kind.lower() for name in found.types], bool).reshape(-1)
    found, small = found.select(wanted | small), small[wanted | small]
    counts = (
        (kinds == kind.lower())
        & (truth.xyxy[:, 3] - truth.xyxy[:, 1] > rules.height)
        & (truth.occluded <= rules.occluded)
        & (truth.truncated <= rules.truncated)
    )
    dont_care = np.zeros(len(found))
    if metric == "2d":
        overlap = iou_2d(truth.xyxy, found.xyxy)
        dont_care = iou_2d(found.xyxy, areas.xyxy, of_first=True).max(1, initial=0.0)
    else:
        overlap = box_ious(truth.boxes, found.boxes)[METRICS.index(metric) - 1]
    return _Frame(overlap, counts, ~small, found.score, dont_care)


def _matched_scores(frame: _Frame, min_overlap: float) -> np.ndarray:
    """Scores ``(K,)`` of the detections that find a counted object; each object takes the best score."""
    free = np.ones(len(frame.score), bool)
    scores = []
    for row, overlap in enumerate(frame.overlap):
        fits = free & (overlap > min_overlap)
        if not fits.any():
            continue
        best = int(np.argmax(np.where(fits, frame.score, -np.inf)))
        free[best] = False
        if frame.truth_counts[row] and frame.found_counts[best]:
            scores.append(frame.score[best])
    return np.array(scores)


def _thresholds(scores: np.ndarray, count: int) -> list[float]:
    """Those of the scores ``(K,)`` at which recall is nearest to 0, 1/40, 2/40 ..."""
    scores = np.sort(scores)[::-1]
    chosen, recall = [], 0.0
    for index, score in enumerate(scores):
        at_score = (index + 1) / count
        at_next = (index + 2) / count if index < len(scores) - 1 else at_score
        if at_next - recall < recall - at_score and index < len(scores) - 1:
            continue
        chosen.append(float(score))
        recall += 1 / (POINTS - 1)
    return chosen


def _true_and_false(frame: _Frame, min_overlap: float, threshold: float) -> tuple[int, int]:
    """Numbers of true and false positives at a score threshold.

    Each object takes the free detection with the largest overlap; ignored detections come last.
    """
    free = frame.score >= threshold
    right = 0
    for row, overlap in enumerate(frame.overlap):
        fits = free & (overlap > min_overlap)
        if not fits.any():
            continue
        counted = fits & frame.found_counts
        # of the ignored ones the first is taken, of the others the one with the largest overlap
        best = int(np.argmax(np.where(counted, overlap, -1.0))) if counted.any() else int(np.argmax(fits))
        free[best] = False
        right += int(frame.truth_counts[row] and frame.found_counts[best])
    wrong = free & frame.found_counts & (frame.dont_care <= min_overlap)
    return right, int(wrong.sum())

"""SORT: 2D boxes alone, a constant-velocity Kalman filter and the best assignment by IoU.

Bewley et al., "Simple Online and Realtime Tracking", ICIP 2016; written from the paper.
"""

import numpy as np
from scipy.optimize import linear_sum_assignment

from eldenet.perception.iou import iou_2d

#: Chosen on training drives by ``tune_sort.py``.
TUNED = {"least_overlap": 0.01}
# state: center (u, v), area s, aspect r, and the speeds of u, v, s per frame
MOVE = np.eye(7) + np.eye(7, k=4)
NOISE = np.diag([1.0, 1.0, 1.0, 1.0, 0.01, 0.01, 0.0001])
MEASURED_NOISE = np.diag([1.0, 1.0, 10.0, 10.0])


class Sort:
    """``tracker(xyxy, labels) -> numbers (N,)`` of the detections' tracks; 0: not reported yet.

    The classes of a track do not mix. ``min_hits`` and ``max_age`` as in
    :class:`eldenet.perception.tracking.BoxTracker`. Of the others, the defaults are SORT's own:
    the least overlap of a pair (IoU), and factors of the filter's noise, of the speeds and measured.
    """

    def __init__(
        self,
        min_hits: int,
        max_age: int,
        *,
        least_overlap: float = 0.3,
        speed_noise: float = 1.0,
        measured_noise: float = 1.0,
    ) -> None:
        self.min_hits, self.max_age, self.least_overlap = min_hits, max_age, least_overlap
        self.noise = NOISE * np.array([1.0, 1.0, 1.0, 1.0, *[speed_noise] * 3])
        self.measured_noise = measured_noise * MEASURED_NOISE
        self.tracks: list[dict] = []
        self.last = self.frames = 0

    def __call__(self, xyxy: np.ndarray, labels: np.ndarray) -> np.ndarray:
        self.frames += 1
        for track in self.tracks:
            if track["mean"][2] + track["mean"][6] <= 0:
                track["mean"][6] = 0.0
            track["mean"] = MOVE @ track["mean"]
            track["covariance"] = MOVE @ track["covariance"] @ MOVE.T + self.noise
            track["missed"] += 1
        numbers = np.zeros(len(xyxy), int)
        free = set(range(len(xyxy)))
        for row, column in self._assign(xyxy, labels):
            track = self.tracks[row]
            gain = track["covariance"][:, :4] @ np.linalg.inv(
                track["covariance"][:4, :4] + self.measured_noise
            )
            track["mean"] = track["mean"] + gain @ (_state(xyxy[column]) - track["mean"][:4])
            track["covariance"] = track["covariance"] - gain @ track["covariance"][:4]
            track["hits"], track["missed"] = track["hits"] + 1, 0
            free.remove(column)
            if track["hits"] >= self.min_hits or self.frames <= self.min_hits:
                numbers[column] = track["number"]
        for column in sorted(free):
            self.last += 1
            covariance = np.diag([10.0, 10.0, 10.0, 10.0, 1e4, 1e4, 1e4])
            mean = np.concatenate([_state(xyxy[column]), np.zeros(3)])
            self.tracks.append(
                {"number": self.last, "mean": mean, "covariance": covariance, "hits": 1, "missed": 0,
                 "label": labels[column]}
            )  # fmt: skip
            if self.min_hits <= 1 or self.frames <= self.min_hits:
                numbers[column] = self.last
        self.tracks = [track for track in self.tracks if track["missed"] < self.max_age]
        return numbers

    def _assign(self, xyxy: np.ndarray, labels: np.ndarray) -> list[tuple[int, int]]:
        if not self.tracks or not len(xyxy):
            return []
        overlap = iou_2d(np.stack([_box(track["mean"]) for track in self.tracks]), xyxy)
        overlap *= np.array([track["label"] for track in self.tracks])[:, None] == labels[None]
        pairs = zip(*linear_sum_assignment(-overlap), strict=True)
        return [
            (int(row), int(column)) for row, column in pairs if overlap[row, column] >= self.least_overlap
        ]


def _state(box: np.ndarray) -> np.ndarray:
    wide, tall = np.maximum(box[2:] - box[:2], 1e-3)
    return np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2, wide * tall, wide / tall])


def _box(mean: np.ndarray) -> np.ndarray:
    wide = np.sqrt(max(mean[2] * mean[3], 1e-6))
    tall = max(mean[2], 1e-6) / wide
    return np.array([mean[0] - wide / 2, mean[1] - tall / 2, mean[0] + wide / 2, mean[1] + tall / 2])

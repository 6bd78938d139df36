"""Boxes over time: which is which, how fast it moves, and, where the camera stands still, its front.

A constant-velocity Kalman filter per object and an optimal assignment per frame, in the spirit of Weng et
al., "3D Multi-Object Tracking: A Baseline and New Evaluation Metrics", IROS 2020; written from the paper.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from eldenet.boxes import Boxes3D

_STATE = 10  # x, y, z, yaw, length, width, height, then the velocity of x, y, z
_MEASURED = 7
_FAR = 1e6  # cost of a pair that may not be
_MOVING = 1.0  # [m/s]: slower things may be noise


@dataclass
class Track:
    """One object.

    Attributes:
        number: its identity.
        name: of its class; frames may number their classes differently.
        mean: ``(10,)`` x, y, z [m], yaw [rad], length, width, height [m], velocity [m/s].
        covariance: ``(10, 10)``.
        score: of the last detection.
        hits: frames in which it was seen.
        missed: frames since it was seen.
        quality: of the last detection.
        heading_known: its motion has told its front from its back.
    """

    number: int
    name: str
    mean: np.ndarray
    covariance: np.ndarray
    score: float
    hits: int = 1
    missed: int = 0
    quality: dict[str, float] = field(default_factory=dict)
    heading_known: bool = False


class BoxTracker:
    """``tracker(boxes, seconds) -> Boxes3D`` with identities and velocities.

    Velocities are relative to the frame of the boxes: from a moving camera, a parked car comes closer. Only
    where that frame stands still (``still_camera``) do things drive where their velocity points; their yaw
    then points along it, which settles front and back, and ``quality["heading"]`` is 1.

    Args:
        gate: farthest that a box may be from where its track expects it [m].
        births: frames in which a new object must be seen before it is reported (all may be in the first
            frames).
        deaths: frames in a row after which an unseen object is given up.
        position_sigma: of a measured center at 10 m [m]; it grows with distance.
        acceleration: of the objects, standard deviation [m/s2].
        report_unseen: also report objects that this frame's detector missed.
        still_camera: the boxes' frame stands still. False: yaw stays known modulo pi.

    Raises:
        ValueError: a number out of range.
    """

    def __init__(
        self,
        *,
        gate: float = 3.0,
        births: int = 2,
        deaths: int = 5,
        position_sigma: float = 0.3,
        acceleration: float = 2.0,
        report_unseen: bool = False,
        still_camera: bool = False,
    ) -> None:
        if gate <= 0 or births < 1 or deaths < 1 or position_sigma <= 0 or acceleration <= 0:
            raise ValueError("gate, births, deaths, position_sigma and acceleration must be above 0")
        self.gate, self.births, self.deaths = gate, births, deaths
        self.position_sigma, self.acceleration, self.report_unseen = (
            position_sigma,
            acceleration,
            report_unseen,
        )
        self.still_camera = still_camera
        self.tracks: list[Track] = []
        self._next = 0
        self._frames = 0

    def __call__(self, boxes: Boxes3D, seconds: float) -> Boxes3D:
        """Add a frame that was taken ``seconds`` after the one before.

        Raises:
            ValueError: time does not go forward.
        """
        if seconds <= 0:
            raise ValueError(f"seconds={seconds}: give the time since the frame before, above 0")
        self._frames += 1
        for track in self.tracks:
            self._predict(track, seconds)
        rows, columns = self._assign(boxes)
        for row, column in zip(rows, columns, strict=True):
            self._update(self.tracks[row], boxes, column)
        for row in set(range(len(self.tracks))) - set(rows):
            self.tracks[row].missed += 1
        for column in sorted(set(range(len(boxes))) - set(columns)):
            self.tracks.append(self._begin(boxes, column))
        self.tracks = [track for track in self.tracks if track.missed < self.deaths]
        return self._report(boxes)

    def _predict(self, track: Track, seconds: float) -> None:
        move = np.eye(_STATE)
        move[[0, 1, 2], [7, 8, 9]] = seconds
        noise = np.diag([0.0] * 3 + [0.1 * seconds] + [0.01 * seconds] * 3 + [0.0] * 3) ** 2
        for axis in range(3):
            gain = np.zeros(_STATE)
            gain[axis], gain[7 + axis] = seconds**2 / 2, seconds
            noise += np.outer(gain, gain) * (self.acceleration * (0.1 if axis == 1 else 1.0)) ** 2
        track.mean = move @ track.mean
        track.covariance = move @ track.covariance @ move.T + noise

    def _assign(self, boxes: Boxes3D) -> tuple[list[int], list[int]]:
        """Pairs of tracks and boxes of one class whose centers are nearest, in total."""
        from scipy.optimize import linear_sum_assignment

        if not self.tracks or not len(boxes):
            return [], []
        expected = np.stack([track.mean[:3] for track in self.tracks])
        cost = np.linalg.norm(expected[:, None, [0, 2]] - boxes.center[None][:, :, [0, 2]], axis=-1)
        same = np.array([track.name for track in self.tracks])[:, None] == np.array(boxes.classes)[None]
        # an object is as uncertain as its track says: a young one has no velocity yet
        reach = self.gate + np.sqrt(
            [track.covariance[0, 0] + track.covariance[2, 2] for track in self.tracks]
        )
        cost = np.where(same & (cost < reach[:, None]), cost, _FAR)
        pairs = [(r, c) for r, c in zip(*linear_sum_assignment(cost), strict=True) if cost[r, c] < _FAR]
        return [int(row) for row, _ in pairs], [int(column) for _, column in pairs]

    def _noise(self, distance: float) -> np.ndarray:
        position = self.position_sigma * max(distance, 3.0) / 10
        return np.diag([position] * 3 + [0.2] + [0.3, 0.15, 0.15]) ** 2

    def _update(self, track: Track, boxes: Boxes3D, index: int) -> None:
        measured = np.array([*boxes.center[index], boxes.yaw[index], *boxes.size[index]])
        turn = measured[3] - track.mean[3]
        measured[3] = track.mean[3] + (turn + np.pi / 2) % np.pi - np.pi / 2  # front and back look alike
        noise = self._noise(float(np.linalg.norm(boxes.center[index])))
        gain = track.covariance[:, :_MEASURED] @ np.linalg.inv(
            track.covariance[:_MEASURED, :_MEASURED] + noise
        )
        track.mean = track.mean + gain @ (measured - track.mean[:_MEASURED])
        track.covariance = track.covariance - gain @ track.covariance[:_MEASURED]
        if self.still_camera and np.hypot(*track.mean[[7, 9]]) > _MOVING:
            along = np.array([np.cos(track.mean[3]), -np.sin(track.mean[3])]) @ track.mean[[7, 9]]
            track.mean[3] += np.pi * (along < 0)  # things drive forwards
            track.heading_known = True
        track.mean[3] = (track.mean[3] + np.pi) % (2 * np.pi) - np.pi
        track.hits, track.missed = track.hits + 1, 0
        track.score = float(boxes.score[index])
        track.quality = {name: float(values[index]) for name, values in boxes.quality.items()}

    def _begin(self, boxes: Boxes3D, index: int) -> Track:
        covariance = np.zeros((_STATE, _STATE))
        covariance[:_MEASURED, :_MEASURED] = self._noise(float(np.linalg.norm(boxes.center[index])))
        covariance[7:, 7:] = np.diag([10.0, 0.5, 10.0]) ** 2
        mean = np.array([*boxes.center[index], boxes.yaw[index], *boxes.size[index], 0.0, 0.0, 0.0])
        quality = {name: float(values[index]) for name, values in boxes.quality.items()}
        self._next += 1
        return Track(
            self._next, boxes.classes[index], mean, covariance, float(boxes.score[index]), quality=quality
        )

    def _report(self, boxes: Boxes3D) -> Boxes3D:
        shown = [
            track
            for track in self.tracks
            if (track.hits >= self.births or self._frames <= self.births)
            and (self.report_unseen or not track.missed)
        ]
        if not shown:
            return replace(Boxes3D.empty(boxes.names), track_id=np.zeros(0, int), velocity=np.zeros((0, 3)))
        mean = np.stack([track.mean for track in shown])
        names = tuple(dict.fromkeys([*boxes.names, *(track.name for track in shown)]))  # also of the unseen
        return Boxes3D(
            center=mean[:, :3],
            size=np.maximum(mean[:, 4:7], 0.01),
            yaw=mean[:, 3],
            score=np.array([track.score for track in shown]),
            label=np.array([names.index(track.name) for track in shown], np.int64),
            names=names,
            quality={
                name: np.array([track.quality.get(name, np.nan) for track in shown]) for name in boxes.quality
            }
            | {"heading": np.array([float(track.heading_known) for track in shown])},
            track_id=np.array([track.number for track in shown]),
            velocity=mean[:, 7:],
        )

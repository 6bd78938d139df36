"""Boxes over time: identities, velocities and, for a camera that stands still, headings.

A constant-velocity Kalman filter per object and an optimal assignment per frame, following Weng et al., "3D
Multi-Object Tracking: A Baseline and New Evaluation Metrics", IROS 2020; written from the paper. A detection
belongs to the track whose 2D box overlaps it most; the distance in bird's-eye view counts little, for depth
is often wrong where the 2D box is right. Where no 2D box overlaps, the distance alone counts.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from eldenet.boxes import Boxes3D, wrap_half
from eldenet.perception.iou import iou_2d

_STATE = 10  # x, y, z, yaw, length, width, height, then the velocity of x, y, z
_MEASURED = 7
_UNPAIRED = 1.0  # cost of a pair that is not allowed: a higher one would break up good pairs
_MOVING = 1.0  # [m/s]: a lower speed may be noise
_LEAST_OVERLAP = 0.2  # of a track's 2D box with a detection: with less, only the distance counts
_ALONE = 0.5  # least cost of a pair whose 2D boxes do not overlap
_BEV_SHARE = 0.1  # share of the distance in the cost of a pair whose 2D boxes overlap
_SMOOTHING, _SPEED_SMOOTHING = 0.7, 0.3  # shares of a 2D box's surprise that move its place, its speed


@dataclass
class Track:
    """One object.

    Attributes:
        number: its identity.
        name: of its class; labels may differ between frames.
        mean: ``(10,)`` x, y, z [m], yaw [rad], length, width, height [m], velocity [m/s].
        covariance: ``(10, 10)``.
        score: of the last detection.
        hits: frames in which it was detected.
        missed: frames since the last detection.
        unseen: seconds since the last detection.
        quality: of the last detection.
        heading_known: its motion has shown where its front is.
        xyxy: ``(4,)`` its 2D box [px]; None: not known.
        xyxy_speed: ``(2,)`` of that box's center [px/s].
    """

    number: int
    name: str
    mean: np.ndarray
    covariance: np.ndarray
    score: float
    hits: int = 1
    missed: int = 0
    unseen: float = 0.0
    quality: dict[str, float] = field(default_factory=dict)
    heading_known: bool = False
    xyxy: np.ndarray | None = None
    xyxy_speed: np.ndarray = field(default_factory=lambda: np.zeros(2))


@dataclass(eq=False, kw_only=True)
class BoxTracker:
    """``tracker(boxes, seconds, xyxy) -> Boxes3D`` with identities and velocities.

    Velocities are relative to the frame of the boxes: from a moving camera, a parked car approaches. Only
    if that frame stands still (``still_camera``) do objects drive where their velocity points; their yaw then
    points along it, which tells front from back, and ``quality["heading"]`` is 1.

    Args:
        max_distance: from a detection to the predicted center of its track [m].
        min_hits: frames in which a new object must be detected before it is reported. The first
            ``min_hits`` frames report all.
        max_age: frames in a row without a detection after which a track is deleted.
        position_sigma: of a measured center at 10 m [m]; it grows with distance.
        acceleration: of the objects, standard deviation [m/s2].
        report_unseen: also report tracks that have no detection in this frame.
        still_camera: the frame of the boxes stands still. False: yaw stays known modulo pi.
    """

    max_distance: float = 3.0
    min_hits: int = 2
    max_age: int = 5
    position_sigma: float = 0.3
    acceleration: float = 2.0
    report_unseen: bool = False
    still_camera: bool = False

    def __post_init__(self) -> None:
        self.tracks: list[Track] = []
        self._last_number = 0
        self._frames = 0

    def __call__(self, boxes: Boxes3D, seconds: float, xyxy: np.ndarray | None = None) -> Boxes3D:
        """Add the boxes of a frame, taken ``seconds`` after the previous one.

        Args:
            xyxy: ``(N, 4)`` their 2D boxes [px]; None: only distances associate them.

        Raises:
            ValueError: ``seconds`` is not above 0.
        """
        if not 0 < seconds < np.inf:
            raise ValueError(f"seconds={seconds}: give the time since the previous frame, above 0")
        self._frames += 1
        for track in self.tracks:
            self._predict(track, seconds)
            track.missed, track.unseen = track.missed + 1, track.unseen + seconds
        unassigned = set(range(len(boxes)))
        for row, column in self._assign(boxes, xyxy):
            if xyxy is not None:
                _follow(self.tracks[row], xyxy[column])
            self._update(self.tracks[row], boxes, column)
            unassigned.remove(column)
        for column in sorted(unassigned):
            self.tracks.append(self._begin(boxes, column))
            if xyxy is not None:
                self.tracks[-1].xyxy = np.array(xyxy[column], np.float64)
        self.tracks = [track for track in self.tracks if track.missed < self.max_age]
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
        if track.xyxy is not None:
            track.xyxy = track.xyxy + np.tile(track.xyxy_speed, 2) * seconds

    def _assign(self, boxes: Boxes3D, xyxy: np.ndarray | None) -> list[tuple[int, int]]:
        """Index pairs of tracks and boxes (2D: ``(N, 4)``) of one class with the least total cost.

        The cost is the distance as a share of the reach. Where 2D boxes overlap, their overlap counts most.
        """
        from scipy.optimize import linear_sum_assignment

        if not self.tracks or not len(boxes):
            return []
        expected = np.stack([track.mean[:3] for track in self.tracks])
        distance = np.linalg.norm(expected[:, None, [0, 2]] - boxes.center[None][:, :, [0, 2]], axis=-1)
        same = np.array([track.name for track in self.tracks])[:, None] == np.array(boxes.classes)[None]
        # the reach grows with the track's uncertainty: a new track has no velocity yet
        variance = [track.covariance[0, 0] + track.covariance[2, 2] for track in self.tracks]
        reach = (self.max_distance + np.sqrt(variance))[:, None]
        share = distance / reach
        allowed = same & (share < 1)
        cost = share
        if xyxy is not None:
            nowhere = np.full(4, -1e6)
            overlap = iou_2d(np.stack([nowhere if t.xyxy is None else t.xyxy for t in self.tracks]), xyxy)
            # however far away: the depth of a half hidden object may be another's
            seen = same & (overlap >= _LEAST_OVERLAP)
            mixed = (1 - _BEV_SHARE) * (1 - overlap) + _BEV_SHARE * np.minimum(share, 1)
            cost = np.where(seen, mixed, _ALONE + (1 - _ALONE) * share)
            allowed |= seen
        cost = np.where(allowed, cost, _UNPAIRED)
        pairs = np.stack(linear_sum_assignment(cost), axis=1).tolist()
        return [(row, column) for row, column in pairs if allowed[row, column]]

    def _noise(self, distance: float) -> np.ndarray:
        """Covariance ``(7, 7)`` of a box measured at a distance [m]."""
        position = self.position_sigma * max(distance, 3.0) / 10
        return np.diag([position] * 3 + [0.2] + [0.3, 0.15, 0.15]) ** 2

    def _update(self, track: Track, boxes: Boxes3D, index: int) -> None:
        measured = np.array([*boxes.center[index], boxes.yaw[index], *boxes.size[index]])
        measured[3] = track.mean[3] + wrap_half(measured[3] - track.mean[3])
        noise = self._noise(float(np.linalg.norm(boxes.center[index])))
        # the same box with length and width swapped, a quarter turn away: a square one is found either way
        turned = measured[[0, 1, 2, 3, 5, 4, 6]]
        turned[3] -= np.copysign(np.pi / 2, measured[3] - track.mean[3])
        either = np.stack([measured, turned])
        surprise = ((either - track.mean[:_MEASURED]) ** 2 / np.diag(noise)).sum(1)
        measured = either[surprise.argmin()]
        gain = track.covariance[:, :_MEASURED] @ np.linalg.inv(
            track.covariance[:_MEASURED, :_MEASURED] + noise
        )
        track.mean = track.mean + gain @ (measured - track.mean[:_MEASURED])
        track.covariance = track.covariance - gain @ track.covariance[:_MEASURED]
        if self.still_camera and np.hypot(*track.mean[[7, 9]]) > _MOVING:
            along = np.array([np.cos(track.mean[3]), -np.sin(track.mean[3])]) @ track.mean[[7, 9]]
            track.mean[3] += np.pi * (along < 0)  # objects drive forward
            track.heading_known = True
        track.mean[3] = (track.mean[3] + np.pi) % (2 * np.pi) - np.pi
        track.hits, track.missed, track.unseen = track.hits + 1, 0, 0.0
        track.score, track.quality = boxes[index].score, boxes[index].quality

    def _begin(self, boxes: Boxes3D, index: int) -> Track:
        covariance = np.zeros((_STATE, _STATE))
        covariance[:_MEASURED, :_MEASURED] = self._noise(float(np.linalg.norm(boxes.center[index])))
        covariance[7:, 7:] = np.diag([10.0, 0.5, 10.0]) ** 2
        mean = np.array([*boxes.center[index], boxes.yaw[index], *boxes.size[index], 0.0, 0.0, 0.0])
        self._last_number += 1
        box = boxes[index]
        return Track(self._last_number, box.name, mean, covariance, box.score, quality=box.quality)

    def _report(self, boxes: Boxes3D) -> Boxes3D:
        shown = [
            track
            for track in self.tracks
            if (track.hits >= self.min_hits or self._frames <= self.min_hits)
            and (self.report_unseen or not track.missed)
        ]
        if not shown:
            return replace(Boxes3D.empty(boxes.names), track_id=np.zeros(0, int), velocity=np.zeros((0, 3)))
        mean = np.stack([track.mean for track in shown])
        names = tuple(dict.fromkeys([*boxes.names, *(track.name for track in shown)]))  # of unseen tracks too
        known = dict.fromkeys(name for track in shown for name in track.quality)
        quality = {name: np.array([track.quality.get(name, np.nan) for track in shown]) for name in known}
        quality["heading"] = np.array([float(track.heading_known) for track in shown])
        return Boxes3D(
            center=mean[:, :3],
            size=np.maximum(mean[:, 4:7], 0.01),
            yaw=mean[:, 3],
            score=np.array([track.score for track in shown]),
            label=np.array([names.index(track.name) for track in shown], np.int64),
            names=names,
            quality=quality,
            track_id=np.array([track.number for track in shown]),
            velocity=mean[:, 7:],
        )


def _follow(track: Track, measured: np.ndarray) -> None:
    """Move a track's 2D box toward the ``measured (4,)`` one: an alpha-beta filter of its center."""
    if track.xyxy is None:
        track.xyxy = np.array(measured, np.float64)
        return
    surprise = measured - track.xyxy
    share = 1.0 if track.hits == 1 else _SPEED_SMOOTHING  # the second detection shows the first speed
    track.xyxy = track.xyxy + _SMOOTHING * surprise
    shift = (surprise[:2] + surprise[2:]) / 2
    track.xyxy_speed = track.xyxy_speed + share * shift / track.unseen

"""Boxes: what a 2D detector says (:class:`Detections2D`), and upright boxes in meters (:class:`Boxes3D`).

Convention: KITTI's (Geiger et al., CVPR 2012). x right, y down, z forward; a box stands upright, ``yaw``
turns it about y and is 0 where its length runs along x: length axis ``(cos, 0, -sin)``, width axis
``(sin, 0, cos)``. KITTI's "location" is :attr:`Boxes3D.bottom_center`.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from eldenet.geometry import PinholeCamera, to_corner

#: "tight": around what is seen (COCO's detectors); "projected": around the box's eight corners (KITTI).
BoxStyle = Literal["tight", "projected"]

# Corners in units of (length, height, width): four below, then the same four above; 0 and 1 are in front.
UNIT_CORNERS = np.array(
    [
        (0.5, 0.5, 0.5), (0.5, 0.5, -0.5), (-0.5, 0.5, -0.5), (-0.5, 0.5, 0.5),
        (0.5, -0.5, 0.5), (0.5, -0.5, -0.5), (-0.5, -0.5, -0.5), (-0.5, -0.5, 0.5),
    ]
)  # fmt: skip
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
FRONT_FACE = (0, 1, 5, 4)


@dataclass(frozen=True)
class Detections2D:
    """Objects of one picture, as arrays.

    Convention: 2D boxes are what the object covers, from border to border, in the pixel coordinates of
    :mod:`eldenet.geometry`: pixel centers lie on whole numbers, so a box around the pixels a to b reaches
    from a - 0.5 to b + 0.5, and a picture of W columns from -0.5 to W - 0.5. Detectors, COCO, YOLO and
    supervision count from the picture's corner instead: :func:`eldenet.geometry.from_corner`. KITTI's labels
    are projections with whole-numbered pixel centers and stay as they are.

    Attributes:
        xyxy: ``(N, 4)`` left, top, right, bottom [px of the picture], see above.
        score: ``(N,)`` in [0, 1].
        label: ``(N,)`` number in ``names``.
        names: of the classes.
        box_style: see :data:`BoxStyle`.
        mask: ``(N, H, W)`` bool, or None: used instead of the box where given.
        track_id: ``(N,)``, or None.

    Raises:
        ValueError: arrays of different lengths, labels without a name, boxes or scores that are not finite,
            boxes whose right or lower edge comes before the other.
    """

    xyxy: np.ndarray
    score: np.ndarray
    label: np.ndarray
    names: tuple[str, ...]
    box_style: BoxStyle = "tight"
    mask: np.ndarray | None = None
    track_id: np.ndarray | None = None

    def __post_init__(self) -> None:
        count = len(self.score)
        if self.xyxy.shape != (count, 4) or self.label.shape != (count,) or self.score.shape != (count,):
            raise ValueError(
                f"xyxy {self.xyxy.shape}, score {self.score.shape}, label {self.label.shape}: give (N, 4), "
                "(N,), (N,)"
            )
        if count and not (self.label.min() >= 0 and self.label.max() < len(self.names)):
            raise ValueError(f"labels up to {self.label.max()}, but {len(self.names)} class names")
        if not np.isfinite(self.xyxy).all():
            raise ValueError("boxes with coordinates that are not finite")
        if not np.isfinite(self.score).all():
            raise ValueError("scores that are not finite")
        wrong = np.nonzero((self.xyxy[:, 2:] < self.xyxy[:, :2]).any(1))[0]
        if len(wrong):
            raise ValueError(
                f"box {wrong[0]} is {self.xyxy[wrong[0]].tolist()}: give left, top, right, bottom, "
                "left <= right and top <= bottom"
            )
        if self.box_style not in ("tight", "projected"):
            raise ValueError(f"box_style={self.box_style!r}: give 'tight' or 'projected'")
        for name, extra in (("mask", self.mask), ("track_id", self.track_id)):
            if extra is not None and len(extra) != count:
                raise ValueError(f"{len(extra)} entries of {name} for {count} boxes")

    def __len__(self) -> int:
        return len(self.score)

    @classmethod
    def empty(cls, names: tuple[str, ...] = (), box_style: BoxStyle = "tight") -> "Detections2D":
        """No object."""
        return cls(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64), names, box_style)

    @property
    def classes(self) -> list[str]:
        """Class name of every object."""
        return [self.names[label] for label in self.label]

    def select(self, chosen: np.ndarray) -> "Detections2D":
        """Those that ``chosen`` (bool or numbers) picks."""
        return replace(
            self,
            xyxy=self.xyxy[chosen],
            score=self.score[chosen],
            label=self.label[chosen],
            mask=None if self.mask is None else self.mask[chosen],
            track_id=None if self.track_id is None else self.track_id[chosen],
        )

    def to_supervision(self) -> Any:
        """As ``supervision.Detections`` (``pip install supervision``), its pixels counted from the corner."""
        import supervision

        return supervision.Detections(
            xyxy=to_corner(self.xyxy).astype(np.float32),
            confidence=np.asarray(self.score, np.float32),
            class_id=np.asarray(self.label, np.int64),
            mask=self.mask,
            tracker_id=self.track_id,
            data={"class_name": np.array(self.classes)},
        )


@dataclass(frozen=True)
class Box3D:
    """One box; see :class:`Boxes3D` for the units."""

    center: np.ndarray
    size: np.ndarray
    yaw: float
    name: str
    score: float
    quality: dict[str, float]

    @property
    def distance(self) -> float:
        """Of the center from the origin, on the ground [m]."""
        return float(np.hypot(self.center[0], self.center[2]))


@dataclass(frozen=True)
class Boxes3D:
    """Upright boxes of one picture, as arrays; ``boxes[i]`` is one :class:`Box3D`.

    Attributes:
        center: ``(N, 3)`` mean of the eight vertices [m] (paper, equation 3).
        size: ``(N, 3)`` length, width, height [m].
        yaw: ``(N,)`` [rad]. From geometry it is known modulo pi: front and back look alike.
        score: ``(N,)`` of the detector.
        label: ``(N,)`` number in ``names``.
        names: of the classes.
        quality: what is known of each box's making, ``(N,)`` arrays: ``points`` (foreground pixels used),
            ``depth_scale`` (factor on the depth that fits best), ``truncated``, ``occluded`` (share of its
            2D box), ``fallback`` (1 where the method could not be used), ``cost`` (of the fit); of tracks
            ``heading`` (1 where front and back are known).
        track_id: ``(N,)``, or None.
        velocity: ``(N, 3)`` [m/s], or None: from tracking.
    """

    center: np.ndarray
    size: np.ndarray
    yaw: np.ndarray
    score: np.ndarray
    label: np.ndarray
    names: tuple[str, ...]
    quality: dict[str, np.ndarray] = field(default_factory=dict)
    track_id: np.ndarray | None = None
    velocity: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.yaw)

    def __getitem__(self, index: int) -> Box3D:
        quality = {name: float(values[index]) for name, values in self.quality.items()}
        return Box3D(
            self.center[index],
            self.size[index],
            float(self.yaw[index]),
            self.names[self.label[index]],
            float(self.score[index]),
            quality,
        )

    @classmethod
    def empty(cls, names: tuple[str, ...] = ()) -> "Boxes3D":
        """No box."""
        none = np.zeros(0)
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), none, none, np.zeros(0, np.int64), names)

    @property
    def classes(self) -> list[str]:
        """Class name of every box."""
        return [self.names[label] for label in self.label]

    @property
    def corners(self) -> np.ndarray:
        """``(N, 8, 3)`` vertices [m], in the order of :data:`UNIT_CORNERS`."""
        return corners_of(self.center, self.size, self.yaw)

    @property
    def bottom_center(self) -> np.ndarray:
        """``(N, 3)`` middle of the lower face [m]: KITTI's location."""
        return self.center + self.size[:, [2]] * np.array([0.0, 0.5, 0.0])

    @property
    def top_center(self) -> np.ndarray:
        """``(N, 3)`` mean of the four upper vertices [m]: equation 3, read literally."""
        return self.center - self.size[:, [2]] * np.array([0.0, 0.5, 0.0])

    @property
    def bev(self) -> np.ndarray:
        """``(N, 5)`` footprint: x, z, length, width [m], yaw [rad]."""
        return np.column_stack([self.center[:, [0, 2]], self.size[:, :2], self.yaw])

    @property
    def nearest(self) -> np.ndarray:
        """``(N,)`` distance from the origin to the footprint, on the ground [m]: what one would hit first."""
        x, z, length, width, yaw = self.bev.T
        along, across = axes_of(yaw)[:, :, [0, 2]].transpose(1, 0, 2)
        origin = -np.stack([x, z], axis=1)
        reach = np.stack([np.abs((origin * axis).sum(1)) for axis in (along, across)], axis=1)
        outside = np.maximum(reach - np.stack([length, width], axis=1) / 2, 0.0)
        return np.asarray(np.hypot(outside[:, 0], outside[:, 1]))

    def select(self, chosen: np.ndarray) -> "Boxes3D":
        """Those that ``chosen`` (bool or numbers) picks."""
        return replace(
            self,
            center=self.center[chosen],
            size=self.size[chosen],
            yaw=self.yaw[chosen],
            score=self.score[chosen],
            label=self.label[chosen],
            quality={name: values[chosen] for name, values in self.quality.items()},
            track_id=None if self.track_id is None else self.track_id[chosen],
            velocity=None if self.velocity is None else self.velocity[chosen],
        )

    def project(self, camera: PinholeCamera, size: tuple[int, int], near: float = 0.1) -> np.ndarray:
        """``(N, 4)`` 2D boxes around the corners, cut at ``near`` and at a picture of ``(height, width)``.

        NaN for a box of which nothing is in the picture: behind the camera, or beside the view.
        """
        boxes = np.full((len(self), 4), np.nan)
        for index, corners in enumerate(camera.to_camera(self.corners)):
            ends = clipped_edges(corners, near).reshape(-1, 3)
            if len(ends):
                pixels = ((ends / ends[:, 2:]) @ camera.intrinsics.T)[:, :2]
                limits = np.array([size[1] - 1, size[0] - 1])
                low, high = pixels.min(0), pixels.max(0)
                if (low < limits).all() and (high > 0).all():
                    boxes[index] = (*np.clip(low, 0, limits), *np.clip(high, 0, limits))
        return boxes


def axes_of(yaw: np.ndarray) -> np.ndarray:
    """Unit length and width axes ``(N, 2, 3)`` of boxes with ``yaw (N,)``."""
    c, s, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    return np.stack([np.stack([c, zero, -s], -1), np.stack([s, zero, c], -1)], axis=-2)


def corners_of(center: np.ndarray, size: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Vertices ``(N, 8, 3)`` [m] of boxes: ``center (N, 3)``, ``size (N, 3)`` l, w, h, ``yaw (N,)``."""
    along, across = axes_of(np.asarray(yaw)).transpose(1, 0, 2)
    unit, size = UNIT_CORNERS[None], np.asarray(size)[:, None]
    return np.asarray(
        np.asarray(center)[:, None]
        + unit[..., :1] * size[..., :1] * along[:, None]
        + unit[..., 2:] * size[..., 1:2] * across[:, None]
        + unit[..., 1:2] * size[..., 2:] * np.array([0.0, 1.0, 0.0])
    )


def clipped_edges(corners: np.ndarray, near: float) -> np.ndarray:
    """The twelve edges ``(E, 2, 3)`` of camera ``corners (8, 3)``, cut at ``z = near`` [m]; E <= 12."""
    edges = corners[np.array(EDGES)]
    start, end = edges[:, 0], edges[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = ((near - start[:, 2]) / (end[:, 2] - start[:, 2]))[:, None]
        cut = start + share * (end - start)
    front, back = start[:, 2:] >= near, end[:, 2:] >= near
    kept = (front | back)[:, 0]
    clipped = np.stack([np.where(front, start, cut), np.where(back, end, cut)], axis=1)
    return np.asarray(clipped[kept])


def wrap_half(yaw: np.ndarray) -> np.ndarray:
    """Angles modulo pi, in [-pi/2, pi/2): where front and back look alike."""
    return np.asarray((np.asarray(yaw) + np.pi / 2) % np.pi - np.pi / 2)

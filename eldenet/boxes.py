"""Boxes: the output of a 2D detector (:class:`Detections2D`), and upright boxes in meters (:class:`Boxes3D`).

Convention: KITTI's (Geiger et al., CVPR 2012). x right, y down, z forward; a box stands upright, ``yaw``
rotates it about y and is 0 if its length lies along x: length axis ``(cos, 0, -sin)``, width axis
``(sin, 0, cos)``. KITTI's "location" is :attr:`Boxes3D.bottom_center`.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np

from eldenet.geometry import PinholeCamera, to_corner
from eldenet.system.checks import one_of
from eldenet.system.extras import require

#: "tight": around the visible object (COCO's detectors); "projected": around the eight corners (KITTI).
BoxStyle = Literal["tight", "projected"]

# Corners in units of (length, height, width): four at the bottom, the same at the top; 0 and 1 are in front.
UNIT_CORNERS = np.array(
    [
        (0.5, 0.5, 0.5), (0.5, 0.5, -0.5), (-0.5, 0.5, -0.5), (-0.5, 0.5, 0.5),
        (0.5, -0.5, 0.5), (0.5, -0.5, -0.5), (-0.5, -0.5, -0.5), (-0.5, -0.5, 0.5),
    ]
)  # fmt: skip
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
FRONT_FACE = (0, 1, 5, 4)
NEAR = 0.1  # [m]: edges are cut at this depth


class ArrayRows:
    """A frozen dataclass of arrays over the same N rows (and of values that hold for all rows)."""

    def select(self, chosen: np.ndarray | slice) -> Self:
        """The rows that ``chosen (N,)`` bool, indices or a slice picks."""
        arrays = {name: value[chosen] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)  # type: ignore[type-var]


@dataclass(frozen=True)
class Detections2D(ArrayRows):
    """Detected objects of one image, as arrays.

    Convention: a 2D box covers an object from border to border, in the pixel coordinates of
    :mod:`eldenet.geometry`: pixel centers are whole numbers, so a box around the pixels a to b reaches from
    a - 0.5 to b + 0.5, and an image of W columns from -0.5 to W - 0.5. Detectors, COCO, YOLO and supervision
    count from the image corner instead: :func:`eldenet.geometry.from_corner` converts. KITTI's labels are
    projections in coordinates with whole-numbered pixel centers and need no conversion.

    Attributes:
        xyxy: ``(N, 4)`` left, top, right, bottom [px], see above.
        score: ``(N,)`` in [0, 1].
        label: ``(N,)`` index into ``names``.
        names: of the classes.
        box_style: see :data:`BoxStyle`.
        mask: ``(N, H, W)`` bool: the object's pixels; None: all of the box but those in nearer boxes.
        track_id: ``(N,)``, or None.

    Raises:
        ValueError: ``xyxy``, ``score`` and ``label`` differ in length, a label is no whole number or has no
            name, a box or score is not finite, the right or lower edge of a box comes first, or
            ``box_style`` is unknown.
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
        if count and self.label.dtype.kind not in "iu":
            raise ValueError(f"labels are {self.label.dtype}: give whole numbers, their places in names")
        if count and not 0 <= self.label.min() <= self.label.max() < len(self.names):
            raise ValueError(
                f"labels {self.label.min()} to {self.label.max()}, but {len(self.names)} class names: give "
                "labels from 0, and name every class"
            )
        if not (np.isfinite(self.xyxy).all() and np.isfinite(self.score).all()):
            raise ValueError("boxes or scores are not finite: remove such detections")
        wrong = self.xyxy[(self.xyxy[:, 2:] < self.xyxy[:, :2]).any(1)]
        if len(wrong):
            raise ValueError(
                f"box {wrong[0].tolist()}: give left, top, right, bottom with left <= right and top <= bottom"
            )
        one_of("box_style", self.box_style, ("tight", "projected"))

    def __len__(self) -> int:
        return len(self.score)

    @classmethod
    def empty(cls, names: tuple[str, ...] = (), box_style: BoxStyle = "tight") -> "Detections2D":
        """No objects."""
        return cls(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64), names, box_style)

    @property
    def classes(self) -> list[str]:
        """Class names of the objects."""
        return [self.names[label] for label in self.label]

    def to_supervision(self) -> Any:
        """Convert to ``supervision.Detections`` (``pip install -e '.[viz]'``), with corner pixels."""
        require("to_supervision", "supervision")
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
        """Distance from the origin to the center on the ground [m]."""
        return float(np.hypot(self.center[0], self.center[2]))

    @property
    def interval(self) -> tuple[float, float] | None:
        """Low and high end of the distance [m]; None: the depth had no sigma."""
        low, high = (self.quality.get(f"distance_{end}", np.nan) for end in ("low", "high"))
        return (low, high) if np.isfinite([low, high]).all() else None


@dataclass(frozen=True)
class Boxes3D(ArrayRows):
    """Upright boxes of one image, as arrays; ``boxes[i]`` is one :class:`Box3D`.

    Attributes:
        center: ``(N, 3)`` mean of the eight vertices [m] (our reading of the paper's equation 3).
        size: ``(N, 3)`` length, width, height [m].
        yaw: ``(N,)`` [rad]. Geometry shows it modulo pi only: front and back look alike.
        score: ``(N,)`` of the detector.
        label: ``(N,)`` index into ``names``.
        names: of the classes.
        quality: ``(N,)`` arrays on how each box was found: ``points`` (foreground pixels used),
            ``depth_scale`` (fitted factor on the depth), ``truncated`` (1 if the image border cuts its 2D
            box), ``occluded`` (share of its 2D box that nearer ones cover), ``fallback`` (1 if the method
            could not be used), ``cost`` (of the fit), ``doubtful`` (1 if its cues contradict each other, or
            nothing tells its distance); for tracks ``heading`` (1 if front and back are known); for depth
            with sigma ``distance_low`` and ``distance_high`` [m], the interval of the distance.
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
        name = self.names[self.label[index]]
        yaw, score = float(self.yaw[index]), float(self.score[index])
        return Box3D(self.center[index], self.size[index], yaw, name, score, quality)

    @classmethod
    def empty(cls, names: tuple[str, ...] = ()) -> "Boxes3D":
        """No boxes."""
        none = np.zeros(0)
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), none, none, np.zeros(0, np.int64), names)

    @property
    def classes(self) -> list[str]:
        """Class names of the boxes."""
        return [self.names[label] for label in self.label]

    @property
    def doubtful(self) -> np.ndarray:
        """``(N,)`` bool: the cues of the box contradict each other, or nothing tells its distance."""
        return np.asarray(self.quality.get("doubtful", np.zeros(len(self))) == 1)

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
        """``(N,)`` distance on the ground from the origin to the footprint [m]."""
        x, z, length, width, yaw = self.bev.T
        along, across = axes_of(yaw)[:, :, [0, 2]].transpose(1, 0, 2)
        origin = -np.stack([x, z], axis=1)
        reach = np.stack([np.abs((origin * axis).sum(1)) for axis in (along, across)], axis=1)
        outside = np.maximum(reach - np.stack([length, width], axis=1) / 2, 0.0)
        return np.asarray(np.hypot(outside[:, 0], outside[:, 1]))

    def select(self, chosen: np.ndarray | slice) -> Self:
        """The boxes that ``chosen (N,)`` bool, indices or a slice picks."""
        quality = {name: values[chosen] for name, values in self.quality.items()}
        return replace(super().select(chosen), quality=quality)

    def project(self, camera: PinholeCamera, size: tuple[int, int]) -> np.ndarray:
        """2D boxes ``(N, 4)`` [px] around what lies in front of the camera, cut to an image of ``size``.

        ``size`` is ``(height, width)`` [px]. NaN for a box outside the image: behind the camera, or beside
        the view.
        """
        boxes = np.full((len(self), 4), np.nan)
        for index, corners in enumerate(camera.to_camera(self.corners)):
            ends = clipped_edges(corners).reshape(-1, 3)
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
    along, across = axes_of(yaw).transpose(1, 0, 2)
    unit, size = UNIT_CORNERS[None], size[:, None]
    return np.asarray(
        center[:, None]
        + unit[..., :1] * size[..., :1] * along[:, None]
        + unit[..., 2:] * size[..., 1:2] * across[:, None]
        + unit[..., 1:2] * size[..., 2:] * np.array([0.0, 1.0, 0.0])
    )


def clipped_edges(corners: np.ndarray) -> np.ndarray:
    """The twelve edges ``(E, 2, 3)`` of camera ``corners (8, 3)``, cut at ``z = NEAR``; E <= 12."""
    edges = corners[np.array(EDGES)]
    start, end = edges[:, 0], edges[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = ((NEAR - start[:, 2]) / (end[:, 2] - start[:, 2]))[:, None]
        cut = start + share * (end - start)
    front, back = start[:, 2:] >= NEAR, end[:, 2:] >= NEAR
    kept = (front | back)[:, 0]
    clipped = np.stack([np.where(front, start, cut), np.where(back, end, cut)], axis=1)
    return np.asarray(clipped[kept])


def wrap_half(yaw: np.ndarray) -> np.ndarray:
    """Wrap angles ``(N,)`` modulo pi to [-pi/2, pi/2): front and back are the same."""
    return np.asarray((yaw + np.pi / 2) % np.pi - np.pi / 2)

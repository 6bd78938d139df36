"""3D boxes from the pixels of N objects: our reading of the paper's equations, the L-shape, and the fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldenet.boxes import ArrayRows, Detections2D
from eldenet.geometry import PinholeCamera
from eldenet.perception import box_fit, lshape
from eldenet.perception.foreground import Foreground, expected_depth
from eldenet.perception.ground import GroundPlane
from eldenet.perception.priors import ClassPrior, silhouette

UNSURE = 0.12  # depth error of an object beyond which its points are worth ``UNSURE_WORTH``
#: Independent measurements by shape, for depth of slim and small things is partly the background's:
#: experiments/table4_centres/unsure.md, chosen on rendered training scenes.
UNSURE_WORTH = {"vehicle": 10.0, "upright": 0.3, "box": 0.3}
MIN_POINTS = 20  # per object: with fewer, its sides do not show its heading
_CHUNK = 64  # objects solved together
_UNKNOWN_CLASS = ClassPrior((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), "box")
_INSIDE = {"vehicle": 0.30, "upright": 0.12, "box": 0.0}  # [m]: how far a surface may lie inside its box
_OUTSIDE = {"vehicle": 0.0, "upright": 0.12, "box": 0.0}  # [m]: and how far outside
_FILL = {"vehicle": 1.0, "upright": 0.5, "box": 1.0}  # a body is slimmer than the reach of its arms and legs
_STARTS = 4
_PIXEL_SHARE = 0.5  # of the depth error differs between pixels of an object; the depth factor takes all of it
_WORTH = 10.0  # independent measurements that the points of an object are worth
_HANGING = 0.5  # [m] above the ground: an object of an unknown class that ends there does not stand on it
_MISPLACED = 0.25  # of the distance: points may be this far from where the object's image size puts it


@dataclass(frozen=True)
class ObjectEvidence(ArrayRows):
    """What an image shows of N objects, and what is known about them beforehand.

    Attributes:
        foreground: the pixels of each object.
        detections: 2D boxes and classes.
        camera: of the image.
        priors: of each class; None for an unknown class.
        plane: the ground.
        nominal: the ground according to the camera's height, if ``plane`` is another.
        trusted: ``(N, 4)`` bool: edges of the 2D boxes that are the object's own.
        depth_sigma: ``(N,)`` relative depth error of each object.
        plane_sigma: relative depth error of the ground.
    """

    foreground: Foreground
    detections: Detections2D
    camera: PinholeCamera
    priors: Sequence[ClassPrior | None]
    plane: GroundPlane | None
    nominal: GroundPlane | None
    trusted: np.ndarray
    depth_sigma: np.ndarray
    plane_sigma: float

    @property
    def size(self) -> np.ndarray:
        """``(N, 3)`` of the classes [m]; NaN for an unknown one."""
        return np.array([prior.size if prior else (np.nan,) * 3 for prior in self.priors]).reshape(-1, 3)

    def with_priors(self, rows: np.ndarray, priors: Sequence[ClassPrior | None]) -> "ObjectEvidence":
        """The objects with the indices ``rows (K,)``, each with its own prior."""
        foreground, detections = self.foreground.select(rows), self.detections.select(rows)
        return replace(self.select(rows), foreground=foreground, detections=detections, priors=priors)


@dataclass(frozen=True)
class RawBoxes(ArrayRows):
    """Boxes as arrays over N objects, before classes and scores are added."""

    center: np.ndarray
    size: np.ndarray
    yaw: np.ndarray
    depth_scale: np.ndarray
    cost: np.ndarray
    fallback: np.ndarray

    @classmethod
    def without_fit(cls, center: np.ndarray, size: np.ndarray, yaw: np.ndarray) -> "RawBoxes":
        """Boxes ``(N, 3)``, ``(N, 3)``, ``(N,)`` of a method that neither scales depth nor has a cost."""
        count = len(yaw)
        return cls(center, size, yaw, np.ones(count), np.full(count, np.nan), np.zeros(count, bool))

    def where(self, chosen: np.ndarray, other: "RawBoxes") -> "RawBoxes":
        """``other``'s boxes where ``chosen (N,)`` is True, marked as fall-backs."""
        mixed = {
            name: np.where(chosen.reshape(-1, *[1] * (value.ndim - 1)), getattr(other, name), value)
            for name, value in vars(self).items()
        }
        return RawBoxes(**(mixed | {"fallback": self.fallback | chosen}))


def paper_boxes(evidence: ObjectEvidence) -> RawBoxes:
    """Equations 1 to 3: the extents of the points along the axes of the level frame."""
    low, high = _bounds(evidence.foreground.points(evidence.camera), evidence.foreground.weight)
    size = np.maximum((high - low)[:, [0, 2, 1]], 0.05)
    return RawBoxes.without_fit((low + high) / 2, size, np.zeros(len(low)))


def lshape_boxes(evidence: ObjectEvidence) -> RawBoxes:
    """Heading from the L-shape, size of the class (else of the points), anchored at the visible sides."""
    empty = evidence.foreground.count < 1
    points = np.where(empty[:, None, None], 1.0, evidence.foreground.points(evidence.camera))
    evidence = _with_a_point(evidence, empty)
    weight = evidence.foreground.weight
    eye = evidence.camera.translation
    yaw = _heading(evidence, points)
    extents = lshape.extents(points - eye, weight, yaw)
    low, high = _bounds(points, weight)
    plane, prior_size = evidence.plane, evidence.size
    bottom = high[:, 1]
    if plane is not None:
        bottom = plane.y_at((low[:, 0] + high[:, 0]) / 2, (low[:, 2] + high[:, 2]) / 2)
    # an object of an unknown class may hang: a traffic light does not reach down to the street
    hangs = np.isnan(prior_size[:, 0]) & (bottom - high[:, 1] > _HANGING)
    bottom = np.where(hangs, high[:, 1], bottom)
    seen = np.column_stack([extents[1] - extents[0], bottom - low[:, 1]])
    size = np.where(np.isnan(prior_size), np.maximum(seen, 0.05), prior_size)
    x, z = lshape.anchored(extents, yaw, size).T + eye[[0, 2], None]
    if plane is not None:
        bottom = np.where(hangs, bottom, plane.y_at(x, z))
    return RawBoxes.without_fit(np.stack([x, bottom - size[:, 2] / 2, z], axis=1), size, yaw)


def fitted_boxes(evidence: ObjectEvidence) -> RawBoxes:
    """The least-squares fit of :mod:`.box_fit`; of a class's kinds, the one that fits enough points best."""
    enough = evidence.foreground.count >= MIN_POINTS
    options = [
        prior.kinds if prior and prior.kinds and fits else (prior,)
        for prior, fits in zip(evidence.priors, enough, strict=True)
    ]
    rows = np.repeat(np.arange(len(options)), [len(kinds) for kinds in options])
    raw = _fit_all(evidence.with_priors(rows, [prior for kinds in options for prior in kinds]))
    order = np.lexsort((raw.cost, rows))
    return raw.select(order[np.unique(rows[order], return_index=True)[1]])


def _fit_all(evidence: ObjectEvidence) -> RawBoxes:
    """Fit every object from several headings; the cheapest result wins."""
    problem, start = _problem(evidence), _starts(evidence)
    parts = []
    for first in range(0, len(start), _CHUNK):
        part = slice(first, first + _CHUNK)
        parts.append(box_fit.solve(problem.select(part), evidence.camera, start[part]))
    state, cost = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    size = np.exp(state[:, [box_fit.LENGTH, box_fit.WIDTH, box_fit.HEIGHT]])
    center = state[:, [box_fit.X, box_fit.BOTTOM, box_fit.Z]]
    center[:, 1] -= size[:, 2] / 2
    few = evidence.foreground.count < MIN_POINTS
    return RawBoxes(center, size, state[:, box_fit.YAW], np.exp(state[:, box_fit.SCALE]), cost, few)


def _problem(evidence: ObjectEvidence) -> box_fit.Problem:
    foreground, detections = evidence.foreground, evidence.detections
    priors = [prior or _UNKNOWN_CLASS for prior in evidence.priors]
    noise = 0.06 + _PIXEL_SHARE * evidence.depth_sigma * foreground.median_depth(10.0)
    sigma = [np.hypot(noise, [table[prior.shape] for prior in priors]) for table in (_OUTSIDE, _INSIDE)]
    extent = np.tile(detections.xyxy[:, 2:] - detections.xyxy[:, :2], 2)
    tight = detections.box_style == "tight"
    shapes = [silhouette(prior.shape, detections.box_style) for prior in priors]
    most = max(len(shape) for shape in shapes)
    ground, ground_sigma = _ground_prior(evidence)
    return box_fit.Problem(
        direction=foreground.direction,
        depth=foreground.depth,
        weight=foreground.weight,
        worth=np.where(evidence.depth_sigma > UNSURE, [UNSURE_WORTH[p.shape] for p in priors], _WORTH),
        point_sigma=np.stack(sigma, axis=1),
        fill=np.array([_FILL[prior.shape] for prior in priors]),
        xyxy=detections.xyxy.astype(np.float64),
        edge_sigma=(1.5 if tight else 1.0) + (0.03 if tight else 0.02) * extent,
        trusted=evidence.trusted,
        silhouette=np.stack([np.concatenate([s, np.repeat(s[:1], most - len(s), 0)]) for s in shapes]),
        log_size=np.log([prior.size for prior in priors]),
        size_sigma=np.array([prior.spread for prior in priors]),
        ground=ground,
        ground_sigma=ground_sigma,
        scale_sigma=evidence.depth_sigma,
    )


def _ground_prior(evidence: ObjectEvidence) -> tuple[np.ndarray, np.ndarray]:
    """Y of the ground below each object as ``a + b x + c z`` ``(N, 3)``, and its error ``(N,)`` [m]."""
    # the ground may tilt below both planes; one fitted to depth has the error of the depth's scale, too
    distance = _distance_by_size(evidence)
    total, sums = np.full(len(distance), 1e-12), np.zeros((len(distance), 3))
    for plane, scale in ((evidence.plane, evidence.plane_sigma), (evidence.nominal, 0.0)):
        if plane is None:
            continue
        height = float(plane.height_above(evidence.camera.translation))
        sigma = np.hypot(0.05 + plane.tilt * distance, scale * height if plane.fitted else 0.0)
        line = np.array([plane.offset, -plane.normal[0], -plane.normal[2]]) / plane.normal[1]
        total += sigma**-2
        sums += line / sigma[:, None] ** 2
    return sums / total[:, None], total**-0.5


def _distance_by_size(evidence: ObjectEvidence) -> np.ndarray:
    """Depth ``(N,)`` [m] by the class's size in the image; an unknown class counts as 1 m high."""
    priors = [prior or _UNKNOWN_CLASS for prior in evidence.priors]
    return expected_depth(evidence.detections, evidence.camera, priors, evidence.trusted)[:, 0]


def _starts(evidence: ObjectEvidence) -> np.ndarray:
    """``(N, 4, 8)``: the L-shape's heading and a quarter turn more, along the line of sight and across."""
    prior_size, plane = evidence.size, evidence.plane
    size = np.where(np.isnan(prior_size), 1.0, prior_size)
    empty = evidence.foreground.count < 1
    xyxy = evidence.detections.xyxy
    middle = (xyxy[:, :2] + xyxy[:, 2:]) / 2
    guess = evidence.camera.back_project(middle[:, 0], middle[:, 1], _distance_by_size(evidence))
    points = np.where(empty[:, None, None], guess[:, None], evidence.foreground.points(evidence.camera))
    evidence = _with_a_point(evidence, empty)
    weight = evidence.foreground.weight
    low, high = _bounds(points, weight)
    eye = evidence.camera.translation
    ray = (low + high) / 2 - eye
    sight = np.arctan2(-ray[:, 2], ray[:, 0])
    yaw = np.where(empty, sight + np.pi / 4, _heading(evidence, points))
    # the points may be another object's: two starts are where the size in the image puts the object instead
    shift = np.linalg.norm(((low + high) / 2 - guess)[:, [0, 2]], axis=1)
    misplaced = shift > _MISPLACED * np.linalg.norm((guess - eye)[:, [0, 2]], axis=1)
    misplaced &= ~np.isnan(prior_size[:, 0])
    state = np.zeros((len(size), _STARTS, box_fit.UNKNOWNS))
    for row, turn in enumerate((yaw, yaw + np.pi / 2, sight, sight + np.pi / 2)):
        x, z = lshape.anchored(lshape.extents(points - eye, weight, turn), turn, size).T + eye[[0, 2], None]
        by_size = empty | (misplaced & (row >= 2))
        x, z = np.where(by_size, guess[:, 0], x), np.where(by_size, guess[:, 2], z)
        bottom = high[:, 1] + empty * size[:, 2] / 2 if plane is None else plane.y_at(x, z)
        start = state[:, row]
        start[:, box_fit.X], start[:, box_fit.Z], start[:, box_fit.BOTTOM] = x, z, bottom
        start[:, box_fit.YAW] = turn
    state[..., box_fit.LENGTH : box_fit.HEIGHT + 1] = np.log(size)[:, None]
    return state


def _heading(evidence: ObjectEvidence, points: np.ndarray) -> np.ndarray:
    """Yaw ``(N,)`` by the L-shape, along the side that fits the class or is longer."""
    points, weight = points - evidence.camera.translation, evidence.foreground.weight
    tolerance = 0.05 + 0.15 * evidence.depth_sigma * evidence.foreground.median_depth(1.0)
    yaw = lshape.closeness_yaw(points, weight, tolerance)
    extents = lshape.extents(points, weight, yaw)
    size = evidence.size
    fits = lshape.length_axis(extents, yaw, np.nan_to_num(size, nan=1.0))
    length, width = (extents[1] - extents[0]).T
    longer = np.where(width > length, yaw + np.pi / 2, yaw)
    yaw = np.where(np.isnan(size[:, 0]), longer, fits)
    # few points: along the line of sight, as most traffic is
    middle = (points * weight[..., None]).sum(1) / np.maximum(weight.sum(1), 1)[:, None]
    few = evidence.foreground.count < MIN_POINTS
    return np.where(few, np.arctan2(-middle[:, 2], middle[:, 0]), yaw)


def _bounds(points: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates ``(N, 3)``; zeros for an object without points."""
    padding = (weight <= 0)[..., None]
    some = np.any(weight > 0, axis=1, keepdims=True)
    low, high = np.where(padding, np.inf, points).min(1), np.where(padding, -np.inf, points).max(1)
    return np.where(some, low, 0.0), np.where(some, high, 0.0)


def _with_a_point(evidence: ObjectEvidence, empty: np.ndarray) -> ObjectEvidence:
    """Give ``empty (N,)`` objects one point, so that extents exist; their boxes are replaced afterwards."""
    weight = evidence.foreground.weight.copy()
    weight[empty, 0] = 1.0
    return replace(evidence, foreground=replace(evidence.foreground, weight=weight))

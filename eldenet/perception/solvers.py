"""What each method makes of the pixels of N objects: paper, L-shape, and the fit with or without depth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.geometry import PinholeCamera
from eldenet.perception import box_fit as fit
from eldenet.perception import lshape, residuals
from eldenet.perception.foreground import Foreground, expected_depth
from eldenet.perception.ground import GroundPlane
from eldenet.perception.priors import ClassPrior, silhouette

FEWEST_POINTS = 20  # of an object: with fewer, its sides say nothing about its heading
_CHUNK = 64  # objects solved together
_ANYTHING = ClassPrior((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), "box")  # an unknown class without depth
_INSIDE = {"vehicle": 0.30, "upright": 0.12, "box": 0.0}  # [m]: how far a shape may lie inside its box
_OUTSIDE = {"vehicle": 0.0, "upright": 0.12, "box": 0.0}  # [m]: and outside, where it does not fill it
_FILL = {"vehicle": 1.0, "upright": 0.5, "box": 1.0}  # a body is slimmer than the reach of its arms and legs
_STARTS = 4
_WITHIN = 0.5  # of an object's depth error differs from pixel to pixel; the factor on depth takes all of it
_HANGING = 0.5  # [m] above the ground: what ends there and is of no known class does not stand on it
_ASTRAY = 0.25  # of the distance: points that are farther from where the size in the picture says


@dataclass(frozen=True)
class Known:
    """All that is known of the objects of a picture; see :func:`eldenet.perception.foreground.gather`.

    ``plane`` is the ground that the methods use; ``nominal`` that of the camera's height, if it is another.
    ``depth_sigma (N,)`` is the relative depth error of each object, ``plane_sigma`` that of the ground.
    """

    found: Foreground
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

    def select(self, rows: np.ndarray, priors: Sequence[ClassPrior | None]) -> "Known":
        """Some of the objects (numbers ``rows``), each with a prior of its own."""
        found = Foreground(*(getattr(self.found, name)[rows] for name in ("direction", "depth", "weight")))
        return replace(
            self,
            found=found,
            detections=self.detections.select(rows),
            priors=priors,
            trusted=self.trusted[rows],
            depth_sigma=self.depth_sigma[rows],
        )

    def ground_at(self, x: np.ndarray, z: np.ndarray) -> np.ndarray | None:
        """Y of the ground [m], where there is one."""
        return None if self.plane is None else self.plane.level_at(x, z)


@dataclass(frozen=True)
class RawBoxes:
    """Boxes as arrays over N objects, before classes and scores are added."""

    center: np.ndarray
    size: np.ndarray
    yaw: np.ndarray
    depth_scale: np.ndarray
    cost: np.ndarray
    fallback: np.ndarray

    @classmethod
    def of(cls, center: np.ndarray, size: np.ndarray, yaw: np.ndarray) -> "RawBoxes":
        """Boxes of a method that neither scales depth nor has a cost."""
        count = len(yaw)
        return cls(center, size, yaw, np.ones(count), np.full(count, np.nan), np.zeros(count, bool))

    def select(self, chosen: np.ndarray) -> "RawBoxes":
        """Those that ``chosen`` (bool or numbers) picks."""
        return RawBoxes(**{name: value[chosen] for name, value in vars(self).items()})

    def where(self, chosen: np.ndarray, other: "RawBoxes") -> "RawBoxes":
        """``other``'s boxes where ``chosen``, marked as fall-backs."""
        mixed = {
            name: np.where(chosen.reshape(-1, *[1] * (value.ndim - 1)), getattr(other, name), value)
            for name, value in vars(self).items()
        }
        return RawBoxes(**(mixed | {"fallback": self.fallback | chosen}))


def _bounds(points: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates ``(N, 3)``; zeros for an object without points."""
    gone = (weight <= 0)[..., None]
    some = np.any(weight > 0, axis=1, keepdims=True)
    low, high = np.where(gone, np.inf, points).min(1), np.where(gone, -np.inf, points).max(1)
    return np.where(some, low, 0.0), np.where(some, high, 0.0)


def paper_boxes(known: Known) -> RawBoxes:
    """Equations 1 to 3: the extents of the points along the axes of the level frame."""
    low, high = _bounds(known.found.points(known.camera), known.found.weight)
    size = np.maximum((high - low)[:, [0, 2, 1]], 0.05)
    return RawBoxes.of((low + high) / 2, size, np.zeros(len(low)))


def _heading(known: Known, points: np.ndarray) -> tuple[np.ndarray, lshape.Extents]:
    """Yaw ``(N,)`` by the L-shape, along the side that fits the class or is longer, and the extents."""
    weight = known.found.weight
    z = known.found.median_depth(1.0)
    yaw = lshape.closeness_yaw(points, weight, 0.05 + 0.15 * known.depth_sigma * z)
    extents = lshape.extents(points, weight, yaw)
    size = known.size
    fits = lshape.length_axis(extents, yaw, np.nan_to_num(size, nan=1.0))
    longer = np.where(extents.high_v - extents.low_v > extents.high_u - extents.low_u, yaw + np.pi / 2, yaw)
    yaw = np.where(np.isnan(size[:, 0]), longer, fits)
    few = known.found.count < FEWEST_POINTS
    if few.any():  # along the line of sight, as most traffic is
        middle = (points * weight[..., None]).sum(1) / np.maximum(weight.sum(1), 1)[:, None]
        yaw = np.where(few, np.arctan2(-middle[:, 2], middle[:, 0]), yaw)
    return yaw, lshape.extents(points, weight, yaw)


def lshape_boxes(known: Known) -> RawBoxes:
    """Heading from the L-shape, the size of the class (else of the points), anchored at the seen sides."""
    points = known.found.points(known.camera)
    empty = known.found.count < 1
    points = np.where(empty[:, None, None], 1.0, points)
    known = _padded(known, empty)
    yaw, extents = _heading(known, points)
    low, high = _bounds(points, known.found.weight)
    x, z = (low[:, 0] + high[:, 0]) / 2, (low[:, 2] + high[:, 2]) / 2
    ground = known.ground_at(x, z)
    bottom = high[:, 1] if ground is None else ground
    # what is of no known class may hang: a traffic light does not reach down to the street
    hangs = np.isnan(known.size[:, 0]) & (bottom - high[:, 1] > _HANGING)
    bottom = np.where(hangs, high[:, 1], bottom)
    raw = np.stack(
        [extents.high_u - extents.low_u, extents.high_v - extents.low_v, bottom - low[:, 1]], axis=1
    )
    size = np.where(np.isnan(known.size), np.maximum(raw, 0.05), known.size)
    x, z = lshape.anchored(extents, yaw, size)
    ground = known.ground_at(x, z)
    bottom = bottom if ground is None else np.where(hangs, bottom, ground)
    return RawBoxes.of(np.stack([x, bottom - size[:, 2] / 2, z], axis=1), size, yaw)


def _padded(known: Known, empty: np.ndarray) -> Known:
    """One point for objects that have none, so that extents exist; their boxes are replaced afterwards."""
    weight = known.found.weight.copy()
    weight[empty, 0] = 1.0
    return replace(known, found=replace(known.found, weight=weight))


def fitted_boxes(known: Known) -> RawBoxes:
    """The least-squares fit of :mod:`.box_fit`; of a class's kinds the one that fits best."""
    seen = known.found.count >= FEWEST_POINTS
    options = [
        prior.kinds if prior and prior.kinds and there else (prior,)
        for prior, there in zip(known.priors, seen, strict=True)
    ]
    rows = np.repeat(np.arange(len(options)), [len(kinds) for kinds in options])
    if len(rows) == len(options):
        return _fitted(known)
    raw = _fitted(known.select(rows, [prior for kinds in options for prior in kinds]))
    order = np.lexsort((raw.cost, rows))
    return raw.select(order[np.unique(rows[order], return_index=True)[1]])


def _fitted(known: Known) -> RawBoxes:
    """One fit from several headings; the cheapest wins."""
    count = len(known.priors)
    problem = _problem(known)
    start = _starts(known)
    states, costs = [], []
    for first in range(0, count, _CHUNK):
        part = slice(first, first + _CHUNK)
        state, cost = fit.solve(problem.select(part), known.camera, start[part])
        states.append(state)
        costs.append(cost)
    state, cost = np.concatenate(states), np.concatenate(costs)
    size = np.exp(state[:, [residuals.LENGTH, residuals.WIDTH, residuals.HEIGHT]])
    center = np.stack(
        [state[:, residuals.X], state[:, residuals.BOTTOM] - size[:, 2] / 2, state[:, residuals.Z]], axis=1
    )
    return RawBoxes(
        center,
        size,
        state[:, residuals.YAW],
        np.exp(state[:, residuals.SCALE]),
        cost,
        known.found.count < FEWEST_POINTS,
    )


def _problem(known: Known) -> residuals.Problem:
    found, detections = known.found, known.detections
    priors = [prior or _ANYTHING for prior in known.priors]
    noise = 0.06 + _WITHIN * known.depth_sigma * found.median_depth(10.0)
    sigma = [np.hypot(noise, [table[prior.shape] for prior in priors]) for table in (_OUTSIDE, _INSIDE)]
    extent = np.tile(detections.xyxy[:, 2:] - detections.xyxy[:, :2], 2)
    tight = detections.box_style == "tight"
    shapes = [silhouette(prior.shape, detections.box_style) for prior in priors]
    most = max(len(shape) for shape in shapes)
    ground, ground_sigma = _ground_belief(known)
    return residuals.Problem(
        direction=found.direction,
        depth=found.depth,
        weight=found.weight,
        point_sigma=np.stack(sigma, axis=1),
        fill=np.array([_FILL[prior.shape] for prior in priors]),
        xyxy=detections.xyxy.astype(np.float64),
        edge_sigma=(1.5 if tight else 1.0) + (0.03 if tight else 0.02) * extent,
        trusted=known.trusted,
        silhouette=np.stack([np.concatenate([s, np.repeat(s[:1], most - len(s), 0)]) for s in shapes]),
        log_size=np.log([prior.size for prior in priors]),
        size_sigma=np.array([prior.spread for prior in priors]),
        ground=ground,
        ground_sigma=ground_sigma,
        scale_sigma=known.depth_sigma,
    )


def _ground_belief(known: Known) -> tuple[np.ndarray, np.ndarray]:
    """Y of the ground below each object as ``a + b x + c z`` ``(N, 3)``, and its error ``(N,)`` [m].

    A plane fitted to depth is as wrong as the depth's scale; one from the camera's height is wrong by the
    tilt. Where both are known, each counts by its error.
    """
    away = _distance_by_height(known)
    total, sums = np.full(len(away), 1e-12), np.zeros((len(away), 3))
    for plane, scale in ((known.plane, known.plane_sigma), (known.nominal, 0.0)):
        if plane is None:
            continue
        sigma = np.hypot(0.05 + plane.tilt * away, scale * plane.offset if plane.fitted else 0.0)
        total += sigma**-2
        sums += (
            np.array([plane.offset, -plane.normal[0], -plane.normal[2]])
            / plane.normal[1]
            / sigma[:, None] ** 2
        )
    return sums / total[:, None], total**-0.5


def _distance_by_height(known: Known) -> np.ndarray:
    """Depth ``(N,)`` [m] by the class's height; an unknown class counts as a meter high."""
    priors: list[ClassPrior | None] = [prior or _ANYTHING for prior in known.priors]
    found = expected_depth(known.detections, known.camera, priors, known.trusted)
    return np.array([depth for depth, _ in found])


def _starts(known: Known) -> np.ndarray:
    """``(N, 4, 8)``: the L-shape's heading and a quarter turn more, along the line of sight and across."""
    count = len(known.priors)
    size = np.where(np.isnan(known.size), 1.0, known.size)
    blind = known.found.count < 1
    xyxy = known.detections.xyxy
    middle = (xyxy[:, :2] + xyxy[:, 2:]) / 2
    guess = known.camera.back_project(middle[:, 0], middle[:, 1], _distance_by_height(known))
    points = np.where(blind[:, None, None], guess[:, None], known.found.points(known.camera))
    known = _padded(known, blind)
    yaw, _ = _heading(known, points)
    low, high = _bounds(points, known.found.weight)
    sight = np.arctan2(-(low + high)[:, 2], (low + high)[:, 0])
    yaw = np.where(blind, sight + np.pi / 4, yaw)
    # points that may be another object's: two starts are where the size in the picture says instead
    apart = np.linalg.norm(((low + high) / 2 - guess)[:, [0, 2]], axis=1)
    astray = apart > _ASTRAY * np.linalg.norm(guess[:, [0, 2]], axis=1)
    astray &= [prior is not None for prior in known.priors]
    state = np.zeros((count, _STARTS, residuals.UNKNOWNS))
    for row, turn in enumerate((yaw, yaw + np.pi / 2, sight, sight + np.pi / 2)):
        extents = lshape.extents(points, known.found.weight, turn)
        x, z = lshape.anchored(extents, turn, size)
        away = blind | (astray & (row >= 2))
        state[:, row, residuals.X] = np.where(away, guess[:, 0], x)
        state[:, row, residuals.Z] = np.where(away, guess[:, 2], z)
        ground = known.ground_at(state[:, row, residuals.X], state[:, row, residuals.Z])
        state[:, row, residuals.BOTTOM] = high[:, 1] if ground is None else ground
        if ground is None:
            state[blind, row, residuals.BOTTOM] += size[blind, 2] / 2
        state[:, row, residuals.YAW] = turn
    state[..., residuals.LENGTH : residuals.HEIGHT + 1] = np.log(size)[:, None]
    return state

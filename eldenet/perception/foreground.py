"""Which pixels of a 2D box belong to its object, and which of its edges can be trusted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from eldenet.boxes import ArrayRows, Detections2D
from eldenet.geometry import PinholeCamera, to_corner
from eldenet.perception.ground import GroundPlane
from eldenet.perception.priors import ClassPrior
from eldenet.uncertainty import DepthEstimate

POINTS = 80  # per object
_EXAMINED = 400  # pixels per box, if it has as many: every k-th row and column, so up to four times as many
_BORDER = 2.0  # [px]: the image border cuts a box that comes closer to it
_QUANTILES = (0.5, 0.1, 0.25, 0.4, 0.6, 0.75, 0.9)
_TOUCH = 3.0  # [px]: boxes this close may hide one another
_LEAST_SPREAD = 0.02  # sigma / depth below which pixels weigh the same
_MIN_REMAINDER = 0.12  # share of a box outside nearer boxes from which it is taken alone


@dataclass(frozen=True)
class Foreground(ArrayRows):
    """Pixels of N objects, P each.

    Attributes:
        direction: ``(N, P, 3)`` ``H [j, i, 1]^T``: the level point of a pixel is ``depth * direction + t``.
        depth: ``(N, P)`` [m].
        weight: ``(N, P)`` above 0, or 0.0 for padding; 1.0 in the mean of an object's pixels, more for those
            whose depth is more certain.
    """

    direction: np.ndarray
    depth: np.ndarray
    weight: np.ndarray

    @property
    def count(self) -> np.ndarray:
        """``(N,)`` number of pixels."""
        return np.asarray((self.weight > 0).sum(1))

    def median_depth(self, default: float) -> np.ndarray:
        """``(N,)`` [m] of each object's pixels without padding; ``default`` for an object without pixels."""
        ordered = np.sort(np.where(self.weight > 0, self.depth, np.inf), axis=1)
        count = self.count
        rows = np.arange(len(count))
        pair = [ordered[rows, np.maximum(middle, 0)] for middle in ((count - 1) // 2, count // 2)]
        return np.where(count > 0, (pair[0] + pair[1]) / 2, default)

    def without_points(self) -> "Foreground":
        """The same objects without any pixels."""
        return replace(self, weight=np.zeros_like(self.weight))

    def points(self, camera: PinholeCamera) -> np.ndarray:
        """``(N, P, 3)`` level points [m]."""
        return self.depth[..., None] * self.direction + camera.translation


def gather(
    estimate: DepthEstimate,
    detections: Detections2D,
    camera: PinholeCamera,
    ground: GroundPlane | None,
    priors: Sequence[ClassPrior | None],
    *,
    select: Literal["core", "median"] = "core",
    occlusion_mask: bool = True,
    depth_sigma: np.ndarray,
) -> Foreground:
    """Choose the pixels of every object.

    Args:
        estimate: depth ``(H, W)`` [m]; 0, negative or not finite is unknown. With sigma, pixels weigh by it.
        detections: in pixels of the depth.
        camera: of the depth.
        ground: leave out its points; None: keep all.
        priors: of every object; None for an unknown class.
        select: "core": pixels above the ground, around the likely depth of the box's middle; "median": all
            pixels around the box's median depth.
        occlusion_mask: leave out pixels in nearer boxes.
        depth_sigma: ``(N,)`` relative depth error of each object.
    """
    depth = estimate.depth
    with np.errstate(divide="ignore", invalid="ignore"):  # where the depth is unknown
        spread = estimate.spread
    size = (depth.shape[0], depth.shape[1])
    nearer = nearer_boxes(detections.xyxy) if occlusion_mask else np.zeros((len(detections),) * 2, bool)
    expected = expected_depth(detections, camera, priors, trusted_edges(detections, size)[0])
    core = select == "core"
    direction = np.zeros((len(detections), POINTS, 3))
    chosen_depth, weight = np.ones((len(detections), POINTS)), np.zeros((len(detections), POINTS))
    back = np.full(len(detections), np.inf)  # depth that is behind each object
    for index in np.argsort(-detections.xyxy[:, 3]):  # nearer objects first
        rows, columns = _box_pixels(depth, detections, int(index), nearer[index], back)
        if not len(rows):
            continue
        pixel_depth = depth[rows, columns].astype(np.float64)
        rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ camera.homography.T
        box, prior, sigma = detections.xyxy[index], priors[index], float(depth_sigma[index])
        standing = middle = np.ones(len(rows), bool)
        if core:
            standing = _above_ground(pixel_depth[:, None] * rays + camera.translation, pixel_depth, ground)
            middle = _in_the_middle(rows, columns, box, standing)
        center = float(np.median(pixel_depth[middle]))
        if prior is None:
            reach = 1.5 * float(box[2] - box[0]) * center / camera.intrinsics[0, 0] + 0.2
        else:
            reach = float(np.hypot(prior.size[0], prior.size[1])) * (1 + prior.spread[0])
            if core:
                center = _likely_depth(pixel_depth[middle], expected[index], reach, sigma)
        found = np.nonzero(standing & _within_reach(pixel_depth, np.array([center]), reach, sigma)[0])[0]
        if len(found):
            back[index] = np.quantile(pixel_depth[found], 0.95) * (1 + 0.5 * sigma) + 0.1
        if len(found) > POINTS:
            found = found[np.linspace(0, len(found) - 1, POINTS).astype(int)]
        direction[index, : len(found)] = rays[found]
        chosen_depth[index, : len(found)] = pixel_depth[found]
        weight[index, : len(found)] = 1.0
        if spread is not None and len(found):
            certain = np.clip(spread[rows[found], columns[found]], _LEAST_SPREAD, None) ** -2.0
            weight[index, : len(found)] = certain / certain.mean()
    return Foreground(direction, chosen_depth, weight)


def _box_pixels(
    depth: np.ndarray, detections: Detections2D, index: int, nearer: np.ndarray, back: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns ``(P,)`` of the pixels of a box to examine: known, and not of nearer objects."""
    left, top, right, bottom = _pixel_range(detections.xyxy[index], depth.shape)
    crop = depth[top:bottom, left:right]
    known = np.isfinite(crop) & (crop > 0)
    if detections.mask is not None:
        known &= detections.mask[index, top:bottom, left:right]
    elif nearer.any():
        beside, behind = known.copy(), known.copy()
        for other in np.nonzero(nearer)[0]:
            x1, y1, x2, y2 = _pixel_range(detections.xyxy[other] - [left, top, left, top], crop.shape)
            part = slice(y1, y2), slice(x1, x2)
            beside[part] = False
            behind[part] &= crop[part] > back[other]
        # beside the nearer boxes if enough is left there, else the pixels behind their objects
        if beside.sum() >= _MIN_REMAINDER * known.sum():
            known = beside
        elif behind.any():
            known = behind
    stride = max(1, int(np.sqrt(known.sum() / _EXAMINED)))
    rows, columns = np.nonzero(known[::stride, ::stride])
    return rows * stride + top, columns * stride + left


def _pixel_range(box: np.ndarray, size: tuple[int, ...]) -> tuple[int, int, int, int]:
    """First column and row, and those past the last, of the pixels whose centers lie in a box ``(4,)``."""
    low = np.clip(np.ceil(box[:2]), 0, None).astype(int)
    high = np.clip(np.floor(box[2:]) + 1, low, np.maximum((size[1], size[0]), low)).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _above_ground(points: np.ndarray, depth: np.ndarray, ground: GroundPlane | None) -> np.ndarray:
    """``(P,)`` bool: the point is above the ground; all if fewer than five are."""
    if ground is None:
        return np.ones(len(depth), bool)
    standing = ground.height_above(points) > 0.12 + 0.006 * depth
    return standing if standing.sum() >= 5 else np.ones(len(depth), bool)


def _in_the_middle(
    rows: np.ndarray, columns: np.ndarray, box: np.ndarray, standing: np.ndarray
) -> np.ndarray:
    """``(P,)`` bool: standing and in the middle of the box; all that stand if fewer than five are."""
    x, y = (columns - box[0]) / (box[2] - box[0] + 1e-9), (rows - box[1]) / (box[3] - box[1] + 1e-9)
    middle = standing & (np.abs(x - 0.5) < 0.25) & (np.abs(y - 0.5) < 0.3)
    return middle if middle.sum() >= 5 else standing


def _within_reach(depth: np.ndarray, centers: np.ndarray, reach: float, depth_sigma: float) -> np.ndarray:
    """``(C, P)`` bool: depths ``(P,)`` that an object at each of the ``centers (C,)`` may show."""
    offset = depth[None] - centers[:, None]
    noise = 0.5 * depth_sigma * centers[:, None]
    return np.asarray((offset > -0.75 * reach - noise) & (offset < reach + noise))


def _likely_depth(depth: np.ndarray, expected: np.ndarray, reach: float, depth_sigma: float) -> float:
    """The depth [m] that holds many of the pixels ``(P,)`` and fits the size of the class in the image.

    The median alone falls on whatever hides most of the object.
    """
    centers = np.quantile(depth, _QUANTILES)
    share = _within_reach(depth, centers, reach, depth_sigma).mean(1)
    surprise = np.log(centers / expected[0])
    # an unnoticed occlusion makes the object look smaller and so farther away: a depth nearer than expected
    # is less of a surprise
    surprise = surprise / np.hypot(np.where(surprise < 0, 0.3, 0.0), np.hypot(expected[1], 2 * depth_sigma))
    return float(centers[np.argmax(np.log(share + 1e-9) - 0.5 * surprise**2)])


def expected_depth(
    detections: Detections2D,
    camera: PinholeCamera,
    priors: Sequence[ClassPrior | None],
    trusted: np.ndarray,
) -> np.ndarray:
    """Depth [m] of each object by the height of its class in the image, and its relative error: ``(N, 2)``.

    Where the upper or the lower edge is cut, the width bounds the depth, and the error is large. An object
    without a prior is at 1 m, with an error of 1000.
    """
    found = np.tile([1.0, 1e3], (len(detections), 1))
    for index, (box, prior, edges) in enumerate(zip(detections.xyxy, priors, trusted, strict=True)):
        if prior is None:
            continue
        height, width = max(box[3] - box[1], 1.0), max(box[2] - box[0], 1.0)
        by_height = camera.intrinsics[1, 1] * prior.size[2] / height
        by_width = camera.intrinsics[0, 0] * (prior.size[0] + prior.size[1]) / 2 / width
        whole = edges[1] and edges[3]
        found[index] = (
            (by_height, np.hypot(0.1, prior.spread[2])) if whole else (min(by_height, by_width), 0.6)
        )
    return found


def nearer_boxes(xyxy: np.ndarray, slack: float = 0.0) -> np.ndarray:
    """``(N, N)`` bool: box j overlaps box i and stands nearer, for its lower edge is lower in the image.

    Boxes at most ``slack`` [px] apart overlap too: a box around the visible part of an object ends where the
    nearer object begins.
    """
    low = np.maximum(xyxy[:, None, :2], xyxy[None, :, :2])
    high = np.minimum(xyxy[:, None, 2:], xyxy[None, :, 2:])
    overlap = (high + slack > low).all(-1)
    return np.asarray(overlap & (xyxy[None, :, 3] > xyxy[:, None, 3] + 1.0))


def border_cuts(xyxy: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Edges ``(N, 4)`` bool of boxes that end at the border of an image of ``(height, width)`` [px]."""
    edges = to_corner(xyxy)
    return np.concatenate([edges[:, :2] <= _BORDER, edges[:, 2:] >= np.array(size[::-1]) - _BORDER], axis=1)


def trusted_edges(detections: Detections2D, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Edges ``(N, 4)`` bool (left, top, right, bottom) that are the object's own, and ``(N,)`` hidden share.

    An edge at the image border is a cut. Where a nearer box begins, the edge of a "tight" box shows only
    where the visible part ends.

    ``size`` is the image's ``(height, width)`` [px].
    """
    xyxy = detections.xyxy
    trusted = ~border_cuts(xyxy, size)
    tight = detections.box_style == "tight"
    nearer = nearer_boxes(xyxy, _TOUCH if tight else 0.0)
    hidden = np.zeros(len(xyxy))
    for index, box in enumerate(xyxy):
        for other in xyxy[nearer[index]]:
            low, high = np.maximum(box[:2], other[:2]), np.minimum(box[2:], other[2:])
            share = (high - low) / np.maximum(box[2:] - box[:2], 1e-9)
            hidden[index] += max(share[0], 0.0) * max(share[1], 0.0)
            for axis in (0, 1) if tight else ():
                if share[1 - axis] < 0.3:  # left and right are hidden over a share of the height
                    continue
                slack = 0.05 * (box[2 + axis] - box[axis]) + 1.0
                for edge in (axis, 2 + axis):
                    if other[axis] - slack <= box[edge] <= other[2 + axis] + slack:
                        trusted[index, edge] = False
    return trusted, np.minimum(hidden, 1.0)

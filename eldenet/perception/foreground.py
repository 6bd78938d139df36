"""Which pixels of a 2D box belong to its object, and which of its edges can be trusted."""

from dataclasses import dataclass, replace

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.geometry import PinholeCamera, to_corner
from eldenet.perception.ground import GroundPlane
from eldenet.perception.priors import ClassPrior

POINTS = 80  # per object
_GATHERED = 400  # pixels per box that are looked at
_BORDER = 2.0  # [px]: a box that comes closer to the picture's border is cut by it
_QUANTILES = (0.5, 0.1, 0.25, 0.4, 0.6, 0.75, 0.9)
_TOUCH = 3.0  # [px]: boxes that come so near may hide one another
_LEFT_OVER = 0.12  # of a box, when nearer boxes are taken away; with less, they are not


@dataclass(frozen=True)
class Foreground:
    """Pixels of N objects, P each.

    Attributes:
        direction: ``(N, P, 3)`` ``H [j, i, 1]^T``: the level point of a pixel is ``depth * direction + t``.
        depth: ``(N, P)`` [m].
        weight: ``(N, P)`` 1.0, or 0.0 for padding.
    """

    direction: np.ndarray
    depth: np.ndarray
    weight: np.ndarray

    @property
    def count(self) -> np.ndarray:
        """``(N,)`` pixels found."""
        return np.asarray(self.weight.sum(1))

    def median_depth(self, unseen: float) -> np.ndarray:
        """``(N,)`` [m] of each object's pixels, padding left out; ``unseen`` where there is none."""
        ordered = np.sort(np.where(self.weight > 0, self.depth, np.inf), axis=1)
        count = (self.weight > 0).sum(1)
        rows = np.arange(len(count))
        pair = [ordered[rows, np.maximum(middle, 0)] for middle in ((count - 1) // 2, count // 2)]
        return np.where(count > 0, (pair[0] + pair[1]) / 2, unseen)

    def without_points(self) -> "Foreground":
        """The same objects, nothing seen of them."""
        return replace(self, weight=np.zeros_like(self.weight))

    def points(self, camera: PinholeCamera) -> np.ndarray:
        """``(N, P, 3)`` level points [m]."""
        return self.depth[..., None] * self.direction + camera.translation


def nearer_boxes(xyxy: np.ndarray, slack: float = 0.0) -> np.ndarray:
    """``(N, N)`` bool: box j overlaps box i and stands nearer, for its lower edge is lower in the picture.

    With ``slack`` [px] it is enough that they come so near: a box around what is seen ends where the nearer
    object begins.
    """
    low, high = (
        np.maximum(xyxy[:, None, :2], xyxy[None, :, :2]),
        np.minimum(xyxy[:, None, 2:], xyxy[None, :, 2:]),
    )
    overlap = (high + slack > low).all(-1)
    return np.asarray(overlap & (xyxy[None, :, 3] > xyxy[:, None, 3] + 1.0))


def gather(
    depth: np.ndarray,
    detections: Detections2D,
    camera: PinholeCamera,
    ground: GroundPlane | None,
    priors: list[ClassPrior | None],
    *,
    select: str = "core",
    occlusion_mask: bool = True,
    depth_sigma: np.ndarray,
) -> Foreground:
    """Choose the pixels of every object.

    Args:
        depth: ``(H, W)`` [m]; 0, negative or not finite is unknown.
        detections: the objects.
        camera: of the picture.
        ground: its points are left out; None: none are.
        priors: of every object; None for an unknown class.
        select: "core": what is not ground, around the median depth of the box's middle; "median": all around
            the box's median.
        occlusion_mask: leave out what lies in nearer boxes.
        depth_sigma: ``(N,)`` relative error of the depth of each object.
    """
    height, width = depth.shape
    nearer = nearer_boxes(detections.xyxy) if occlusion_mask else np.zeros((len(detections),) * 2, bool)
    homography = camera.homography
    expected = expected_depth(detections, camera, priors, trusted_edges(detections, (height, width))[0])
    direction = np.zeros((len(detections), POINTS, 3))
    chosen_depth, weight = np.ones((len(detections), POINTS)), np.zeros((len(detections), POINTS))
    back = np.full(len(detections), np.inf)  # depth behind which an object is surely left
    for index in np.argsort(-detections.xyxy[:, 3]):  # nearer objects first
        rows, columns = _pixels_of(depth, detections, int(index), nearer[index], back)
        if not len(rows):
            continue
        far = depth[rows, columns].astype(np.float64)
        rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ homography.T
        box = detections.xyxy[index]
        inside = _select(
            rows, columns, far, rays, box, camera, ground, priors[index], select, float(depth_sigma[index]),
            expected[index],
        )  # fmt: skip
        found = np.nonzero(inside)[0]
        if len(found):
            back[index] = np.quantile(far[found], 0.95) * (1 + 0.5 * depth_sigma[index]) + 0.1
        if len(found) > POINTS:
            found = found[np.linspace(0, len(found) - 1, POINTS).astype(int)]
        direction[index, : len(found)] = rays[found]
        chosen_depth[index, : len(found)] = far[found]
        weight[index, : len(found)] = 1.0
    return Foreground(direction, chosen_depth, weight)


def _pixels_of(
    depth: np.ndarray, detections: Detections2D, index: int, nearer: np.ndarray, back: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a box's pixels of known depth, without nearer objects'; about 400 at most."""
    height, width = depth.shape
    box = detections.xyxy[index]
    left, top, right, bottom = _pixels_within(box, (height, width))
    if right <= left or bottom <= top:
        return np.zeros(0, int), np.zeros(0, int)
    crop = depth[top:bottom, left:right]
    known = np.isfinite(crop) & (crop > 0)
    if detections.mask is not None:
        known &= detections.mask[index, top:bottom, left:right]
    elif nearer.any():
        beside, behind = known.copy(), known.copy()
        for other in np.nonzero(nearer)[0]:
            x1, y1, x2, y2 = _pixels_within(detections.xyxy[other] - [left, top, left, top], crop.shape)
            part = slice(y1, y2), slice(x1, x2)
            beside[part] = False
            behind[part] &= crop[part] > back[other]
        # beside the nearer boxes if enough is left there, else what shows behind their objects
        if beside.sum() >= _LEFT_OVER * known.sum():
            known = beside
        elif behind.any():
            known = behind
    stride = max(1, int(np.sqrt(known.sum() / _GATHERED)))
    rows, columns = np.nonzero(known[::stride, ::stride])
    return rows * stride + top, columns * stride + left


def _pixels_within(box: np.ndarray, size: tuple[int, ...]) -> tuple[int, int, int, int]:
    """First column and row, and those past the last, of pixels of a picture whose centers lie in a box."""
    low = np.clip(np.ceil(box[:2]), 0, None).astype(int)
    high = np.clip(np.floor(box[2:]) + 1, low, np.maximum((size[1], size[0]), low)).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _select(
    rows: np.ndarray, columns: np.ndarray, far: np.ndarray, rays: np.ndarray, box: np.ndarray,
    camera: PinholeCamera, ground: GroundPlane | None, prior: ClassPrior | None, select: str,
    depth_sigma: float, expected: tuple[float, float],
) -> np.ndarray:  # fmt: skip
    """Bool per pixel: is it the object's?"""
    standing = np.ones(len(far), bool)
    if select == "core" and ground is not None:
        above = ground.below(far[:, None] * rays + camera.translation)
        standing = above > 0.12 + 0.006 * far
        if standing.sum() < 5:
            standing = np.ones(len(far), bool)
    middle = standing
    if select == "core":
        x, y = (columns - box[0]) / (box[2] - box[0] + 1e-9), (rows - box[1]) / (box[3] - box[1] + 1e-9)
        core = standing & (np.abs(x - 0.5) < 0.25) & (np.abs(y - 0.5) < 0.3)
        middle = core if core.sum() >= 5 else standing
    center = float(np.median(far[middle]))
    if prior is None:
        reach = 1.5 * float(box[2] - box[0]) * center / camera.intrinsics[0, 0] + 0.2
        return np.asarray(standing & _around(far, np.array([center]), reach, depth_sigma)[0])
    reach = float(np.hypot(prior.size[0], prior.size[1])) * (1 + prior.spread[0])
    if select == "core":
        center = _likely_depth(far[middle], expected, reach, depth_sigma)
    return np.asarray(standing & _around(far, np.array([center]), reach, depth_sigma)[0])


def _around(far: np.ndarray, centers: np.ndarray, reach: float, depth_sigma: float) -> np.ndarray:
    """``(C, P)`` bool: depths that an object at each of the centers may show."""
    away = far[None] - centers[:, None]
    noise = 0.5 * depth_sigma * centers[:, None]
    return np.asarray((away > -0.75 * reach - noise) & (away < reach + noise))


def _likely_depth(far: np.ndarray, expected: tuple[float, float], reach: float, depth_sigma: float) -> float:
    """The depth that holds many of the pixels and fits the class's height in the picture.

    The median alone falls on whatever hides most of the object.
    """
    centers = np.quantile(far, _QUANTILES)
    share = _around(far, centers, reach, depth_sigma).mean(1)
    surprise = np.log(centers / expected[0])
    # what is hidden unnoticed makes the object look smaller, so farther: nearer than expected is less
    # of a surprise
    surprise = surprise / np.hypot(np.where(surprise < 0, 0.3, 0.0), np.hypot(expected[1], 2 * depth_sigma))
    return float(centers[np.argmax(np.log(share + 1e-9) - 0.5 * surprise**2)])


def expected_depth(
    detections: Detections2D, camera: PinholeCamera, priors: list[ClassPrior | None], trusted: np.ndarray
) -> list[tuple[float, float]]:
    """Depth [m] of each object by its class's height in the picture, and the relative error of that.

    Where the upper or the lower edge is cut, the width bounds it, and the error is large.
    """
    found = []
    for box, prior, edges in zip(detections.xyxy, priors, trusted, strict=True):
        if prior is None:
            found.append((1.0, 1e3))
            continue
        tall, wide = max(box[3] - box[1], 1.0), max(box[2] - box[0], 1.0)
        by_height = camera.intrinsics[1, 1] * prior.size[2] / tall
        if edges[1] and edges[3]:
            found.append((by_height, float(np.hypot(0.1, prior.spread[2]))))
        else:
            by_width = camera.intrinsics[0, 0] * (prior.size[0] + prior.size[1]) / 2 / wide
            found.append((min(by_height, by_width), 0.6))
    return found


def border_cuts(xyxy: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Edges ``(N, 4)`` bool of boxes that end at the border of a picture of ``(height, width)`` [px]."""
    edges = to_corner(xyxy)
    return np.concatenate([edges[:, :2] <= _BORDER, edges[:, 2:] >= np.array(size[::-1]) - _BORDER], axis=1)


def trusted_edges(detections: Detections2D, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Edges ``(N, 4)`` bool (left, top, right, bottom) that are the object's own, and ``(N,)`` hidden share.

    An edge at the picture's border is a cut. Around what is seen ("tight"), an edge where a nearer box begins
    is where that one hides the object.

    Args:
        detections: the objects.
        size: ``(height, width)`` of the picture [px].
    """
    xyxy = detections.xyxy
    trusted = ~border_cuts(xyxy, size)
    nearer = nearer_boxes(xyxy, _TOUCH if detections.box_style == "tight" else 0.0)
    hidden = np.zeros(len(xyxy))
    for index, box in enumerate(xyxy):
        for other in xyxy[nearer[index]]:
            low, high = np.maximum(box[:2], other[:2]), np.minimum(box[2:], other[2:])
            share = (high - low) / np.maximum(box[2:] - box[:2], 1e-9)
            hidden[index] += max(share[0], 0.0) * max(share[1], 0.0)
            if detections.box_style == "projected":
                continue
            for axis in (
                0,
                1,
            ):  # left and right are hidden over a share of the height, and the other way round
                if share[1 - axis] < 0.3:
                    continue
                slack = 0.05 * (box[2 + axis] - box[axis]) + 1.0
                for edge in (axis, 2 + axis):
                    if other[axis] - slack <= box[edge] <= other[2 + axis] + slack:
                        trusted[index, edge] = False
    return trusted, np.minimum(hidden, 1.0)

"""Overlap of boxes: in the image (2D), from above (BEV), and in space (3D)."""

import numpy as np

from eldenet.boxes import Boxes3D, axes_of


def iou_2d(first: np.ndarray, second: np.ndarray, *, of_first: bool = False) -> np.ndarray:
    """Intersection over union ``(N, M)`` of xyxy boxes ``(N, 4)`` and ``(M, 4)``.

    With ``of_first``, intersection over the first box's area: the share of it that the second covers.
    """
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=-1)
    own, other = (np.prod(boxes[:, 2:] - boxes[:, :2], axis=-1) for boxes in (first, second))
    whole = own[:, None] if of_first else own[:, None] + other[None] - shared
    return np.asarray(np.divide(shared, whole, out=np.zeros_like(shared), where=whole > 0))


def footprints(bev: np.ndarray) -> np.ndarray:
    """Corners ``(N, 4, 2)`` of footprints ``(N, 5)`` x, z, length, width, yaw, in counter-clockwise order."""
    along, across = axes_of(bev[:, 4])[:, :, [0, 2]].transpose(1, 0, 2)
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) / 2
    u, v = signs[None, :, :1] * bev[:, None, 2:3], signs[None, :, 1:] * bev[:, None, 3:4]
    return np.asarray(bev[:, None, :2] + u * along[:, None] + v * across[:, None])


def intersection_area(first: np.ndarray, second: np.ndarray) -> float:
    """Shared area of two convex counter-clockwise polygons ``(K, 2)``, ``(L, 2)``: Sutherland-Hodgman."""
    polygon = first
    for start, end in zip(second, np.roll(second, -1, axis=0), strict=True):
        if not len(polygon):
            return 0.0
        edge = end - start
        side = edge[0] * (polygon[:, 1] - start[1]) - edge[1] * (polygon[:, 0] - start[0])
        kept = []
        for index in range(len(polygon)):
            before = index - 1
            if (side[before] >= 0) != (side[index] >= 0):
                share = side[before] / (side[before] - side[index])
                kept.append(polygon[before] + share * (polygon[index] - polygon[before]))
            if side[index] >= 0:
                kept.append(polygon[index])
        polygon = np.array(kept).reshape(-1, 2)
    x, y = polygon[:, 0], polygon[:, 1]
    return float(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))) if len(polygon) > 2 else 0.0


def rotated_intersections(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Shared areas ``(N, M)`` [m2] of footprints ``(N, 5)`` and ``(M, 5)``."""
    areas = np.zeros((len(first), len(second)))
    reach = [np.hypot(bev[:, 2], bev[:, 3]) / 2 for bev in (first, second)]
    apart = np.linalg.norm(first[:, None, :2] - second[None, :, :2], axis=-1)
    corners = [footprints(bev) for bev in (first, second)]
    for row, column in zip(*np.nonzero(apart < reach[0][:, None] + reach[1][None]), strict=True):
        areas[row, column] = intersection_area(corners[0][row], corners[1][column])
    plans = [bev[:, 2] * bev[:, 3] for bev in (first, second)]
    # a footprint without length and width clips nothing away
    return np.minimum(areas, np.minimum(plans[0][:, None], plans[1][None]))


def box_ious(first: Boxes3D, second: Boxes3D) -> tuple[np.ndarray, np.ndarray]:
    """BEV and 3D intersection over union, ``(N, M)`` each."""
    area = rotated_intersections(first.bev, second.bev)
    plans = [np.prod(boxes.size[:, :2], axis=1) for boxes in (first, second)]
    bev = area / np.maximum(plans[0][:, None] + plans[1][None] - area, 1e-12)
    top = np.maximum(first.top_center[:, None, 1], second.top_center[None, :, 1])
    bottom = np.minimum(first.bottom_center[:, None, 1], second.bottom_center[None, :, 1])
    shared = area * np.maximum(bottom - top, 0.0)
    volumes = [np.prod(boxes.size, axis=1) for boxes in (first, second)]
    return bev, shared / np.maximum(volumes[0][:, None] + volumes[1][None] - shared, 1e-12)

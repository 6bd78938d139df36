"""Scenes for lifting boxes: a block on flat ground without a renderer; the clear objects of a street."""

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.geometry import PinholeCamera, pinhole

CAMERA = PinholeCamera(pinhole(400.0, 400.0, 320.0, 100.0))


def block(center, size=(3.9, 1.6, 1.5), yaw=0.4, camera=CAMERA, shape=(240, 640), height=1.6):
    """Depth ``(H, W)`` [m] and 2D box ``(1, 4)`` of one block on flat ground, by the slab method."""
    rows, columns = np.indices(shape)
    rays = camera.back_project(columns, rows, np.ones(shape)) - camera.translation
    with np.errstate(divide="ignore"):
        depth = np.where(rays[..., 1] > 1e-6, height / rays[..., 1], 0.0)
    depth[depth > 80] = 0
    along, across = np.array([np.cos(yaw), 0, -np.sin(yaw)]), np.array([np.sin(yaw), 0, np.cos(yaw)])
    axes, half = np.stack([along, across, [0, 1.0, 0]]), np.array(size) / 2
    start, way = -axes @ np.array(center), rays @ axes.T
    with np.errstate(divide="ignore", invalid="ignore"):
        enter = np.minimum((half - start) / way, (-half - start) / way).max(-1)
        leave = np.maximum((half - start) / way, (-half - start) / way).min(-1)
    hit = (enter < leave) & (enter > 0)
    depth[hit] = enter[hit]
    r, c = np.nonzero(hit)
    xyxy = np.array([[c.min() - 0.5, r.min() - 0.5, c.max() + 0.5, r.max() + 0.5]])
    return depth, xyxy


def detection(xyxy, name="car", style="projected") -> Detections2D:
    return Detections2D(xyxy, np.ones(len(xyxy)), np.zeros(len(xyxy), np.int64), (name,), style)


def clear(view) -> np.ndarray:
    """Indices of the well visible objects of a rendered view."""
    tall = view.detections.xyxy[:, 3] - view.detections.xyxy[:, 1]
    return np.nonzero((view.visible > 0.6) & ~view.truncated & (tall > 15))[0]

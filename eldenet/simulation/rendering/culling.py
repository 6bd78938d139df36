"""Leave out of a ray cast what cannot be in view: exact, and a third faster in a furnished room.

``mj_multiRay`` tests every ray against every body's bounding sphere and every geom's bounding angles. A
quarter of the picture sees only some of the geoms; the others are switched off while that quarter is cast.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

#: ``geomgroup`` argument of the ray functions under :func:`only_visible`.
SEEN_GROUPS = np.array([1, 1, 1, 1, 1, 0], dtype=np.uint8)
_HIDDEN = 5


def visible_geoms(
    model: Any, data: Any, position: np.ndarray, rotation: np.ndarray, windows: np.ndarray
) -> np.ndarray:
    """Which geoms may be seen through which window: ``(T, G)`` bool, never False for one that is.

    A geom is out of sight when its bounding box lies wholly beyond one side of the window's pyramid.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` with kinematics.
        position: ``(3,)`` camera center [m].
        rotation: ``(3, 3)`` world from camera.
        windows: ``(T, 4)`` bounds x0, x1, y0, y1 of each window on the image plane at distance 1.
    """
    axes = data.geom_xmat.reshape(-1, 3, 3)
    center = data.geom_xpos + np.einsum("gij,gj->gi", axes, model.geom_aabb[:, :3])
    center = (center - position) @ rotation  # (G, 3) in the camera frame
    spread = (
        np.einsum("ik,gij->gkj", rotation, axes) * model.geom_aabb[:, None, 3:]
    )  # half extents, (G, 3, 3)
    sides = np.zeros((len(windows), 5, 3))  # inward normals of left, right, top, bottom and "in front"
    sides[:, 0, 0], sides[:, 0, 2] = 1, -windows[:, 0]
    sides[:, 1, 0], sides[:, 1, 2] = -1, windows[:, 1]
    sides[:, 2, 1], sides[:, 2, 2] = 1, -windows[:, 2]
    sides[:, 3, 1], sides[:, 3, 2] = -1, windows[:, 3]
    sides[:, 4, 2] = 1
    flat = sides.reshape(-1, 3)
    reach = np.abs(flat @ spread).sum(axis=2)  # (G, T * 5)
    inside = center @ flat.T + reach >= -1e-6
    seen: np.ndarray = inside.reshape(-1, len(windows), 5).all(axis=2).T
    unbounded = (model.geom_aabb[:, 3:] <= 0).any(axis=1) | (model.geom_rbound <= 0)  # planes
    return seen | unbounded


@contextmanager
def only_visible(model: Any, seen: np.ndarray) -> Iterator[None]:
    """Switch the other geoms off for casts with :data:`SEEN_GROUPS`; the model is as before afterwards.

    Not for two threads on one model.

    Args:
        model: ``mujoco.MjModel``.
        seen: ``(G,)`` bool.
    """
    groups, counts, trees = model.geom_group.copy(), model.body_geomnum.copy(), model.body_bvhadr.copy()
    bodies = np.zeros(model.nbody, dtype=bool)
    bodies[model.geom_bodyid[seen]] = True
    try:
        model.geom_group[:] = np.where(seen, 0, _HIDDEN)
        model.body_geomnum[~bodies] = 0
        model.body_bvhadr[~bodies] = -1  # without it, an empty body still costs its bounding sphere
        yield
    finally:
        model.geom_group[:], model.body_geomnum[:], model.body_bvhadr[:] = groups, counts, trees

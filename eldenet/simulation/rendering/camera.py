"""An RGB-D camera for any MuJoCo model, by ray casting: no GPU, no display.

Convention: the camera frame is OpenCV's (x right, y down, z forward), pixel centers lie on whole numbers
(see :mod:`eldenet.geometry`); ``rotation`` is world-from-camera, so its columns are the camera's right,
down and forward in world coordinates, and ``position`` is the optical center in the world [m]. ``model`` and
``data`` are MuJoCo's, with up-to-date kinematics (``mj_forward`` or ``mj_kinematics``).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

#: ``geomgroup`` argument of MuJoCo's ray functions under :func:`only_visible`.
SEEN_GROUPS = np.array([1, 1, 1, 1, 1, 0], dtype=np.uint8)
_HIDDEN = 5


class Hits(NamedTuple):
    """What the rays of one frame hit, row by row; ``N = H * W``."""

    depth: np.ndarray  # (N,) float64, distance along the optical axis [m]; 0 where nothing was hit
    geom: np.ndarray  # (N,) int32 geom number, -1 where nothing was hit
    point: np.ndarray  # (3, N) float32 world points [m]
    normal: np.ndarray  # (3, N) float32 unit outward surface normals in the world


class RayCamera:
    """A pinhole RGB-D camera on ``mujoco.mj_multiRay``.

    Depth is exact at every pixel: the distance along the optical axis from the pixel's center ray.

    Args:
        size: ``(height, width)`` [px].
        intrinsics: ``(3, 3)`` [px]; see :func:`eldenet.geometry.pinhole`.
        far: rays end here [m].
    """

    def __init__(self, size: tuple[int, int], intrinsics: np.ndarray, far: float = 60.0) -> None:
        height, width = size
        matrix = np.asarray(intrinsics, dtype=np.float64)
        self.size, self.intrinsics = size, matrix
        self.far = float(far)
        x = (np.arange(width) - matrix[0, 2]) / matrix[0, 0]
        y = ((np.arange(height) - matrix[1, 2]) / matrix[1, 1])[:, None]
        scale = 1.0 / np.sqrt(1.0 + x * x + y * y)  # z of a ray of unit length
        self._scale = scale.ravel()
        self._rays = np.stack([x * scale, y * scale, scale]).reshape(3, -1)
        self._quarters, self._windows = self._split(x, y.ravel())

    def cast(self, model: Any, data: Any, position: np.ndarray, rotation: np.ndarray) -> Hits:
        """Send one ray per pixel."""
        rotation = np.asarray(rotation, dtype=np.float64)
        rays = self.rays(rotation)
        geom = np.empty(len(rays), np.int32)
        distance, normal = np.empty(len(rays)), np.empty((len(rays), 3))
        seen = visible_geoms(model, data, np.asarray(position), rotation, self._windows)
        for pixels, geoms in zip(self._quarters, seen, strict=True):
            with only_visible(model, geoms):
                distance[pixels], geom[pixels], normal[pixels] = cast_rays(
                    model, data, position, rays[pixels], self.far, groups=SEEN_GROUPS
                )
        missed = geom < 0
        depth = distance * self._scale
        depth[missed] = 0.0
        distance[missed] = self.far
        point = np.stack([distance * rays[:, k] + float(position[k]) for k in range(3)]).astype(np.float32)
        normals = np.ascontiguousarray(normal.T, dtype=np.float32)
        return Hits(depth, geom, point, normals)

    def _split(self, x: np.ndarray, y: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
        """Return the pixel numbers ``(n,)`` of the image's quarters, and their windows ``(4, 4)``."""
        number = np.arange(len(x) * len(y)).reshape(len(y), len(x))
        quarters, windows = [], []
        for top, bottom in _halves(len(y)):
            for left, right in _halves(len(x)):
                quarters.append(number[top:bottom, left:right].ravel())
                windows.append((x[left], x[right - 1], y[top], y[bottom - 1]))
        return quarters, np.array(windows)

    def rays(self, rotation: np.ndarray) -> np.ndarray:
        """Return every pixel's unit ray ``(N, 3)`` in the world, row by row."""
        return np.ascontiguousarray((np.asarray(rotation, dtype=np.float64) @ self._rays).T)

    def probe(
        self, model: Any, data: Any, position: np.ndarray, rotation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return depth ``(N,)`` [m], ``inf`` where nothing was hit, and geom ``(N,)`` alone; cheap."""
        distance, geom, _ = cast_rays(model, data, position, self.rays(rotation), self.far, normals=False)
        return np.where(geom < 0, np.inf, distance * self._scale), geom


def cast_rays(
    model: Any,
    data: Any,
    origin: np.ndarray,
    rays: np.ndarray,
    far: float,
    *,
    normals: bool = True,
    groups: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cast unit rays ``(N, 3)`` from one point.

    Returns:
        Distance ``(N,)`` along the ray [m], geom number ``(N,)`` (-1: none), normals ``(N, 3)``
        (empty without ``normals``).
    """
    import mujoco

    count = len(rays)
    geom = np.empty(count, np.int32)
    distance = np.empty(count, np.float64)
    normal = np.zeros(3 * count, np.float64) if normals else None
    mujoco.mj_multiRay(
        model, data, np.asarray(origin, dtype=np.float64), np.ascontiguousarray(rays).ravel(),
        groups, 1, -1, geom, distance, normal, count, far,
    )  # fmt: skip
    return distance, geom, normal.reshape(-1, 3) if normal is not None else np.empty((0, 3))


def _halves(length: int) -> list[tuple[int, int]]:
    return [(0, length)] if length < 32 else [(0, length // 2), (length // 2, length)]


def camera_rotation(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Return the world-from-camera rotation ``(3, 3)`` in a z-up world.

    Args:
        yaw: heading of the optical axis, counter-clockwise from world x [rad].
        pitch: upwards positive [rad].
        roll: clockwise as seen from behind the camera [rad].
    """
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    forward = np.array([cy * cp, sy * cp, sp])
    right = np.array([sy, -cy, 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=1)


def visible_geoms(
    model: Any, data: Any, position: np.ndarray, rotation: np.ndarray, windows: np.ndarray
) -> np.ndarray:
    """Return which geoms each window may show: ``(T, G)`` bool, never False for one that is in view.

    Casting each quarter of the image against its own geoms is exact, and a third faster in a furnished
    room: ``mj_multiRay`` tests every ray against every body's bounding sphere. A geom is out of view when
    its bounding box lies wholly beyond one side of the window's pyramid. ``windows (T, 4)`` are the bounds
    x0, x1, y0, y1 of each on the image plane at distance 1.
    """
    axes = data.geom_xmat.reshape(-1, 3, 3)
    center = data.geom_xpos + np.einsum("gij,gj->gi", axes, model.geom_aabb[:, :3])
    center = (center - position) @ rotation  # (G, 3) in the camera frame
    half_extents = np.einsum("ik,gij->gkj", rotation, axes) * model.geom_aabb[:, None, 3:]  # (G, 3, 3)
    sides = np.zeros((len(windows), 5, 3))  # inward normals of left, right, top, bottom and "in front"
    sides[:, 0, 0], sides[:, 0, 2] = 1, -windows[:, 0]
    sides[:, 1, 0], sides[:, 1, 2] = -1, windows[:, 1]
    sides[:, 2, 1], sides[:, 2, 2] = 1, -windows[:, 2]
    sides[:, 3, 1], sides[:, 3, 2] = -1, windows[:, 3]
    sides[:, 4, 2] = 1
    flat = sides.reshape(-1, 3)
    reach = np.abs(flat @ half_extents).sum(axis=2)  # (G, T * 5)
    inside = center @ flat.T + reach >= -1e-6
    seen: np.ndarray = inside.reshape(-1, len(windows), 5).all(axis=2).T
    unbounded = (model.geom_aabb[:, 3:] <= 0).any(axis=1) | (model.geom_rbound <= 0)  # planes
    return seen | unbounded


@contextmanager
def only_visible(model: Any, seen: np.ndarray) -> Iterator[None]:
    """Hide all geoms but ``seen (G,)`` from rays cast with :data:`SEEN_GROUPS`; restore the model afterwards.

    Not thread-safe: the model changes meanwhile.
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

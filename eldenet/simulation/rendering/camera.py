"""An RGB-D camera that looks into any MuJoCo model with rays: no GPU, no display.

Convention: the camera frame is OpenCV's (x right, y down, z forward), pixel centers lie on whole numbers
(see :mod:`eldenet.geometry`); ``rotation`` is world-from-camera, so its columns are the camera's right,
down and forward in world coordinates, and ``position`` is the optical center in the world [m].
"""

from typing import Any, NamedTuple

import numpy as np

from eldenet.geometry import pinhole
from eldenet.simulation.rendering.culling import SEEN_GROUPS, only_visible, visible_geoms

#: Color rays that meet nothing, RGB in [0, 1].
SKY = (0.75, 0.82, 0.9)


class Hits(NamedTuple):
    """What the rays of one frame met, row by row; ``N = H * W``.

    Attributes:
        depth: ``(N,)`` float64, distance along the optical axis [m]; 0 where nothing was met.
        geom: ``(N,)`` int32 geom number, -1 where nothing was met.
        point: ``(3, N)`` float32 world points [m].
        normal: ``(3, N)`` float32 unit outward surface normals in the world.
    """

    depth: np.ndarray
    geom: np.ndarray
    point: np.ndarray
    normal: np.ndarray


class RayCamera:
    """A pinhole RGB-D camera on ``mujoco.mj_multiRay``.

    Depth is exact at every pixel: the distance along the optical axis from the pixel's center ray.

    Args:
        size: ``(height, width)`` [px].
        intrinsics: ``(3, 3)`` [px]; see :func:`eldenet.geometry.pinhole`.
        far: rays end here [m].

    Raises:
        ValueError: size or intrinsics make no camera.
    """

    def __init__(self, size: tuple[int, int], intrinsics: np.ndarray, far: float = 60.0) -> None:
        height, width = int(size[0]), int(size[1])
        if height < 1 or width < 1:
            raise ValueError(f"size={tuple(size)}: give (height, width) of at least 1 pixel each")
        matrix = np.asarray(intrinsics, dtype=np.float64)
        if matrix.shape != (3, 3) or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise ValueError(
                f"intrinsics of shape {matrix.shape} with focal lengths {matrix.diagonal()[:2]}: "
                "give a 3x3 matrix with fx, fy > 0, e.g. eldenet.geometry.pinhole(fx, fy, cx, cy)"
            )
        self.size = (height, width)
        self.intrinsics = matrix
        self.far = float(far)
        x = (np.arange(width) - matrix[0, 2]) / matrix[0, 0]
        y = ((np.arange(height) - matrix[1, 2]) / matrix[1, 1])[:, None]
        scale = 1.0 / np.sqrt(1.0 + x * x + y * y)  # z of a ray of unit length
        self._scale = scale.ravel()
        self._rays = np.stack([x * scale, y * scale, scale]).reshape(3, -1)
        self._quarters, self._windows = self._split(x, y.ravel())

    def cast(self, model: Any, data: Any, position: np.ndarray, rotation: np.ndarray) -> Hits:
        """Send one ray per pixel.

        Args:
            model: ``mujoco.MjModel``.
            data: ``mujoco.MjData`` with up-to-date kinematics (``mj_forward`` or ``mj_kinematics``).
            position: ``(3,)`` optical center in the world [m].
            rotation: ``(3, 3)`` world from camera.
        """
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
        """Pixel numbers of the picture's quarters and their windows on the image plane."""
        number = np.arange(len(x) * len(y)).reshape(len(y), len(x))
        quarters, windows = [], []
        for top, bottom in _halves(len(y)):
            for left, right in _halves(len(x)):
                quarters.append(number[top:bottom, left:right].ravel())
                windows.append((x[left], x[right - 1], y[top], y[bottom - 1]))
        return quarters, np.array(windows)

    def rays(self, rotation: np.ndarray) -> np.ndarray:
        """Unit ray ``(N, 3)`` of every pixel in the world, row by row."""
        return np.ascontiguousarray((np.asarray(rotation, dtype=np.float64) @ self._rays).T)

    def probe(
        self, model: Any, data: Any, position: np.ndarray, rotation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Depth ``(N,)`` [m], ``inf`` where nothing was met, and geom ``(N,)`` alone: the cheap look."""
        distance, geom, _ = cast_rays(model, data, position, self.rays(rotation), self.far, normals=False)
        return np.where(geom < 0, np.inf, distance * self._scale), geom

    def render(
        self, model: Any, data: Any, position: np.ndarray, rotation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render with the model's own colors and a light at the camera.

        Returns:
            Image ``(H, W, 3)`` uint8 RGB and depth ``(H, W)`` float32 [m], 0 = nothing within ``far``.
        """
        hits = self.cast(model, data, position, rotation)
        colors = np.vstack([geom_colors(model), np.array([SKY], dtype=np.float32)])  # -1 is the last: sky
        forward = -np.asarray(rotation, dtype=np.float32)[:, 2]
        light = 0.45 + 0.4 * np.clip(forward @ hits.normal, 0, 1) + 0.15 * hits.normal[2]
        light[hits.geom < 0] = 1.0
        image = np.clip(colors[hits.geom] * light[:, None] * 255 + 0.5, 0, 255).astype(np.uint8)
        return image.reshape(*self.size, 3), hits.depth.astype(np.float32).reshape(self.size)


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


def geom_colors(model: Any) -> np.ndarray:
    """RGB ``(G, 3)`` float32 of every geom: its material's color where it has one."""
    colors = model.geom_rgba[:, :3].astype(np.float32).copy()
    painted = model.geom_matid >= 0
    colors[painted] = model.mat_rgba[model.geom_matid[painted], :3]
    return colors


def camera_rotation(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """World-from-camera rotation ``(3, 3)`` of a camera in a z-up world.

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


def kinect_intrinsics(size: tuple[int, int]) -> np.ndarray:
    """Intrinsics of NYU Depth V2's labelled frames (640x480), stretched to ``size`` [px]."""
    height, width = size
    sx, sy = width / 640, height / 480
    return pinhole(518.8579 * sx, 519.4696 * sy, (325.5824 + 0.5) * sx - 0.5, (253.7362 + 0.5) * sy - 0.5)

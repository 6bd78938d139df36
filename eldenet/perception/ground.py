"""The ground: a plane fitted to depth or known from calibration, and the bird's-eye view it gives."""

from dataclasses import dataclass

import numpy as np

from eldenet.geometry import PinholeCamera, check_camera_height

MAX_SLOPE = 0.27  # [rad], 15 degrees: of a plane that counts as ground, in the level frame
HEIGHTS = (0.01, 20.0)  # of a camera above the ground, up to that on a mast [m]
_TRIALS = 128
_SAMPLES = 1500


@dataclass(frozen=True)
class GroundPlane:
    """Points with ``normal . X = offset`` in the level frame; the normal points down.

    Attributes:
        normal: ``(3,)`` unit.
        offset: height of the frame's origin above the ground [m].
        tilt: by which the ground may rise or fall elsewhere [rad].
        fitted: True for a plane fitted to a depth map: it shares the errors of the depth.
    """

    normal: np.ndarray
    offset: float
    tilt: float = 0.01
    fitted: bool = False

    def height_above(self, points: np.ndarray) -> np.ndarray:
        """Height ``(...)`` of level points ``(..., 3)`` above the ground [m]."""
        return np.asarray(self.offset - points @ self.normal)

    def y_at(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Y of the ground at ``(x, z)`` [m]."""
        n = self.normal
        return np.asarray((self.offset - n[0] * x - n[2] * z) / n[1])


def flat_ground(camera_height: float, camera: PinholeCamera | None = None) -> GroundPlane:
    """Level ground ``camera_height`` [m] below the camera; its ``tilt`` is that of a driving car, 0.02 rad.

    Without a camera, the height is that of the level frame's origin.

    Raises:
        ValueError: the height is not 0.01 to 20 m.
    """
    check_camera_height(camera_height, HEIGHTS[0], HEIGHTS[1])
    eye = 0.0 if camera is None else float(camera.translation[1])
    return GroundPlane(np.array([0.0, 1.0, 0.0]), eye + float(camera_height), tilt=0.02)


def fit_ground(
    depth: np.ndarray, camera: PinholeCamera, *, max_slope: float = MAX_SLOPE
) -> GroundPlane | None:
    """Fit the ground to a depth map ``(H, W)`` [m] (0 or NaN: unknown): RANSAC, then least squares.

    Return None if the lower half of the image has fewer than 50 known pixels, or no plane below the camera,
    tilted by at most ``max_slope`` [rad] in the level frame, holds a tenth of them.
    """
    rng = np.random.default_rng(0)
    rows, columns = _known_pixels(depth, rng)
    if len(rows) < 50:
        return None
    distance = depth[rows, columns]  # along the optical axis, wherever that points in the level frame
    points = camera.back_project(columns, rows, distance) - camera.translation
    triple = points[rng.integers(0, len(points), (_TRIALS, 3))]
    normals = np.cross(triple[:, 1] - triple[:, 0], triple[:, 2] - triple[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(length, 1e-12)[:, None]
    normals *= np.where(normals[:, 1:2] < 0, -1.0, 1.0)
    offsets = (normals * triple[:, 0]).sum(1)
    tolerance = floor_tolerance(distance)
    inliers = np.abs(normals @ points.T - offsets[:, None]) < tolerance
    votes = (inliers / (1.0 + 0.05 * distance)).sum(1)  # near points say more about the height
    votes[(length < 1e-9) | (normals[:, 1] < np.cos(max_slope)) | (offsets <= 0)] = -1
    best = int(np.argmax(votes))
    if votes[best] <= 0:
        return None
    normal, offset, inside = normals[best], offsets[best], inliers[best]
    for _ in range(3):
        if inside.sum() < 10:
            return None
        # y = (offset - nx x - nz z) / ny, solved for the three ratios
        matrix = np.column_stack([points[inside, 0], points[inside, 2], np.ones(inside.sum())])
        weight = 1 / tolerance[inside]
        a, b, c = np.linalg.lstsq(matrix * weight[:, None], points[inside, 1] * weight, rcond=None)[0]
        scale = 1 / np.sqrt(1 + a * a + b * b)
        normal, offset = np.array([-a, 1.0, -b]) * scale, float(c * scale)
        inside = np.abs(points @ normal - offset) < tolerance
    if normal[1] < np.cos(max_slope) or offset <= 0 or inside.mean() < 0.1:
        return None
    return GroundPlane(normal, float(offset + normal @ camera.translation), fitted=True)


def floor_tolerance(distance: np.ndarray) -> np.ndarray:
    """How far a point at ``distance (N,)`` [m] may lie off its plane [m]: depth errors grow with depth."""
    return 0.03 + 0.012 * distance


def _known_pixels(depth: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns ``(P,)`` of up to ``_SAMPLES`` pixels of the lower half whose depth is known."""
    top, width = depth.shape[0] // 2, depth.shape[1]
    lower = depth[top:].reshape(-1)
    tried = rng.integers(0, len(lower), 2 * _SAMPLES)
    chosen = tried[np.isfinite(lower[tried]) & (lower[tried] > 0)][:_SAMPLES]
    if len(chosen) < _SAMPLES:  # sparse depth, or a small image
        known = np.nonzero(np.isfinite(lower) & (lower > 0))[0]
        chosen = rng.permutation(known)[:_SAMPLES]
    return chosen // width + top, chosen % width


@dataclass(frozen=True)
class GroundHomography:
    """Image <-> ground: ``[x, z, 1] ~ M [j, i, 1]``; the plane implies the depth.

    The depth of a pixel p on the plane n . X = d is ``h = (d - n . t) / (n . H p)`` with ``H = R K^-1``;
    inserted in equation 1, this gives a 3x3 matrix. It holds for points on the ground only. From a car's
    roof, one degree of pitch moves a point at 20 m by a fifth of its distance.

    Attributes:
        camera: of the image.
        plane: the ground.
    """

    camera: PinholeCamera
    plane: GroundPlane

    @classmethod
    def from_camera(cls, camera: PinholeCamera, height: float) -> "GroundHomography":
        """From calibration: the level frame's origin is ``height`` [m] above level ground."""
        return cls(camera, flat_ground(height))

    @classmethod
    def from_depth(cls, depth: np.ndarray, camera: PinholeCamera) -> "GroundHomography":
        """From a depth map ``(H, W)`` [m].

        Raises:
            ValueError: the depth map shows no ground.
        """
        plane = fit_ground(depth, camera)
        if plane is None:
            raise ValueError(
                "the depth map shows no ground (no nearly level plane below the camera): "
                "give the camera's height with GroundHomography.from_camera"
            )
        return cls(camera, plane)

    @property
    def matrix(self) -> np.ndarray:
        """``(3, 3)`` from pixels (column, row, 1) to ground (x, z, 1), up to scale."""
        h, t, n = self.camera.homography, self.camera.translation, self.plane.normal
        height = self.plane.offset - n @ t
        return np.stack([height * h[0] + t[0] * (n @ h), height * h[2] + t[2] * (n @ h), n @ h])

    def depth(self, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Depth ``(...)`` [m] of ground pixels ``(...)``; inf at and above the horizon."""
        pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(np.float64)
        slope = pixels @ (self.plane.normal @ self.camera.homography)
        height = self.plane.offset - self.plane.normal @ self.camera.translation
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(slope > 1e-9, height / slope, np.inf)

    def to_ground(self, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Ground ``(..., 2)`` x, z [m] of pixels below the horizon; NaN above it."""
        ground = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(np.float64) @ self.matrix.T
        w = np.where(ground[..., 2:] > 1e-9, ground[..., 2:], np.nan)
        return np.asarray((ground / w)[..., :2])

    def warp(
        self, image: np.ndarray, *, across: tuple[float, float], ahead: tuple[float, float], cell: float
    ) -> np.ndarray:
        """Warp ``image`` to a bird's-eye view of the ground on a grid of ``cell`` [m], far rows on top.

        Args:
            image: ``(H, W, 3)`` uint8.
            across: range of x [m].
            ahead: range of z [m].
            cell: size of a pixel of the result [m].

        Returns:
            ``(rows, columns, 3)`` uint8, black where the camera does not look.
        """
        import cv2

        width, height = round((across[1] - across[0]) / cell), round((ahead[1] - ahead[0]) / cell)
        grid = np.array(
            [[1 / cell, 0, -across[0] / cell - 0.5], [0, -1 / cell, ahead[1] / cell - 0.5], [0, 0, 1]]
        )
        warp = grid @ self.matrix
        above = np.asarray(cv2.warpPerspective(image, warp, (width, height)))
        # the formula also gives the ground behind the camera pixels, mirrored: the camera does not see them
        rows, columns = np.indices((height, width), dtype=np.float64)
        back = np.linalg.inv(warp)[2]
        above[back[0] * columns + back[1] * rows + back[2] <= 0] = 0
        return above

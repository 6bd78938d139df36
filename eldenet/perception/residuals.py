"""What the fit of a box measures, as residuals with derivatives: points, 2D box, ground, class, depth factor.

Unknowns: x, z of the center, y of the lower face, yaw, logarithms of length, width, height, and of the factor
on the object's depth. Every array has the problems as its first axis ``B``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eldenet.geometry import PinholeCamera

UNKNOWNS = 8
X, Z, BOTTOM, YAW, LENGTH, WIDTH, HEIGHT, SCALE = range(UNKNOWNS)
_INFORMATION = 10.0  # independent measurements that the points of an object are worth
_DEEPEST = -2.0  # [m]: points deeper inside a box count as being there
_NEAREST = 0.3  # [m]: silhouette points nearer than that to the picture's plane are left out


@dataclass(frozen=True)
class Problem:
    """What is known of each object; ``B`` problems, ``P`` points, ``M`` silhouette points.

    Attributes:
        direction: ``(B, P, 3)``, depth ``(B, P)``, weight ``(B, P)``: of :class:`Foreground`.
        depth: see above.
        weight: see above.
        point_sigma: ``(B, 2)`` of a point outside and inside the surface [m].
        fill: ``(B,)`` share of the box's length and width at which that surface lies.
        xyxy: ``(B, 4)`` 2D boxes [px].
        edge_sigma: ``(B, 4)`` [px].
        trusted: ``(B, 4)`` bool; an edge that is not may lie further out.
        silhouette: ``(B, M, 3)`` in units of length, height, width.
        log_size: ``(B, 3)`` of the class.
        size_sigma: ``(B, 3)`` of it.
        ground: ``(B, 3)`` y of the ground = a + b x + c z.
        ground_sigma: ``(B,)`` [m]; inf: no ground.
        scale_sigma: ``(B,)`` of the logarithm of the factor on depth.
    """

    direction: np.ndarray
    depth: np.ndarray
    weight: np.ndarray
    point_sigma: np.ndarray
    fill: np.ndarray
    xyxy: np.ndarray
    edge_sigma: np.ndarray
    trusted: np.ndarray
    silhouette: np.ndarray
    log_size: np.ndarray
    size_sigma: np.ndarray
    ground: np.ndarray
    ground_sigma: np.ndarray
    scale_sigma: np.ndarray

    def repeat(self, times: int) -> "Problem":
        """Every object ``times`` times, one after the other."""
        return Problem(**{name: np.repeat(value, times, axis=0) for name, value in vars(self).items()})

    def select(self, chosen: np.ndarray | slice) -> "Problem":
        """Those that ``chosen`` (bool, numbers or a slice) picks."""
        return Problem(**{name: value[chosen] for name, value in vars(self).items()})


class _Nearest(NamedTuple):
    """The face of the box that each point should lie on: ``(B, P)`` each.

    Attributes:
        residual: distance beyond the face [m]; negative inside the box.
        outside: bool: the point is outside the box.
        to_u: d residual / d u, the coordinate along the length: -1, 0 or 1.
        to_v: the same across.
        to_up: the same upward.
    """

    residual: np.ndarray
    outside: np.ndarray
    to_u: np.ndarray
    to_v: np.ndarray
    to_up: np.ndarray


def points(
    problem: Problem, camera: PinholeCamera, state: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points lie on the sides and the roof that face the camera; robust (Cauchy)."""
    c, s = np.cos(state[:, YAW])[:, None], np.sin(state[:, YAW])[:, None]
    half_l, half_w = (0.5 * problem.fill[:, None] * np.exp(state[:, [k]]) for k in (LENGTH, WIDTH))
    tall = np.exp(state[:, [HEIGHT]])
    factor = np.exp(state[:, SCALE])[:, None]
    ray = problem.depth[..., None] * problem.direction * factor[..., None]  # dX / dlog scale
    x = ray[..., 0] + (camera.translation[0] - state[:, [X]])
    z = ray[..., 2] + (camera.translation[2] - state[:, [Z]])
    u, v = x * c - z * s, x * s + z * c
    up = state[:, [BOTTOM]] - ray[..., 1] - camera.translation[1]
    ex, ez = camera.translation[0] - state[:, [X]], camera.translation[2] - state[:, [Z]]
    eye = ex * c - ez * s, ex * s + ez * c, state[:, [BOTTOM]] - camera.translation[1]
    near = _nearest_faces((u, v, up), eye, half_l, half_w, tall)
    to_x, to_z = near.to_u * c + near.to_v * s, near.to_v * c - near.to_u * s
    jacobian = np.stack(
        [
            -to_x,
            -to_z,
            near.to_up,
            -near.to_u * v + near.to_v * u,
            -np.abs(near.to_u) * half_l,
            -np.abs(near.to_v) * half_w,
            -near.to_up * tall,
            to_x * ray[..., 0] + to_z * ray[..., 2] - near.to_up * ray[..., 1],
        ],
        axis=-1,
    )
    # in the depth map's own meters: measured after the factor, misfits would shrink with it
    residual = near.residual / factor
    jacobian /= factor[..., None]
    jacobian[..., SCALE] -= residual
    sigma = np.where(near.outside, problem.point_sigma[:, :1], problem.point_sigma[:, 1:])
    share = _INFORMATION / np.maximum(problem.weight.sum(1, keepdims=True), _INFORMATION)
    weight, relative = problem.weight * share, residual / sigma
    cost = 0.5 * (weight * np.log1p(relative**2)).sum(1)
    weighted = jacobian * (weight / (1 + relative**2) / sigma**2)[..., None]
    gradient = (residual[:, None, :] @ weighted)[:, 0]
    return cost, gradient, weighted.transpose(0, 2, 1) @ jacobian


def _nearest_faces(
    point: tuple[np.ndarray, np.ndarray, np.ndarray],
    eye: tuple[np.ndarray, np.ndarray, np.ndarray],
    half_l: np.ndarray,
    half_w: np.ndarray,
    tall: np.ndarray,
) -> _Nearest:
    """Of points ``(B, P)`` and camera ``(B, 1)`` along the box's axes: length, width, up from its lower face.

    A point outside belongs to the face that it is farthest beyond, one inside to the nearest of those that
    the camera sees.
    """
    u, v, up = point
    beyond = np.stack([np.abs(u) - half_l, np.abs(v) - half_w, up - tall])
    face = beyond.argmax(0)
    excess = np.take_along_axis(beyond, face[None], 0)[0]
    outside = excess > 0
    toward_u, toward_v = np.sign(eye[0]), np.sign(eye[1])
    seen = np.stack(
        [
            np.where(np.abs(eye[0]) > half_l, toward_u * u - half_l, -1e3),
            np.where(np.abs(eye[1]) > half_w, toward_v * v - half_w, -1e3),
            np.where(eye[2] > tall, up - tall, -1e3),
        ]
    )
    face = np.where(outside, face, seen.argmax(0))
    within = np.maximum(np.take_along_axis(seen, face[None], 0)[0], _DEEPEST)
    on_u, on_v, on_top = ((face == k).astype(np.float64) for k in range(3))
    return _Nearest(
        np.where(outside, excess, within),
        outside,
        on_u * np.where(outside, np.sign(u), toward_u),
        on_v * np.where(outside, np.sign(v), toward_v),
        on_top,
    )


def edges(problem: Problem, camera: PinholeCamera, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The silhouette's extent in the picture is the 2D box: ``(B, 4)`` residuals and their derivatives."""
    offset, d_yaw = _offsets(problem.silhouette, state)
    center = np.stack([state[:, X], state[:, BOTTOM], state[:, Z]], axis=-1)[:, None]
    seen = camera.to_camera(center + offset)
    visible = seen[..., 2] > _NEAREST
    depth = np.where(visible, seen[..., 2], 1.0)
    matrix = camera.intrinsics
    pixel = np.stack([seen[..., k] / depth * matrix[k, k] + matrix[k, 2] for k in (0, 1)])  # (2, B, M)
    low = np.where(visible, pixel, np.inf).argmin(2)
    high = np.where(visible, pixel, -np.inf).argmax(2)
    at = np.stack([low[0], low[1], high[0], high[1]], axis=1)  # (B, 4) silhouette point of each edge
    axis = np.array([0, 1, 0, 1])
    rows = np.arange(len(state))[:, None]
    value = pixel[axis[None], rows, at]
    out = np.array([-1.0, -1.0, 1.0, 1.0])
    residual = (value - problem.xyxy) / problem.edge_sigma
    # an edge that is cut or hidden is a bound: the object reaches at least so far
    active = problem.trusted | ((problem.xyxy - value) * out > 0)
    active &= np.any(visible, axis=1, keepdims=True)
    residual = np.where(active, residual, 0.0)
    point, far = seen[rows, at], depth[rows, at]
    focal = np.array([matrix[0, 0], matrix[1, 1]])[axis]
    # d pixel / d camera point, then into the level frame
    d_seen = np.zeros((len(state), 4, 3))
    d_seen[:, np.arange(4), axis] = focal / far
    d_seen[..., 2] = -focal * point[:, np.arange(4), axis] / far**2
    d_level = d_seen @ camera.rotation.T
    unit = np.take_along_axis(problem.silhouette, at[..., None], 1)
    size = np.exp(state[:, None, [LENGTH, HEIGHT, WIDTH]]) * unit
    c, s = np.cos(state[:, YAW])[:, None], np.sin(state[:, YAW])[:, None]
    turned = d_yaw[rows, at]
    jacobian = np.zeros((len(state), 4, UNKNOWNS))
    jacobian[..., X], jacobian[..., BOTTOM], jacobian[..., Z] = np.moveaxis(d_level, -1, 0)
    jacobian[..., YAW] = d_level[..., 0] * turned[..., 0] + d_level[..., 2] * turned[..., 1]
    jacobian[..., LENGTH] = size[..., 0] * (d_level[..., 0] * c - d_level[..., 2] * s)
    jacobian[..., WIDTH] = size[..., 2] * (d_level[..., 0] * s + d_level[..., 2] * c)
    jacobian[..., HEIGHT] = d_level[..., 1] * (size[..., 1] - 0.5 * np.exp(state[:, [HEIGHT]]))
    jacobian *= (active / problem.edge_sigma)[..., None]
    return residual, jacobian


def _offsets(unit: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Silhouette ``(B, M, 3)`` around the middle of the lower face [m], and d(x, z) / d yaw ``(B, M, 2)``."""
    c, s = np.cos(state[:, YAW])[:, None], np.sin(state[:, YAW])[:, None]
    length, width, height = (np.exp(state[:, [k]]) for k in (LENGTH, WIDTH, HEIGHT))
    u, v = unit[..., 0] * length, unit[..., 2] * width
    offset = np.stack([u * c + v * s, (unit[..., 1] - 0.5) * height, -u * s + v * c], axis=-1)
    return offset, np.stack([-u * s + v * c, -u * c - v * s], axis=-1)


def beliefs(problem: Problem, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Size of the class, the ground below, a depth factor near 1: ``(B, 5)``."""
    residual, jacobian = np.zeros((len(state), 5)), np.zeros((len(state), 5, UNKNOWNS))
    residual[:, :3] = (state[:, [LENGTH, WIDTH, HEIGHT]] - problem.log_size) / problem.size_sigma
    for row, unknown in enumerate((LENGTH, WIDTH, HEIGHT)):
        jacobian[:, row, unknown] = 1 / problem.size_sigma[:, row]
    ground = problem.ground[:, 0] + problem.ground[:, 1] * state[:, X] + problem.ground[:, 2] * state[:, Z]
    residual[:, 3] = (state[:, BOTTOM] - ground) / problem.ground_sigma
    jacobian[:, 3, BOTTOM] = 1 / problem.ground_sigma
    jacobian[:, 3, X] = -problem.ground[:, 1] / problem.ground_sigma
    jacobian[:, 3, Z] = -problem.ground[:, 2] / problem.ground_sigma
    residual[:, 4] = state[:, SCALE] / problem.scale_sigma
    jacobian[:, 4, SCALE] = 1 / problem.scale_sigma
    return residual, jacobian

"""One least-squares fit per object: points, 2D box, ground and class size agree on a 3D box.

All objects and all starts are solved together by Levenberg-Marquardt with hand-written derivatives.
Unknowns: x and z of the center, y of the lower face, yaw, and the logarithms of length, width, height and of
the factor on the object's depth. The first axis ``B`` of every array counts the problems.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eldenet.boxes import ArrayRows
from eldenet.geometry import PinholeCamera

UNKNOWNS = 8
X, Z, BOTTOM, YAW, LENGTH, WIDTH, HEIGHT, SCALE = range(UNKNOWNS)
_STEPS = 14
_FIRST_STEPS = 5  # with all starts
_KEPT_STARTS = 2  # per object, for the remaining steps
_MIN_DECREASE = 1e-3  # a step that lowers the cost by less is the last
_TAIL = 3.0  # residuals of edges and priors beyond this lose their pull [sigma]
_MAX_STEP = np.array([3.0, 5.0, 0.5, 0.3, 0.2, 0.2, 0.2, 0.2])  # of each unknown
_MAX_DEPTH_INSIDE = -2.0  # [m]: points deeper inside a box count as if they were here
_MIN_Z = 0.3  # [m]: silhouette points nearer to the image plane are left out
_BEHIND = 1e3  # residual of the edges of a box wholly behind the camera, which sees no such thing [sigma]


@dataclass(frozen=True)
class Problem(ArrayRows):
    """Measurements and priors of ``B`` objects, with ``P`` points and ``M`` silhouette points each.

    Attributes:
        direction: ``(B, P, 3)`` rays of the points, see :class:`~eldenet.perception.foreground.Foreground`.
        depth: ``(B, P)`` of the points [m].
        weight: ``(B, P)`` of the points.
        worth: ``(B,)`` independent measurements that they are worth together.
        point_sigma: ``(B, 2)`` of a point outside and inside the surface [m].
        fill: ``(B,)`` share of the box's length and width at which that surface lies.
        xyxy: ``(B, 4)`` 2D boxes [px].
        edge_sigma: ``(B, 4)`` of the 2D boxes' edges [px].
        trusted: ``(B, 4)`` bool; the object may reach beyond an edge that is not trusted.
        silhouette: ``(B, M, 3)`` in units of length, height, width.
        log_size: ``(B, 3)`` of the class.
        size_sigma: ``(B, 3)`` of ``log_size``.
        ground: ``(B, 3)``: y of the ground = a + b x + c z.
        ground_sigma: ``(B,)`` [m]; 1e6: no ground.
        scale_sigma: ``(B,)`` of the logarithm of the factor on depth.
    """

    direction: np.ndarray
    depth: np.ndarray
    weight: np.ndarray
    worth: np.ndarray
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


class QuadraticModel(NamedTuple):
    """Cost ``(B,)``, gradient ``(B, 8)`` and Gauss-Newton matrix ``(B, 8, 8)`` around a state."""

    cost: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray


def solve(problem: Problem, camera: PinholeCamera, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit every object from each of its ``starts (N, S, 8)``; return unknowns ``(N, 8)`` and costs ``(N,)``.

    After a few steps only the cheapest starts of each object are continued.
    """
    count, several = starts.shape[:2]
    repeated = problem.select(np.repeat(np.arange(count), several))
    state, cost = _descend(repeated, camera, starts.reshape(-1, UNKNOWNS), _FIRST_STEPS)
    best = cost.reshape(count, several).argsort(1)[:, :_KEPT_STARTS] + several * np.arange(count)[:, None]
    kept = best.shape[1]
    state, cost = _descend(repeated.select(best.ravel()), camera, state[best.ravel()], _STEPS - _FIRST_STEPS)
    winner = cost.reshape(count, kept).argmin(1) + kept * np.arange(count)
    return state[winner], cost[winner]


def _descend(
    problem: Problem, camera: PinholeCamera, start: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt from ``start (B, 8)``; problems that have settled are not moved any more."""
    final, costs = start.copy(), np.zeros(len(start))
    rows = np.arange(len(start))  # of the problems that still move
    state = start.copy()
    model = linearize(problem, camera, state)
    damping = np.full(len(state), 1e-2)
    for _ in range(steps):
        diagonal = np.einsum("bii->bi", model.matrix)
        matrix = model.matrix + (damping[:, None] * diagonal + 1e-9)[..., None] * np.eye(UNKNOWNS)
        step = -np.linalg.solve(matrix, model.gradient[..., None])[..., 0]
        step *= np.minimum(1.0, (_MAX_STEP / np.maximum(np.abs(step), 1e-12)).min(1))[:, None]
        trial = state + step
        tried = linearize(problem, camera, trial)
        better = tried.cost < model.cost
        settled = (better & (model.cost - tried.cost < _MIN_DECREASE)) | (~better & (damping > 1.0))
        state = np.where(better[:, None], trial, state)
        model = QuadraticModel(
            np.where(better, tried.cost, model.cost),
            np.where(better[:, None], tried.gradient, model.gradient),
            np.where(better[:, None, None], tried.matrix, model.matrix),
        )
        damping = np.clip(np.where(better, damping * 0.25, damping * 6.0), 1e-6, 1e6)
        final[rows], costs[rows] = state, model.cost
        if settled.all():
            break
        if settled.mean() > 0.2:
            moving = ~settled
            rows, state, damping = rows[moving], state[moving], damping[moving]
            problem = problem.select(moving)
            model = QuadraticModel(*(part[moving] for part in model))
    return final, costs


def linearize(problem: Problem, camera: PinholeCamera, state: np.ndarray) -> QuadraticModel:
    """Cost and its quadratic model around ``state (B, 8)``."""
    cost, gradient, matrix = _point_terms(problem, camera, state)
    # edges and priors are robust too: one wrong edge must not bend the box
    for residual, jacobian in (_edge_residuals(problem, camera, state), _prior_residuals(problem, state)):
        robust = 1 / (1 + (residual / _TAIL) ** 2)
        cost = cost + 0.5 * _TAIL**2 * np.log1p((residual / _TAIL) ** 2).sum(1)
        weighted = jacobian * robust[..., None]
        gradient = gradient + np.einsum("bk,bki->bi", residual, weighted)
        matrix = matrix + weighted.transpose(0, 2, 1) @ jacobian
    return QuadraticModel(cost, gradient, matrix)


def _point_terms(
    problem: Problem, camera: PinholeCamera, state: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cost ``(B,)``, gradient, matrix of the points, which lie on the faces toward the camera (Cauchy)."""
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
    residual, outside, (to_u, to_v, to_up) = _face_distances((u, v, up), eye, (half_l, half_w, tall))
    to_x, to_z = to_u * c + to_v * s, to_v * c - to_u * s
    jacobian = np.stack(
        [
            -to_x,
            -to_z,
            to_up,
            -to_u * v + to_v * u,
            -np.abs(to_u) * half_l,
            -np.abs(to_v) * half_w,
            -to_up * tall,
            to_x * ray[..., 0] + to_z * ray[..., 2] - to_up * ray[..., 1],
        ],
        axis=-1,
    )
    # in the depth map's own meters: measured after the factor, misfits would shrink with it
    residual /= factor
    jacobian /= factor[..., None]
    jacobian[..., SCALE] -= residual
    sigma = np.where(outside, problem.point_sigma[:, :1], problem.point_sigma[:, 1:])
    share = problem.worth[:, None]
    share = share / np.maximum(problem.weight.sum(1, keepdims=True), share)
    weight, relative = problem.weight * share, residual / sigma
    cost = 0.5 * (weight * np.log1p(relative**2)).sum(1)
    weighted = jacobian * (weight / (1 + relative**2) / sigma**2)[..., None]
    gradient = (residual[:, None, :] @ weighted)[:, 0]
    return cost, gradient, weighted.transpose(0, 2, 1) @ jacobian


def _face_distances(
    point: tuple[np.ndarray, np.ndarray, np.ndarray],
    eye: tuple[np.ndarray, np.ndarray, np.ndarray],
    extent: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Distance ``(B, P)`` of every point beyond its face [m], whether it is outside, and derivatives.

    A point outside belongs to the face that it is farthest beyond, one inside to the nearest of the faces
    that the camera sees. ``point`` and ``eye`` are along the length (u), the width (v) and up from the lower
    face, ``extent`` is half the length, half the width and the height. The derivatives ``(B, P)`` of the
    distance with respect to u, v and up are -1, 0 or 1.
    """
    half_l, half_w, tall = extent
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
    within = np.maximum(np.take_along_axis(seen, face[None], 0)[0], _MAX_DEPTH_INSIDE)
    on_u, on_v, on_top = ((face == k).astype(np.float64) for k in range(3))
    to_u = on_u * np.where(outside, np.sign(u), toward_u)
    to_v = on_v * np.where(outside, np.sign(v), toward_v)
    return np.where(outside, excess, within), outside, (to_u, to_v, on_top)


def _edge_residuals(
    problem: Problem, camera: PinholeCamera, state: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The silhouette spans the 2D box: residuals ``(B, 4)`` and their derivatives ``(B, 4, 8)``."""
    c, s = np.cos(state[:, YAW])[:, None], np.sin(state[:, YAW])[:, None]
    length, width, height = (np.exp(state[:, [k]]) for k in (LENGTH, WIDTH, HEIGHT))
    unit = problem.silhouette
    u, v = unit[..., 0] * length, unit[..., 2] * width
    # of every silhouette point from the middle of the lower face, and its derivative with respect to yaw
    offset = np.stack([u * c + v * s, (unit[..., 1] - 0.5) * height, -u * s + v * c], axis=-1)
    d_yaw = np.stack([-u * s + v * c, -u * c - v * s], axis=-1)  # (x, z)
    center = np.stack([state[:, X], state[:, BOTTOM], state[:, Z]], axis=-1)[:, None]
    seen = camera.to_camera(center + offset)
    visible = seen[..., 2] > _MIN_Z
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
    # an edge that is cut or hidden is a bound: the object reaches at least this far
    active = problem.trusted | ((problem.xyxy - value) * out > 0)
    ahead = np.any(visible, axis=1, keepdims=True)
    active &= ahead
    residual = np.where(ahead, np.where(active, residual, 0.0), _BEHIND)
    point, far = seen[rows, at], depth[rows, at]
    focal = np.array([matrix[0, 0], matrix[1, 1]])[axis]
    # d pixel / d camera point, then into the level frame
    d_seen = np.zeros((len(state), 4, 3))
    d_seen[:, np.arange(4), axis] = focal / far
    d_seen[..., 2] = -focal * point[:, np.arange(4), axis] / far**2
    d_level = d_seen @ camera.rotation.T
    unit = np.take_along_axis(unit, at[..., None], 1)
    size = np.exp(state[:, None, [LENGTH, HEIGHT, WIDTH]]) * unit
    turned = d_yaw[rows, at]
    jacobian = np.zeros((len(state), 4, UNKNOWNS))
    jacobian[..., X], jacobian[..., BOTTOM], jacobian[..., Z] = np.moveaxis(d_level, -1, 0)
    jacobian[..., YAW] = d_level[..., 0] * turned[..., 0] + d_level[..., 2] * turned[..., 1]
    jacobian[..., LENGTH] = size[..., 0] * (d_level[..., 0] * c - d_level[..., 2] * s)
    jacobian[..., WIDTH] = size[..., 2] * (d_level[..., 0] * s + d_level[..., 2] * c)
    jacobian[..., HEIGHT] = d_level[..., 1] * (size[..., 1] - 0.5 * np.exp(state[:, [HEIGHT]]))
    jacobian *= (active / problem.edge_sigma)[..., None]
    return residual, jacobian


def _prior_residuals(problem: Problem, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Class size, ground, a depth factor near 1: residuals ``(B, 5)`` and derivatives ``(B, 5, 8)``."""
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

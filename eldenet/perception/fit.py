"""One small least-squares fit per object: points, 2D box, ground and class size agree on a box.

Unknowns: x, z of the centre, y of the lower face, yaw, logarithms of length, width, height, and of the factor
on the object's depth. All objects and all starts are solved together by Levenberg-Marquardt with hand-written
derivatives; every array has the problems as its first axis ``B``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eldenet.geometry import PinholeCamera

UNKNOWNS = 8
X, Z, BOTTOM, YAW, LENGTH, WIDTH, HEIGHT, SCALE = range(UNKNOWNS)
_STEPS = 14
_FIRST_STEPS = 5  # with all starts
_KEPT = 2  # starts of an object that go on after them
_GAIN = 1e-3  # a step that lowers the cost by less is the last
_TAIL = 3.0  # errors beyond which edges and beliefs lose their pull [sigma]
_INFORMATION = 10.0  # independent measurements that the points of an object are worth
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


class Linear(NamedTuple):
    """A quadratic model: cost ``(B,)``, gradient ``(B, 8)``, Gauss-Newton matrix ``(B, 8, 8)``."""

    cost: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray


def solve(problem: Problem, camera: PinholeCamera, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit every object from each of its ``starts (N, S, 8)``; returns unknowns ``(N, 8)`` and costs ``(N,)``.

    After a few steps the dearer starts of an object are given up.
    """
    count, several = starts.shape[:2]
    state, cost = _descend(problem.repeat(several), camera, starts.reshape(-1, UNKNOWNS), _FIRST_STEPS)
    best = cost.reshape(count, several).argsort(1)[:, :_KEPT] + several * np.arange(count)[:, None]
    kept = best.shape[1]
    state, cost = _descend(problem.repeat(kept), camera, state[best.ravel()], _STEPS - _FIRST_STEPS)
    winner = cost.reshape(count, kept).argmin(1) + kept * np.arange(count)
    return state[winner], cost[winner]


def _descend(
    problem: Problem, camera: PinholeCamera, start: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt from ``start (B, 8)``; what has settled is left alone."""
    final, costs = start.copy(), np.zeros(len(start))
    rows = np.arange(len(start))  # of the problems that are still moving
    state = start.copy()
    model = linearise(problem, camera, state)
    damping = np.full(len(state), 1e-2)
    eye = np.eye(UNKNOWNS)
    limit = np.array([3.0, 5.0, 0.5, 0.3, 0.2, 0.2, 0.2, 0.2])  # of one step
    for _ in range(steps):
        diagonal = np.einsum("bii->bi", model.matrix)
        matrix = model.matrix + (damping[:, None] * diagonal + 1e-9)[..., None] * eye
        step = -np.linalg.solve(matrix, model.gradient[..., None])[..., 0]
        step *= np.minimum(1.0, (limit / np.maximum(np.abs(step), 1e-12)).min(1))[:, None]
        trial = state + step
        tried = linearise(problem, camera, trial)
        better = tried.cost < model.cost
        settled = (better & (model.cost - tried.cost < _GAIN)) | (~better & (damping > 1.0))
        state = np.where(better[:, None], trial, state)
        model = Linear(
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
            rows, state, damping, problem = (
                rows[moving],
                state[moving],
                damping[moving],
                problem.select(moving),
            )
            model = Linear(*(part[moving] for part in model))
    return final, costs


def linearise(problem: Problem, camera: PinholeCamera, state: np.ndarray) -> Linear:
    """Cost and its quadratic model around ``state (B, 8)``."""
    cost, gradient, matrix = _points(problem, camera, state)
    residual, jacobian = _edges(problem, camera, state)
    # edges and beliefs are robust too: one wrong edge must not bend the box
    for extra, derivative in ((residual, jacobian), _beliefs(problem, state)):
        robust = 1 / (1 + (extra / _TAIL) ** 2)
        cost = cost + 0.5 * _TAIL**2 * np.log1p((extra / _TAIL) ** 2).sum(1)
        weighted = derivative * robust[..., None]
        gradient = gradient + np.einsum("bk,bki->bi", extra, weighted)
        matrix = matrix + weighted.transpose(0, 2, 1) @ derivative
    return Linear(cost, gradient, matrix)


def _points(
    problem: Problem, camera: PinholeCamera, state: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points lie on the sides and the roof that face the camera; robust (Cauchy)."""
    c, s = np.cos(state[:, YAW])[:, None], np.sin(state[:, YAW])[:, None]
    half = 0.5 * problem.fill[:, None]
    half_l, half_w, tall = (
        np.exp(state[:, [k]]) * f for k, f in ((LENGTH, half), (WIDTH, half), (HEIGHT, 1.0))
    )
    ray = (
        problem.depth[..., None] * problem.direction * np.exp(state[:, SCALE])[:, None, None]
    )  # dX / dlog scale
    x = ray[..., 0] + (camera.translation[0] - state[:, [X]])
    z = ray[..., 2] + (camera.translation[2] - state[:, [Z]])
    up = state[:, [BOTTOM]] - ray[..., 1] - camera.translation[1]
    u, v = x * c - z * s, x * s + z * c
    ex, ez = camera.translation[0] - state[:, [X]], camera.translation[2] - state[:, [Z]]
    eye_u, eye_v, eye_up = ex * c - ez * s, ex * s + ez * c, state[:, [BOTTOM]] - camera.translation[1]
    # signed distance beyond each side; the far sides count only for points that lie beyond them
    sign_u, sign_v = np.sign(u), np.sign(v)
    beyond = np.stack([np.abs(u) - half_l, np.abs(v) - half_w, up - tall])
    face = beyond.argmax(0)
    outside = np.take_along_axis(beyond, face[None], 0)[0] > 0
    toward_u, toward_v = np.sign(eye_u), np.sign(eye_v)
    seen = np.stack(
        [
            np.where(np.abs(eye_u) > half_l, toward_u * u - half_l, -1e3),
            np.where(np.abs(eye_v) > half_w, toward_v * v - half_w, -1e3),
            np.where(eye_up > tall, up - tall, -1e3),
        ]
    )
    face = np.where(outside, face, seen.argmax(0))
    residual = np.where(
        outside,
        np.take_along_axis(beyond, face[None], 0)[0],
        np.maximum(np.take_along_axis(seen, face[None], 0)[0], -2.0),
    )
    sigma = np.where(outside, problem.point_sigma[:, :1], problem.point_sigma[:, 1:])
    share = _INFORMATION / np.maximum(problem.weight.sum(1, keepdims=True), _INFORMATION)
    weight = problem.weight * share
    # in the depth map's own metres: measured after the factor, misfits would shrink with it
    shrink = np.exp(-state[:, SCALE])[:, None]
    residual = residual * shrink
    relative = residual / sigma
    cost = 0.5 * (weight * np.log1p(relative**2)).sum(1)
    robust = weight / (1 + relative**2) / sigma**2
    sign_u = np.where(outside, sign_u, toward_u)
    sign_v = np.where(outside, sign_v, toward_v)
    on_u, on_v, on_top = ((face == k).astype(np.float64) for k in range(3))
    to_u, to_v = on_u * sign_u, on_v * sign_v  # d residual / du, dv
    to_x, to_z = to_u * c + to_v * s, to_v * c - to_u * s
    jacobian = np.stack(
        [
            -to_x,
            -to_z,
            on_top,
            -to_u * v + to_v * u,
            -on_u * half_l,
            -on_v * half_w,
            -on_top * tall,
            to_x * ray[..., 0] + to_z * ray[..., 2] - on_top * ray[..., 1],
        ],
        axis=-1,
    )
    jacobian *= shrink[..., None]
    jacobian[..., SCALE] -= residual
    weighted = jacobian * robust[..., None]
    gradient = (residual[:, None, :] @ weighted)[:, 0]
    return cost, gradient, weighted.transpose(0, 2, 1) @ jacobian


def _edges(problem: Problem, camera: PinholeCamera, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def _beliefs(problem: Problem, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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

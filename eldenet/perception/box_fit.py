"""One small least-squares fit per object: points, 2D box, ground and class size agree on a box.

All objects and all starts are solved together by Levenberg-Marquardt with hand-written derivatives, see
:mod:`eldenet.perception.residuals`; every array has the problems as its first axis ``B``.
"""

from typing import NamedTuple

import numpy as np

from eldenet.geometry import PinholeCamera
from eldenet.perception.residuals import UNKNOWNS, Problem, beliefs, edges, points

_STEPS = 14
_FIRST_STEPS = 5  # with all starts
_KEPT = 2  # starts of an object that go on after them
_GAIN = 1e-3  # a step that lowers the cost by less is the last
_TAIL = 3.0  # errors beyond which edges and beliefs lose their pull [sigma]


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
    cost, gradient, matrix = points(problem, camera, state)
    residual, jacobian = edges(problem, camera, state)
    # edges and beliefs are robust too: one wrong edge must not bend the box
    for extra, derivative in ((residual, jacobian), beliefs(problem, state)):
        robust = 1 / (1 + (extra / _TAIL) ** 2)
        cost = cost + 0.5 * _TAIL**2 * np.log1p((extra / _TAIL) ** 2).sum(1)
        weighted = derivative * robust[..., None]
        gradient = gradient + np.einsum("bk,bki->bi", extra, weighted)
        matrix = matrix + weighted.transpose(0, 2, 1) @ derivative
    return Linear(cost, gradient, matrix)

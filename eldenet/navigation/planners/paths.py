"""Shortest paths on a grid: from cell to neighbor for planners, at any angle for the measure SPL.

Hart, Nilsson, Raphael, "A formal basis for the heuristic determination of minimum cost paths", 1968. The
search is scikit-image's ``MCP_Geometric`` (Dijkstra): its path has the same cost as A*'s.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np

from eldenet.simulation.arenas import INFLATION, RESOLUTION, Arena, clearance_map
from eldenet.simulation.obstacle import SIDE, Point
from eldenet.simulation.robot import ROBOT

#: Of :func:`optimal_length`, the measure of SPL; stored rows name it. 1: the grid's path at 0.45 m inflation.
SHORTEST_VERSION = 2


def shortest_path(
    cost: np.ndarray,
    start: tuple[float, float],
    goal: tuple[float, float],
    side: float = SIDE,
    *,
    corner: tuple[int, int] = (0, 0),
) -> np.ndarray | None:
    """Return way-points ``(n, 2)`` [m] of the cheapest path on an 8-connected grid; None without path.

    Args:
        cost: of each cell ``(n, m)``, 0.1 m wide, rows along y; infinite where the robot must not be.
        start: x, y [m].
        goal: x, y [m].
        side: of the whole grid [m]; its center is the origin.
        corner: row and column of the whole grid where ``cost`` starts.
    """
    from skimage.graph import MCP_Geometric

    ends = [
        tuple(np.clip(cell[::-1].astype(int) - corner, 0, np.array(cost.shape) - 1))
        for cell in ((np.array(point) + side / 2) / RESOLUTION for point in (start, goal))
    ]
    cost = cost.copy()
    cost[ends[0]] = 1.0 if not np.isfinite(cost[ends[0]]) else cost[ends[0]]
    search = MCP_Geometric(cost)
    costs, _ = search.find_costs([ends[0]], [ends[1]])
    if not np.isfinite(costs[ends[1]]):
        return None
    cells = np.array(search.traceback(ends[1]))
    return np.asarray(((cells + corner)[:, ::-1] + 0.5) * RESOLUTION - side / 2)


def inflated_cost(clearance: np.ndarray) -> np.ndarray:
    """Cost ``(n, n)`` of cells by their clearance [m]: 1 where the robot may be, infinite elsewhere."""
    return np.where(clearance >= INFLATION, 1.0, np.inf)


def optimal_length(arena: Arena) -> float:
    """Length of the shortest any-angle path through all way-points [m]; nan without path.

    It is the path of a disc as wide as the robot (0.50 m), which lies within its footprint: whatever the
    robot does, its center cannot take a shorter way, except for the error of the cells of 0.1 m, which may
    add up to some tenths of a meter on a long path.
    """
    free = clearance_map(arena.obstacles, arena.side) >= ROBOT.width / 2
    graph = _graph(free)
    points = [arena.start[:2], *arena.waypoints]
    return sum(_any_angle_length(free, graph, start, goal, arena.side) for start, goal in pairwise(points))


#: Steps to half of the 16 neighbors: a knight's moves beside the eight next cells.
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))


def _graph(free: np.ndarray) -> Any:
    """Sparse graph of the free cells ``(n, n)``, each with its 16 neighbors."""
    from scipy.sparse import coo_array

    count, ends, lengths = free.size, [], []
    numbers = np.arange(count).reshape(free.shape)
    for down, right in _STEPS:
        first = (slice(0, len(free) - down), slice(max(-right, 0), len(free) - max(right, 0)))
        second = (slice(down, None), slice(max(right, 0), len(free) + min(right, 0)))
        both = free[first] & free[second]
        ends.append(np.stack([numbers[first][both], numbers[second][both]]))
        lengths.append(np.full(int(both.sum()), math.hypot(down, right) * RESOLUTION))
    return coo_array((np.concatenate(lengths), tuple(np.concatenate(ends, axis=1))), (count, count)).tocsr()


def _any_angle_length(free: np.ndarray, graph: Any, start: Point, goal: Point, side: float) -> float:
    """Shortest path in the graph of ``free (n, n)`` [m], less detours between cells that see each other."""
    from scipy.sparse.csgraph import dijkstra

    cells = [
        np.clip(((np.array(at)[::-1] + side / 2) / RESOLUTION).astype(int), 0, len(free) - 1)
        for at in (start, goal)
    ]
    first, last = (int(row * len(free) + column) for row, column in cells)
    lengths, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    if not np.isfinite(lengths[last]):
        return math.nan
    numbers = [last]
    while numbers[-1] != first:
        numbers.append(int(before[numbers[-1]]))
    path = np.stack(np.divmod(np.array(numbers[::-1]), len(free)), axis=1)
    best = np.zeros(len(path))
    for number in range(1, len(path)):
        away = np.hypot(*(path[:number] - path[number]).T) * RESOLUTION
        best[number] = np.where(
            _visible(free, path[:number], path[number]), best[:number] + away, np.inf
        ).min()
    return float(best[-1])


def _visible(free: np.ndarray, many: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Which of many cells ``(n, 2)`` a free straight line joins with another one; ``(n,)`` bool."""
    share = np.linspace(0, 1, 2 * int(np.abs(many - one).max()) + 1)[:, None, None]
    rows, columns = np.moveaxis(np.rint(many + share * (one - many)).astype(int), 2, 0)
    seen = free[rows, columns].all(axis=0)
    seen[-1] = True  # the neighbor on the path
    return np.asarray(seen)

"""The 300 public worlds of BARN, a benchmark of navigation among cylinders.

Perille, Truong, Xiao, Stone, "Benchmarking metric ground navigation", SSRR 2020. The file holds
``centers (N, 2)`` [m] of cylinders of one ``radius`` [m], those of world ``i`` from ``world_start[i]`` to
``world_start[i + 1]``, and the benchmark's own shortest paths as grid cells, ``path (M, 2)`` with
``path_start``.
"""

import math
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import Obstacle, Point
from eldenet.system.errors import reading

START, GOAL = (-2.0, 3.0), (-2.0, 13.0)  # in a world's frame [m]
SHIFT = (2.25, -6.5)  # of a world's frame into an arena, whose middle is its origin [m]
HEIGHT = 1.0  # of the cylinders [m]
FASTEST = 2.0  # speed of the optimal time [m/s]
LEAST, MOST = 2.0, 8.0  # a drive's time counts as no less and no more than this many optimal times
_ARRAYS = ("centers", "radius", "world_start", "path", "path_start")


class BarnWorld(NamedTuple):
    """A world as an arena, and the length of its shortest path [m]."""

    arena: Arena
    length: float

    def score(self, seconds: float | None, *, least: float = LEAST) -> float:
        """The benchmark's score of a drive, 0 to ``1 / least``; None: it did not arrive.

        ``least`` was 4 before 2023.
        """
        if seconds is None:
            return 0.0
        optimal = self.length / FASTEST
        return optimal / min(max(seconds, least * optimal), MOST * optimal)


def read_barn(path: str | Path) -> list[BarnWorld]:
    """Return the worlds of a file, in order.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not such a file.
    """
    with reading(path, ".npz file of BARN's worlds", "give barn_worlds.npz"):
        with np.load(path, allow_pickle=False) as file:
            centers, radius, starts, cells, path_starts = (file[name] for name in _ARRAYS)
        if centers.shape[1:] != (2,) or len(starts) != len(path_starts):
            raise ValueError(f"centers {centers.shape}, {len(starts)} starts, {len(path_starts)} of paths")
    size = round(float(radius), 4)
    worlds = []
    for index, ((first, end), (begin, stop)) in enumerate(
        zip(pairwise(starts.tolist()), pairwise(path_starts.tolist()), strict=True)
    ):
        obstacles = tuple(
            Obstacle("cylinder", round(x + SHIFT[0], 4), round(y + SHIFT[1], 4), 0.0, (size, size), HEIGHT)
            for x, y in centers[first:end].tolist()
        )
        start, goal = (_shifted(at) for at in (START, GOAL))
        arena = Arena("test", len(obstacles), index, obstacles, (*start, math.pi / 2), (goal,), kind="barn")
        # the centers of grid cells of 0.15 m in the world's frame
        way = [START, *((0.15 * c - 4.575, 0.15 * r + 5.075) for c, r in cells[begin:stop].tolist()), GOAL]
        worlds.append(BarnWorld(arena, sum(math.dist(*step) for step in pairwise(way))))
    return worlds


def _shifted(at: Point) -> Point:
    return at[0] + SHIFT[0], at[1] + SHIFT[1]

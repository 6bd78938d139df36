"""Which arenas are crossed: an endless stream to train on, a frozen list to report on."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldenet.simulation.arenas import Arena, clearance_map, draw_start_and_goal, generate_arena
from eldenet.simulation.rendering.mjcf import Draw

TASK_STREAM = 103  # beside arenas.SPLITS: further crossings of training arenas


class TrainingArenas:
    """Random crossings of random arenas, for one slot of a training environment.

    Each arena is crossed ``repeats`` times, between other points each time.

    Args:
        densities: least and greatest number of obstacles.
        dense_share: of the arenas, which lie in the upper half of the densities.
        movers: greatest number of walking people; each arena has 0 to that many.
        repeats: crossings of an arena.
        min_distance: from start to goal [m].
        split: seed stream.
        curriculum: share of the training in which the greatest number of obstacles grows from a quarter of
            its range to the whole; 0: it is the whole from the start.
    """

    def __init__(
        self,
        densities: tuple[int, int] = (0, 80),
        *,
        dense_share: float = 0.5,
        movers: int = 0,
        repeats: int = 4,
        min_distance: float = 6.0,
        split: str = "train",
        curriculum: float = 0.0,
    ) -> None:
        low, high = densities
        if not 0 <= low <= high <= 120 or repeats < 1 or not (0 <= dense_share <= 1 and 0 <= curriculum <= 1):
            raise ValueError(
                f"densities={tuple(densities)}, dense_share={dense_share}, repeats={repeats}, "
                f"curriculum={curriculum}: give 0 <= least <= greatest <= 120 obstacles, shares in [0, 1] "
                "and at least 1 crossing"
            )
        self.low, self.high, self.dense_share = low, high, dense_share
        self.movers, self.repeats, self.min_distance, self.split = movers, repeats, min_distance, split
        self.curriculum, self._whole = curriculum, high
        self._arena: Arena | None = None
        self._clearance = np.empty((0, 0))
        self._left = 0

    def fresh(self, progress: float = 1.0) -> "TrainingArenas":
        """The same settings, for another slot; ``progress`` is the share of the training that is done."""
        arenas = TrainingArenas(
            (self.low, self._whole),
            dense_share=self.dense_share, movers=self.movers, repeats=self.repeats,
            min_distance=self.min_distance, split=self.split, curriculum=self.curriculum,
        )  # fmt: skip
        if progress < self.curriculum:
            share = 0.25 + 0.75 * progress / self.curriculum
            arenas.high = self.low + round(share * (self._whole - self.low))
        return arenas

    def draw(self, rng: np.random.Generator) -> Arena:
        """The next crossing."""
        if self._arena is None or self._left == 0:
            least = self.low
            if rng.random() < self.dense_share:
                least = (self.low + self.high) // 2
            density = int(rng.integers(least, self.high + 1))
            movers = int(rng.integers(0, self.movers + 1))
            index = int(rng.integers(2**31))
            self._arena = generate_arena(
                self.split, density, index, pedestrians=movers, min_distance=self.min_distance
            )
            self._left = self.repeats - 1
            self._clearance = clearance_map(self._arena.obstacles)
            return self._arena
        self._left -= 1
        draw = Draw((TASK_STREAM, int(rng.integers(2**31))))
        crossing = draw_start_and_goal(draw, self._clearance, self.min_distance, self._arena.pedestrians)
        if crossing is None:
            return self._arena
        return replace(self._arena, start=crossing[0], waypoints=(crossing[1],))


def frozen_arenas(density: int, count: int, *, split: str = "test", movers: int = 0) -> Sequence[Arena]:
    """Arenas 0 to ``count - 1`` of a split at one density, the same on every machine."""
    return [generate_arena(split, density, index, pedestrians=movers) for index in range(count)]

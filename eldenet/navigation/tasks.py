"""Arenas for drivers: an endless stream to train on, fixed lists to evaluate on."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from eldenet.simulation.arenas import (
    KINDS,
    MAX_DENSITY,
    Arena,
    clearance_map,
    draw_start_and_goal,
    generate_arena,
)
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.system.checks import one_of

TASK_STREAM = 103  # next to arenas.SPLITS: further start and goal pairs of training arenas


@dataclass
class TrainingArenas:
    """Random arenas for one slot of a training environment.

    Each arena is used ``repeats`` times, with another start and goal each time; traps, mazes and corridors
    keep theirs.

    Attributes:
        densities: least and greatest number of obstacles.
        dense_share: share of the arenas whose number is drawn from the upper half of the densities; that of
            the others is drawn from all.
        pedestrians: greatest number of walking people; each arena has 0 to that many.
        repeats: episodes per arena.
        min_distance: between start and goal [m].
        split: seed stream.
        kind: of :data:`~eldenet.simulation.arenas.KINDS`; mazes and corridors need densities of 0.

    Raises:
        ValueError: an argument is out of range.
    """

    densities: tuple[int, int] = (0, 80)
    _: KW_ONLY
    dense_share: float = 0.5
    pedestrians: int = 0
    repeats: int = 4
    min_distance: float = 6.0
    split: str = "train"
    kind: str = "open"

    def __post_init__(self) -> None:
        one_of("kind", self.kind, tuple(KINDS))
        low, high = self.densities
        if not 0 <= low <= high <= MAX_DENSITY or self.repeats < 1 or not 0 <= self.dense_share <= 1:
            raise ValueError(
                f"densities={(low, high)}, dense_share={self.dense_share}, repeats={self.repeats}: give "
                f"0 <= least <= greatest <= {MAX_DENSITY} obstacles, a share from 0 to 1 and at least 1 "
                "episode"
            )
        self._arena: Arena | None = None
        self._clearance = np.empty((0, 0))
        self._left = 0

    def fresh(self) -> "TrainingArenas":
        """Return a copy for another slot, without its arena."""
        return replace(self)

    def draw(self, rng: np.random.Generator) -> Arena:
        """Return the arena of the next episode."""
        if self._arena is None or self._left == 0:
            low, high = self.densities
            least = (low + high) // 2 if rng.random() < self.dense_share else low
            density = int(rng.integers(least, high + 1))
            pedestrians = int(rng.integers(0, self.pedestrians + 1))
            index = int(rng.integers(2**31))
            self._arena = generate_arena(
                self.split, density, index, pedestrians=pedestrians, min_distance=self.min_distance,
                kind=self.kind,
            )  # fmt: skip
            self._left = self.repeats - 1
            self._clearance = clearance_map(self._arena.obstacles)
            return self._arena
        self._left -= 1
        if self.kind in ("traps", "maze", "corridor"):
            return self._arena
        draw = Draw((TASK_STREAM, int(rng.integers(2**31))))
        ends = draw_start_and_goal(draw, self._clearance, self.min_distance, self._arena.pedestrians)
        return self._arena if ends is None else replace(self._arena, start=ends[0], waypoints=(ends[1],))


def frozen_arenas(
    density: int, count: int, *, split: str = "test", pedestrians: int = 0, kind: str = "open"
) -> Sequence[Arena]:
    """Arenas 0 to ``count - 1`` of a split, a kind and a density, the same on every machine."""
    return [
        generate_arena(split, density, index, pedestrians=pedestrians, kind=kind) for index in range(count)
    ]

"""Ranges with the errors of a depth network, without the network."""

import math
from pathlib import Path

import numpy as np

from eldenet.navigation.range_errors import RangeErrors, things
from eldenet.navigation.sensors import Drift, Eye, Ranges, Sight
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.robot import ROBOT

#: Of the network that was trained on data=arenas; the file says how, and how its errors were measured.
MEASURED = Path(__file__).resolve().parent.parent / "weights" / "arena_range_errors.json"


def errors_file(name: str) -> Path:
    """The file that "packaged" or a path names."""
    return MEASURED if name == "packaged" else Path(name)


class NoisyRanges:
    """The simulator's ranges with the errors of a depth network.

    Relative errors, as depth networks make them: a scale that wanders from frame to frame (correlation
    ``memory``), a smooth error over neighboring columns, and an error of each column. Errors that were
    measured (``errors``) add a bias and a spread by distance, and things that a look misses.

    Args:
        scale: standard deviation of the frame's scale.
        smooth: standard deviation of the error that about four neighboring columns share.
        column: standard deviation of each column's own error.
        memory: correlation of a frame's scale with the frame before.
        errors: :class:`~eldenet.navigation.range_errors.RangeErrors` or their file, which replace the four
            above; "packaged": those that were measured of a network trained on data=arenas.
        share: of the crossings whose ranges have errors; those of the others are true. A driver that is to do
            well with both learns from both.
        drift: of the odometry, in all crossings.
    """

    def __init__(
        self,
        scale: float = 0.08,
        smooth: float = 0.05,
        column: float = 0.03,
        memory: float = 0.8,
        errors: str | RangeErrors | None = None,
        share: float = 1.0,
        drift: Drift | dict[str, float] = Drift(),  # noqa: B008 - immutable
    ) -> None:
        if min(scale, smooth, column) < 0 or not 0 <= memory < 1:
            raise ValueError(
                f"scale={scale}, smooth={smooth}, column={column}, memory={memory}: deviations from 0, "
                "the memory is in [0, 1)"
            )
        if not 0 <= share <= 1:
            raise ValueError(f"share={share}: give a share of the crossings, 0 to 1")
        self.share = share
        self.errors = RangeErrors.read(errors_file(errors)) if isinstance(errors, str) else errors
        if self.errors is not None:
            e = self.errors
            scale, smooth, column, memory = e.scale, e.smooth, e.column, e.memory
        self.scale, self.smooth, self.column, self.memory = scale, smooth, column, memory
        self.drift = Drift(**drift) if isinstance(drift, dict) else drift

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> Eye:
        """An eye with its own error process, or one without errors."""
        if self.share < 1 and rng.random() >= self.share:
            return Ranges().begin(world, rng)
        return _NoisyEye(self, world, rng)


class _NoisyEye:
    def __init__(self, sensor: NoisyRanges, world: ArenaWorld, rng: np.random.Generator) -> None:
        self.sensor, self.world, self.rng = sensor, world, rng
        self.scale = sensor.scale * rng.standard_normal()

    def look(self) -> Sight:
        s, rng = self.sensor, self.rng
        self.scale = s.memory * self.scale + math.sqrt(1 - s.memory**2) * s.scale * rng.standard_normal()
        coarse = rng.standard_normal(ROBOT.columns // 4 + 2)
        at = np.arange(ROBOT.columns) / 4 + rng.random()
        shared = s.smooth * np.interp(at, np.arange(len(coarse)), coarse)
        own = s.column * rng.standard_normal(ROBOT.columns)
        ranges = self.world.ranges()
        error = self.scale + shared + own
        nothing = ranges >= ROBOT.far
        if s.errors is None:
            error[nothing] = 0.0
        else:
            bias, spread = (
                np.interp(ranges, s.errors.middles, part) for part in (s.errors.bias, s.errors.spread)
            )
            far_bias, far_spread = s.errors.far
            error = np.where(nothing, far_bias + far_spread * error, bias + spread * error)
            ranges = without_missed(ranges, s.errors, rng)
        wrong = ranges * np.exp(error)
        return Sight(np.clip(wrong, ROBOT.near, ROBOT.far), np.zeros(ROBOT.columns, np.intp))


def without_missed(ranges: np.ndarray, errors: RangeErrors, rng: np.random.Generator) -> np.ndarray:
    """True ranges ``(columns,)`` [m] where what a look misses gives way to the farther of its neighbors.

    Whether a thing is missed is drawn anew in every look. What fills the view is never missed: nothing
    beside it says what lies behind.
    """
    thing = things(ranges)
    chance = rng.random(int(thing[-1]) + 1)
    out = ranges.copy()
    for number in range(len(chance)):
        mine = np.flatnonzero(thing == number)
        if chance[number] < np.interp(ranges[mine].mean(), errors.middles, errors.miss):
            beside = [ranges[side] for side in (mine[0] - 1, mine[-1] + 1) if 0 <= side < len(ranges)]
            if beside:
                out[mine] = np.maximum(ranges[mine], max(beside))
    return out

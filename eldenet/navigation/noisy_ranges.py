"""Ranges with the errors of a depth network, without the network."""

import math
from pathlib import Path

import numpy as np

from eldenet.navigation.localization import USUAL, Drift
from eldenet.navigation.range_errors import RangeErrors, segments
from eldenet.navigation.sensors import Ranges, SensorInstance, SensorScan, SimulatedSensor
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.robot import ROBOT

#: Errors of the packaged network eldenet_arenas; the file says how they were measured.
PACKAGED_ERRORS = Path(__file__).resolve().parent.parent / "weights" / "arena_range_errors.json"
SHARED_BY = 4  # neighboring columns that have about the same part of the error
_DEFAULTS = (0.08, 0.05, 0.03, 0.8)  # scale, smooth, column, memory


def errors_file(name: str) -> Path:
    """File of range errors: the packaged one for "packaged", else a path."""
    return PACKAGED_ERRORS if name == "packaged" else Path(name)


class NoisyRanges(SimulatedSensor):
    """The simulator's ranges with the errors of a depth network.

    Relative errors, as depth networks make them: a scale that changes from frame to frame (correlation
    ``memory``), a smooth error over neighboring columns, and an error of each column. Measured errors
    (``errors``) add a bias and a spread by distance, and missed segments.

    Args:
        scale: standard deviation of the frame's scale.
        smooth: standard deviation of the error that about four neighboring columns share.
        column: standard deviation of each column's own error.
        memory: correlation of a frame's scale with the previous frame.
        errors: :class:`~eldenet.navigation.range_errors.RangeErrors` or their file, which replace the four
            above; "packaged": those of the packaged network ``eldenet_arenas``.
        share: of the episodes that have errors; the others have true ranges: a driver learns from both.

    ``drift`` and ``latency`` are those of :class:`~eldenet.navigation.sensors.SimulatedSensor`.

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(
        self,
        scale: float = _DEFAULTS[0],
        smooth: float = _DEFAULTS[1],
        column: float = _DEFAULTS[2],
        memory: float = _DEFAULTS[3],
        errors: str | RangeErrors | None = None,
        share: float = 1.0,
        drift: Drift | dict[str, float] = USUAL,
        latency: float = 0.0,
    ) -> None:
        super().__init__(drift=drift, latency=latency)
        if min(scale, smooth, column) < 0 or not 0 <= memory < 1 or not 0 <= share <= 1:
            raise ValueError(
                f"scale={scale}, smooth={smooth}, column={column}, memory={memory}, share={share}: give "
                "deviations of 0 or more, memory in [0, 1) and share in [0, 1]"
            )
        self.share = share
        self.sources = {"errors": (errors, errors_file(errors))} if isinstance(errors, str) else {}
        self.errors = RangeErrors.read(errors_file(errors)) if isinstance(errors, str) else errors
        if self.errors is not None:
            if (scale, smooth, column, memory) != _DEFAULTS:
                raise ValueError(
                    f"scale={scale}, smooth={smooth}, column={column}, memory={memory}: measured errors "
                    "replace these four; leave them out, or give errors=null"
                )
            e = self.errors
            scale, smooth, column, memory = e.scale, e.smooth, e.column, e.memory
        self.scale, self.smooth, self.column, self.memory = scale, smooth, column, memory

    def begin(self, world: ArenaWorld, rng: np.random.Generator) -> SensorInstance:
        """Return an instance with its own error process, or one without errors."""
        if self.share < 1 and rng.random() >= self.share:
            return Ranges().begin(world, rng)
        return _NoisyRanges(self, world, rng)


class _NoisyRanges:
    def __init__(self, sensor: NoisyRanges, world: ArenaWorld, rng: np.random.Generator) -> None:
        self.sensor, self.world, self.rng = sensor, world, rng
        self.scale = sensor.scale * rng.standard_normal()

    def scan(self) -> SensorScan:
        s, rng = self.sensor, self.rng
        self.scale = s.memory * self.scale + math.sqrt(1 - s.memory**2) * s.scale * rng.standard_normal()
        coarse = rng.standard_normal(ROBOT.columns // SHARED_BY + 2)
        at = np.arange(ROBOT.columns) / SHARED_BY + rng.random()
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
        return SensorScan(np.clip(wrong, ROBOT.near, ROBOT.far), np.zeros(ROBOT.columns, np.intp))


def without_missed(ranges: np.ndarray, errors: RangeErrors, rng: np.random.Generator) -> np.ndarray:
    """True ranges ``(columns,)`` [m] with each missed segment replaced by the farther of its neighbors.

    Misses are redrawn in every scan. A segment that fills the view is never missed: it has no neighbor.
    """
    segment = segments(ranges)
    chance = rng.random(int(segment[-1]) + 1)
    out = ranges.copy()
    for number in range(len(chance)):
        mine = np.flatnonzero(segment == number)
        if chance[number] < np.interp(ranges[mine].mean(), errors.middles, errors.miss):
            beside = [ranges[side] for side in (mine[0] - 1, mine[-1] + 1) if 0 <= side < len(ranges)]
            if beside:
                out[mine] = np.maximum(ranges[mine], max(beside))
    return out

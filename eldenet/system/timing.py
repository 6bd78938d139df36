"""Time several calls in turns, so that their ratios can be trusted."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Self

import numpy as np


def time_interleaved(
    calls: Mapping[str, Callable[[], object]],
    *,
    rounds: int = 5,
    seconds: float = 0.2,
    synchronize: Callable[[], object] | None = None,
    warm_up: int = 3,
) -> dict[str, list[float]]:
    """Time several calls in turns, so that a machine that slows down or speeds up hits all of them alike.

    Args:
        calls: name -> what to time.
        rounds: turns that each call gets.
        seconds: of each turn; at least three calls are timed in it.
        synchronize: waits until the device has finished; called before each start and before each stop.
        warm_up: calls before each turn that are not timed: another call had the caches.

    Returns:
        Name -> the time of every timed call [s].
    """
    wait = synchronize or (lambda: None)
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            for _ in range(warm_up):
                call()
            wait()
            end, done = time.perf_counter() + seconds, 0
            while done < 3 or time.perf_counter() < end:
                start = time.perf_counter()
                call()
                wait()
                times[name].append(time.perf_counter() - start)
                done += 1
    return times


class Waiting:
    """``with Waiting() as waiting``: how much longer a block took than processors worked for it."""

    ratio = 1.0  # time on the clock over that of the processors; about 1 or less where no other job ran

    def __enter__(self) -> Self:
        self._clock, self._worked = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        self.ratio = (time.perf_counter() - self._clock) / max(time.process_time() - self._worked, 1e-9)


def median_ms(times: Sequence[float]) -> float:
    """Median [ms] of times [s]."""
    return 1e3 * statistics.median(times)


def percentile_ms(times: Sequence[float], percent: float) -> float:
    """Percentile [ms] of times [s]."""
    return 1e3 * float(np.percentile(times, percent))

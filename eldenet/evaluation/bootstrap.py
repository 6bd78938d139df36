"""What the choice of images, frames or worlds leaves open: bootstrap intervals."""

import math
from collections.abc import Callable

import numpy as np


def bootstrap_interval(
    statistic: Callable[[np.ndarray], float],
    count: int,
    *,
    draws: int = 2000,
    share: float = 0.95,
    seed: int = 0,
) -> tuple[float, float]:
    """Interval of a statistic: its percentiles over things drawn anew, with replacement.

    Efron, "Bootstrap methods: another look at the jackknife", 1979. A statistic that compares is paired:
    what it compares is drawn together, so that what both share (a hard world) cancels.

    Args:
        statistic: numbers of things ``(count,)`` -> value; nan where it has none.
        count: how many things there are.
        draws: how often.
        share: of the values that the interval holds.
        seed: of the draws.

    Returns:
        Low and high; nan where no draw had a value.
    """
    rng = np.random.default_rng(seed)
    values = (
        np.array([statistic(rng.integers(0, count, count)) for _ in range(draws)]) if count else np.zeros(0)
    )
    values = values[np.isfinite(values)]
    if not len(values):
        return math.nan, math.nan
    low, high = np.quantile(values, ((1 - share) / 2, (1 + share) / 2))
    return float(low), float(high)

"""Bootstrap intervals: how far a figure depends on the images, frames or arenas that were drawn."""

import math
from collections.abc import Callable

import numpy as np

LIMITS = ((1 - 0.95) / 2, (1 + 0.95) / 2)  # quantiles at the ends of the interval


def bootstrap_interval(
    statistic: Callable[[np.ndarray], float],
    count: int,
    *,
    draws: int = 2000,
) -> tuple[float, float]:
    """95 % percentile bootstrap interval of a statistic.

    Efron, "Bootstrap methods: another look at the jackknife", 1979. A paired comparison takes the
    difference within ``statistic``, so that both sides are drawn together.
    Unlike ``scipy.stats.bootstrap`` it takes single observations and draws without a value.

    Args:
        statistic: drawn indices ``(count,)`` -> value; NaN where it has none.
        count: number of observations.
        draws: number of resamples.

    Returns:
        Low and high; NaN where no draw had a value.
    """
    rng = np.random.default_rng(0)
    resamples = (rng.integers(0, count, count) for _ in range(draws if count else 0))
    values = np.array([statistic(drawn) for drawn in resamples])
    values = values[np.isfinite(values)]
    if not len(values):
        return math.nan, math.nan
    low, high = np.quantile(values, LIMITS)
    return float(low), float(high)

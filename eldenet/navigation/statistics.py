"""What a success rate is worth: Wilson intervals, SPL, paired tests."""

import math
from collections.abc import Sequence

import numpy as np


def wilson_interval(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """Confidence interval of a share (95 % by default): Wilson, JASA 1927."""
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(f"{successes} of {trials}: give 0 <= successes <= trials and at least one trial")
    share = successes / trials
    middle = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> tuple[int, int, float]:
    """Exact paired test of two methods on the same worlds: McNemar, Psychometrika 1947.

    Returns:
        Worlds that only the first solved, those that only the second solved, and the two-sided p-value.
    """
    from scipy.stats import binomtest

    if len(first) != len(second):
        raise ValueError(f"{len(first)} and {len(second)} outcomes: a paired test needs the same worlds")
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    only_first, only_second = int((a & ~b).sum()), int((b & ~a).sum())
    if only_first + only_second == 0:
        return 0, 0, 1.0
    return only_first, only_second, float(binomtest(only_first, only_first + only_second).pvalue)


def spl(success: np.ndarray, length: np.ndarray, shortest: np.ndarray) -> float:
    """Success weighted by path length: Anderson et al., "On evaluation of embodied navigation agents", 2018.

    Args:
        success: bool.
        length: of the way driven [m].
        shortest: length of the shortest way [m].
    """
    return float(np.mean(np.asarray(success) * shortest / np.maximum(length, shortest)))

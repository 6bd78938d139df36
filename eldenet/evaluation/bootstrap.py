"""Bootstrap intervals: how far a figure depends on the scenes, frames or arenas that were drawn."""

import math
from collections.abc import Callable, Sequence
from pathlib import PurePosixPath

import numpy as np

from eldenet.data.nyu_scenes import labeled_scene
from eldenet.data.splits import scene_of

LIMITS = ((1 - 0.95) / 2, (1 + 0.95) / 2)  # quantiles at the ends of the interval


def scenes_of(names: Sequence[str]) -> np.ndarray:
    """The scene of each frame, as numbers ``(N,)``: the groups that an interval draws.

    Frames of one room, place or drive are alike, so an interval that draws single frames is too narrow. A
    plain folder counts with all folders above it: ``hall/rgb`` is not ``kitchen/rgb``. Where all frames are
    of one scene, each counts as its own: nothing else can be drawn.
    """
    scenes = []
    for name in names:
        scene, folder = labeled_scene(name) or scene_of(name), PurePosixPath(name).parent
        scenes.append(str(folder) if scene == folder.name else scene)
    found = np.unique(scenes, return_inverse=True)[1]
    return np.arange(len(names)) if len(names) and not found.any() else found


def bootstrap_interval(
    statistic: Callable[[np.ndarray], float], groups: np.ndarray | int, *, draws: int = 2000
) -> tuple[float, float]:
    """95 % percentile bootstrap interval of a statistic.

    Efron, "Bootstrap methods: another look at the jackknife", 1979; whole groups are drawn (Field and Welsh,
    "Bootstrapping clustered data", 2007). A paired comparison takes the difference within ``statistic``, so
    that both sides are drawn together. Draws for which ``statistic`` is NaN are left out.

    Args:
        statistic: drawn indices of observations -> value; NaN where it has none.
        groups: the group ``(N,)`` of each observation, such as :func:`scenes_of` gives, or the number of
            observations that stand alone.
        draws: number of resamples.

    Returns:
        Low and high; NaN where no draw had a value.
    """
    rng = np.random.default_rng(0)
    if isinstance(groups, int):
        resamples = (rng.integers(0, groups, groups) for _ in range(draws if groups else 0))
    else:
        members = [np.flatnonzero(groups == group) for group in np.unique(groups)]
        count = len(members)
        resamples = (
            np.concatenate([members[group] for group in rng.integers(0, count, count)])
            for _ in range(draws if count else 0)
        )
    values = np.array([statistic(drawn) for drawn in resamples])
    return _limits(values[np.isfinite(values)])


def mean_interval(
    values: np.ndarray, groups: np.ndarray | None = None, *, draws: int = 2000
) -> tuple[float, float]:
    """:func:`bootstrap_interval` of the mean of ``values (N,)``, much faster.

    Args:
        values: of the observations, finite; for a paired comparison, their differences.
        groups: the group ``(N,)`` of each observation; None: each stands alone.
        draws: number of resamples.

    Returns:
        Low and high; NaN where there are no observations.

    Raises:
        ValueError: a value is NaN or infinite.
    """
    values = np.asarray(values, np.float64)
    if missing := np.count_nonzero(~np.isfinite(values)):
        raise ValueError(f"{missing} of {len(values)} values are NaN or infinite: leave them out")
    group_of = np.arange(len(values)) if groups is None else np.unique(groups, return_inverse=True)[1]
    sizes = np.bincount(group_of)
    if not len(sizes):
        return math.nan, math.nan
    drawn = np.random.default_rng(0).integers(0, len(sizes), (draws, len(sizes)))
    return _limits(np.bincount(group_of, values)[drawn].sum(1) / sizes[drawn].sum(1))


def _limits(values: np.ndarray) -> tuple[float, float]:
    """The ends of the interval of the draws' values; NaN where there are none."""
    if not len(values):
        return math.nan, math.nan
    low, high = np.quantile(values, LIMITS)
    return float(low), float(high)

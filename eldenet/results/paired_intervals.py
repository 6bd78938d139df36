"""Paired differences between two rows of a study, with bootstrap intervals."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldenet.evaluation.bootstrap import LIMITS, mean_interval, scenes_of
from eldenet.evaluation.metric_names import in_range
from eldenet.results.packed_runs import IMAGES

DRAWS = 10_000
AT_ONCE = 1000  # draws at a time, which bounds the memory
SCENES_ALONE = "scenes alone"  # an interval that does not include the chance in a training


@dataclass(frozen=True)
class Scores:
    """A metric of every image in every run of a row."""

    images: tuple[str, ...]  # their names
    values: np.ndarray  # (runs, images)
    source: str = "one row"  # the row, for messages


@dataclass(frozen=True)
class Difference:
    """Difference of a row's metric to the reference row's: mean over images, 95 % interval over scenes."""

    mean: float  # ours minus theirs
    low: float  # lower end of the interval
    high: float  # upper end
    seeds: bool  # whether seeds were drawn too, so that the interval includes the chance in a training
    lower_is_better: bool  # for the metric

    @property
    def verdict(self) -> str:
        """The word "better" or "worse"; empty if the interval contains 0, is NaN or of the scenes alone."""
        if not self.seeds or not (self.low > 0 or self.high < 0):
            return ""
        return "better" if (self.mean < 0) == self.lower_is_better else "worse"

    @property
    def text(self) -> str:
        """``+0.014 [-0.017, +0.046]`` with the verdict."""
        verdict = self.verdict if self.seeds else f"({SCENES_ALONE})"
        return f"{self.mean:+.3f} [{self.low:+.3f}, {self.high:+.3f}] {verdict}".rstrip()


def per_image(runs: Mapping[str, Mapping[str, Any]], metric: str) -> Scores:
    """``metric`` of every image in each of the packed ``runs``, by name.

    Raises:
        ValueError: a metric is missing or cannot be, or the runs scored different images.
    """
    found: list[dict[str, float]] = []
    for name, run in runs.items():
        columns = run.get(IMAGES, {})
        names, values = columns.get("name", []), columns.get(metric, [])
        if not names or len(names) != len(values) or not all(in_range(metric, value) for value in values):
            raise ValueError(f"{name} has no {metric} of each of its images: train again")
        found.append({key: math.nan if v is None else v for key, v in zip(names, values, strict=True)})
        if found[-1].keys() != found[0].keys():
            raise ValueError(f"{name} and {next(iter(runs))} scored different images and can't be paired")
    images = tuple(sorted(found[0]))
    return Scores(images, np.array([[row[image] for image in images] for row in found]), next(iter(runs)))


def paired_interval(ours: Scores, theirs: Scores, *, draw_seeds: bool) -> tuple[float, float, float]:
    """Mean difference ``ours - theirs`` and its 95 % interval: paired percentile bootstrap.

    Scenes are drawn for both rows together, so that a hard scene affects both alike; all frames of a drawn
    scene count.

    ``draw_seeds`` draws the runs of each row as well, independently, so that the interval includes the chance
    in a training; it takes several runs of both.

    Raises:
        ValueError: the two rows scored different images.
    """
    if ours.images != theirs.images:
        raise ValueError(f"{ours.source} and {theirs.source} scored different images and can't be paired")
    known = np.isfinite(ours.values).all(axis=0) & np.isfinite(theirs.values).all(axis=0)
    mine, other = ours.values[:, known], theirs.values[:, known]
    difference = mine.mean(axis=0) - other.mean(axis=0)
    scenes = scenes_of(ours.images)[known]
    if draw_seeds and len(difference):
        low, high = two_level_interval(mine, other, scenes)
    else:
        low, high = mean_interval(difference, scenes, draws=DRAWS)
    return float(difference.mean()), low, high


def two_level_interval(mine: np.ndarray, other: np.ndarray, scenes: np.ndarray) -> tuple[float, float]:
    """Interval of the mean difference of scores ``(runs, images)`` over drawn runs and drawn scenes.

    A draw takes as many runs of each row as it has, and as many of the images' ``scenes (images,)`` as there
    are, with replacement; all runs share the scenes. Draws are counts of runs and scenes, so that a mean is a
    product: (runs drawn) x scores x (images drawn).
    """
    scene, sizes = np.unique(scenes, return_inverse=True, return_counts=True)[1:]
    rng = np.random.default_rng(0)
    means = []
    for _ in range(DRAWS // AT_ONCE):
        images = _shares(rng, len(sizes))[:, scene]
        images /= images.sum(axis=1, keepdims=True)
        one, two = (_shares(rng, len(values)) * (images @ values.T) for values in (mine, other))
        means.append(one.sum(axis=1) - two.sum(axis=1))
    # rounding errors around 0 are no verdict
    low, high = np.quantile(np.concatenate(means), LIMITS).round(12)
    return float(low), float(high)


def _shares(rng: np.random.Generator, count: int) -> np.ndarray:
    """Share of each draw that each of ``count`` elements has, ``(draws, count)``."""
    return rng.multinomial(count, np.full(count, 1 / count), size=AT_ONCE) / count

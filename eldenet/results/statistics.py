"""Paired differences between two rows of a study, with bootstrap intervals."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eldenet.evaluation.bootstrap import LIMITS, bootstrap_interval
from eldenet.evaluation.metric_names import in_range
from eldenet.system.files import read_table

DRAWS = 10_000
AT_ONCE = 1000  # draws at a time, which bounds the memory
IMAGES_ALONE = "images alone"  # an interval that does not include the chance in a training


@dataclass(frozen=True)
class Scores:
    """A metric of every image in every run of a row.

    Attributes:
        images: their names.
        values: ``(runs, images)``.
        source: the file of the first run, for messages.
    """

    images: tuple[str, ...]
    values: np.ndarray
    source: str = "one row"


@dataclass(frozen=True)
class Difference:
    """Difference of a row's metric to the reference row's: mean over the images, 95 % interval.

    Attributes:
        mean: ours minus theirs.
        low: lower end of the interval.
        high: upper end.
        seeds: whether seeds were drawn too, so that the interval includes the chance in a training.
        lower_is_better: for the metric.
    """

    mean: float
    low: float
    high: float
    seeds: bool
    lower_is_better: bool

    @property
    def verdict(self) -> str:
        """The word "better" or "worse"; empty if the interval contains 0, is NaN or of the images alone."""
        if not self.seeds or not (self.low > 0 or self.high < 0):
            return ""
        return "better" if (self.mean < 0) == self.lower_is_better else "worse"

    @property
    def text(self) -> str:
        """``+0.014 [-0.017, +0.046]`` with the verdict."""
        verdict = self.verdict if self.seeds else f"({IMAGES_ALONE})"
        return f"{self.mean:+.3f} [{self.low:+.3f}, {self.high:+.3f}] {verdict}".rstrip()


def per_image(files: Sequence[Path], metric: str) -> Scores:
    """``metric`` of every image in each run, from their ``per_image.csv``.

    Raises:
        ValueError: a file is damaged, or the runs scored different images.
    """
    found: list[dict[str, float]] = []
    for file in files:
        found.append({})
        for number, row in enumerate(read_table(file, ("name", metric)), 2):
            try:
                value = float(row[metric])
            except ValueError:
                value = math.inf
            if row["name"] in found[-1] or not (math.isnan(value) or in_range(metric, value)):
                raise ValueError(
                    f"{file}, line {number}: {row['name']!r} with {metric}={row[metric]!r} is invalid or "
                    "repeated: restore the file, or train or evaluate again"
                )
            found[-1][row["name"]] = value
        if found[-1].keys() != found[0].keys():
            raise ValueError(f"{file} and {files[0]} scored different images and can't be paired")
    images = tuple(sorted(found[0]))
    return Scores(images, np.array([[values[name] for name in images] for values in found]), str(files[0]))


def paired_interval(ours: Scores, theirs: Scores, *, draw_seeds: bool) -> tuple[float, float, float]:
    """Mean difference ``ours - theirs`` and its 95 % interval: paired percentile bootstrap.

    Images are drawn for both rows together, so that a hard image affects both alike.

    Args:
        ours: scores of one row.
        theirs: of the other.
        draw_seeds: draw the runs of each row as well, independently, so that the interval includes the chance
            in a training; it takes several runs of both.

    Raises:
        ValueError: the two rows scored different images.
    """
    if ours.images != theirs.images:
        raise ValueError(f"{ours.source} and {theirs.source} scored different images and can't be paired")
    known = np.isfinite(ours.values).all(axis=0) & np.isfinite(theirs.values).all(axis=0)
    mine, other = ours.values[:, known], theirs.values[:, known]
    difference = mine.mean(axis=0) - other.mean(axis=0)
    if draw_seeds and len(difference):
        low, high = two_level_interval(mine, other)
    else:
        low, high = bootstrap_interval(
            lambda chosen: float(difference[chosen].mean()), len(difference), draws=DRAWS
        )
    return float(difference.mean()), low, high


def two_level_interval(mine: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Interval of the mean difference over drawn runs and drawn images.

    A draw takes as many runs of each row as it has, and as many images as there are, with replacement; all
    runs share the images. Draws are counts of runs and images, so that a mean is a product:
    (runs drawn) x scores x (images drawn).

    Args:
        mine: ``(runs, images)`` of one row.
        other: ``(runs, images)`` of the other.
    """
    rng = np.random.default_rng(0)
    means = []
    for _ in range(DRAWS // AT_ONCE):
        images = _shares(rng, mine.shape[1])
        one, two = (_shares(rng, len(values)) * (images @ values.T) for values in (mine, other))
        means.append(one.sum(axis=1) - two.sum(axis=1))
    low, high = np.quantile(np.concatenate(means), LIMITS).round(
        12
    )  # rounding errors around 0 are no verdict
    return float(low), float(high)


def _shares(rng: np.random.Generator, count: int) -> np.ndarray:
    """Share of each draw that each of ``count`` elements has, ``(draws, count)``."""
    return rng.multinomial(count, np.full(count, 1 / count), size=AT_ONCE) / count

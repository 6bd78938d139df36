"""What a change did to weights: paired differences of held-out frames, a table, and whether to keep it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldenet.evaluation.metric_names import LOWER_IS_BETTER, UNITS
from eldenet.results.statistics import Scores, paired_interval
from eldenet.results.tables import WORDS

if TYPE_CHECKING:
    from eldenet.results.run_log import RunLog

#: What a table calls errors that are no metrics of depth.
OTHERS = {"scale_error": "error of scale"}


@dataclass(frozen=True)
class Change:
    """A metric of the same frames before and after.

    Attributes:
        metric: its name.
        before: mean over the frames.
        after: mean over the frames.
        low: lower end of the 95 % interval of ``after - before`` (paired bootstrap over frames).
        high: upper end.
        frames: how many.
    """

    metric: str
    before: float
    after: float
    low: float
    high: float
    frames: int

    @property
    def is_better(self) -> bool:
        """Whether the whole interval lies on the better side of 0."""
        lower = self.metric in LOWER_IS_BETTER or self.metric in OTHERS
        return self.high < 0 if lower else self.low > 0


def compare(metric: str, names: Sequence[str], before: Sequence[float], after: Sequence[float]) -> Change:
    """Compare a metric of every frame before and after; frames without a value (NaN) do not count."""
    one, other = np.asarray([after], np.float64), np.asarray([before], np.float64)
    known = np.isfinite(one[0]) & np.isfinite(other[0])
    _, low, high = paired_interval(Scores(tuple(names), one), Scores(tuple(names), other), draw_seeds=False)
    return Change(
        metric, float(other[0][known].mean()), float(one[0][known].mean()), low, high, int(known.sum())
    )


def say_changes(log: "RunLog", title: str, changes: Mapping[str, Change]) -> None:
    """Print a table of at most 80 columns: before, after, and the difference with its interval."""
    rows = []
    for metric, change in changes.items():
        unit = f" [{UNITS[metric].replace('^2', '²')}]" if metric in UNITS else ""
        arrow = "↓" if metric in LOWER_IS_BETTER or metric in OTHERS else "↑"
        word = WORDS.get(metric, OTHERS.get(metric, metric))
        interval = f"{change.after - change.before:+.3f} [{change.low:+.3f}, {change.high:+.3f}]"
        rows.append([f"{word}{unit} {arrow}", f"{change.before:.3f}", f"{change.after:.3f}", interval])
    log.table(title, ["held-out frames", "before", "after", "change, 95 % interval"], rows)

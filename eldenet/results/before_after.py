"""What a change did to weights: paired differences of held-out frames, a table, and whether to keep it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.evaluation.bootstrap import mean_interval
from eldenet.evaluation.metric_names import LOWER_IS_BETTER
from eldenet.results.fingerprints import fingerprint
from eldenet.results.paired_intervals import DRAWS
from eldenet.results.run_record import RUN_FILE, environment
from eldenet.results.tables import heading
from eldenet.system.files import write_json

if TYPE_CHECKING:
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog

#: Stretches of time that held-out frames are drawn in.
BLOCKS = 5
#: A greater factor, or a smaller one than its inverse, is a mistake in what was given.
MAX_SCALE = 3.0
SAME_LEVELS = 2  # of 255, by which thumbnails of one scene may differ at most
PICTURE_HEIGHT = 240  # [px] of a panel of before_after.png
#: Facts about weights that a change makes untrue.
MEASURED = ("test", "delta1", "abs_rel", "rmse")


@dataclass(frozen=True)
class Change:
    """A metric of the same frames before and after."""

    metric: str
    before: float  # mean over the frames
    after: float  # mean over the frames
    low: float  # lower end of the 95 % interval of after - before (paired bootstrap over stretches of time)
    high: float  # upper end
    frames: int  # how many

    @property
    def is_better(self) -> bool:
        """Whether the whole interval lies on the better side of 0."""
        return self.high < 0 if self.metric in LOWER_IS_BETTER else self.low > 0


def compare(metric: str, before: Sequence[float], after: Sequence[float]) -> Change:
    """Compare a metric of frames in the order of time before and after; those without a value do not count.

    Frames that follow each other look alike, so the bootstrap draws ``BLOCKS`` stretches of them, not frames.
    """
    old, new = np.asarray(before, np.float64), np.asarray(after, np.float64)
    known = np.isfinite(old) & np.isfinite(new)
    stretches = (np.arange(len(old)) * BLOCKS // len(old))[known]
    old, new = old[known], new[known]
    low, high = mean_interval(new - old, stretches, draws=DRAWS)
    return Change(metric, float(old.mean()), float(new.mean()), low, high, len(old))


def check_scale(scale: float, settings: str, *, force: bool = False) -> None:
    """Raise ValueError for a factor that no camera needs, with the settings that may be wrong."""
    if not force and not 1 / MAX_SCALE <= scale <= MAX_SCALE:
        raise ValueError(
            f"depth would have to be multiplied by {scale:.3g}, and no factor above {MAX_SCALE:g} or below "
            f"1/{MAX_SCALE:g} is kept: check {settings}; if all are right, set force=true"
        )


def thumbnail(picture: np.ndarray) -> np.ndarray:
    """A picture ``(H, W, 3)`` uint8 at 24 x 32, by which copies are found: noise and JPEG average out."""
    import cv2

    return np.asarray(cv2.resize(picture, (32, 24), interpolation=cv2.INTER_AREA), np.int16)


def refuse_copies(held_out: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> None:
    """Raise ValueError if most held-out frames, given by their thumbnails, equal frames that are learned.

    On these, any change that fits the learned frames looks like an improvement.
    """
    learned = np.stack(others)
    copies = [bool((np.abs(learned - one).max((1, 2, 3)) <= SAME_LEVELS).any()) for one in held_out]
    if sum(copies) > len(copies) / 2:
        raise ValueError(
            f"{sum(copies)} of {len(copies)} held-out frames are copies of training frames, so they prove "
            "nothing: move the camera while you record, or hold out other places"
        )


def panel_size(picture: np.ndarray) -> tuple[int, int]:
    """Return ``(height, width)`` [px] of a panel of before_after.png that shows ``picture (H, W, ...)``."""
    return PICTURE_HEIGHT, round(PICTURE_HEIGHT * picture.shape[1] / picture.shape[0])


def is_improvement(changes: Mapping[str, Change]) -> bool:
    """Return whether a change is worth keeping: the first metric is surely better."""
    return next(iter(changes.values())).is_better


def say_changes(log: "RunLog", title: str, changes: Mapping[str, Change]) -> None:
    """Print a table of at most 80 columns: before, after, and the difference with its interval."""
    rows = []
    for metric, change in changes.items():
        interval = f"{change.after - change.before:+.3f} [{change.low:+.3f}, {change.high:+.3f}]"
        rows.append([heading(metric), f"{change.before:.3f}", f"{change.after:.3f}", interval])
    log.table(title, ["held-out frames", "before", "after", "change, 95 % interval"], rows)


def record_change(
    folder: Path,
    log: "RunLog",
    start: "DepthNet",
    changed: "DepthNet",
    changes: Mapping[str, Change],
    weights: str,
    facts: Mapping[str, Any],
) -> bool:
    """Write ``model/`` and ``run.json``; say and return whether the change is kept.

    Args:
        folder: of the run.
        log: what the person sees.
        start: the network before the change, which stays if the change is not kept.
        changed: the network after it.
        changes: metric -> its change on held-out frames.
        weights: what the run started from.
        facts: what was done, for ``run.json``.
    """
    kept = is_improvement(changes)
    held_out = {name: vars(change) for name, change in changes.items()}
    if kept:
        changed.info = {name: fact for name, fact in changed.info.items() if name not in MEASURED}
        changed.save_pretrained(folder / "model", info={"adapted_from": weights, "held_out": held_out})
    else:
        start.save_pretrained(folder / "model")
    record = {"weights": weights, "weights_sha256": fingerprint(weights), "kept": kept, "held_out": held_out}
    write_json(folder / RUN_FILE, {**record, **facts, **environment()})
    verdict = "kept: the held-out frames are better, and the interval excludes 0"
    if not kept:
        verdict = (
            f"not kept: the held-out frames are not surely better, so {folder / 'model'} holds the weights "
            f"of {weights} as they were"
        )
    log.say(verdict)
    log.say(f"written to {folder}: model/, {RUN_FILE}, before_after.png, held_out.csv")
    if kept:
        given = facts["config"]["intrinsics"]
        lens = f"'intrinsics={list(given)}'".replace(" ", "") if isinstance(given, list) else "intrinsics=..."
        log.say(f"to use it: python -m eldenet.predict checkpoint={folder} source=... {lens}")
    log.close()
    return kept

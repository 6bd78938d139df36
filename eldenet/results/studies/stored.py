"""The finished runs of a study's row, as they are stored beside its plan."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eldenet.results.comparison import with_every_rule
from eldenet.results.run_record import read_run
from eldenet.results.studies.matching import outdated
from eldenet.results.studies.plan import KEPT, Study, StudyRow


@dataclass(frozen=True)
class Stored:
    """What is stored of a row, where it is what the plan asks for today.

    Attributes:
        runs: contents of ``run.json``, one per finished seed.
        files: their ``per_image.csv``.
        outdated: a setting that the stored runs were not made with; then there are no runs.
    """

    runs: list[dict[str, Any]] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    outdated: str | None = None


def stored_runs(study: Study, row: StudyRow) -> Stored:
    """The runs of a row that every table and picture of the study is made of."""
    folders = [study.stored(row, seed) for seed in row.seeds]
    folders = [folder for folder in folders if all((folder / file).is_file() for file in KEPT)]
    runs = [read_run(folder) for folder in folders]
    for run in runs:
        different = outdated(study, row, run)
        if different:
            return Stored(outdated=different[0])
    if study.epoch == "last":
        runs = [run | {"metrics": last_metrics(run)} for run in runs]
    return Stored([with_every_rule(run) for run in runs], [folder / "per_image.csv" for folder in folders])


def last_metrics(run: Mapping[str, Any]) -> dict[str, Any]:
    """Metrics of a run after its last epoch, on the frames that it was validated on.

    They are those of the table only where both are the same frames: the kept epoch has to show that.

    Raises:
        ValueError: the run was validated on other frames, or not after its last epoch.
    """
    history = {row["epoch"]: row for row in run["training"]["history"]}
    kept, last = history[run["training"]["best_epoch"]], history[max(history)]
    who = f"{run['model']}, seed {run['seed']}"
    if "val_delta1" not in last:
        raise ValueError(f"{who} was not validated after its last epoch: epoch: last needs that")
    known = {name for name in run["metrics"] if f"val_{name}" in last}  # not: images, pixels
    other = [name for name in sorted(known) if not _close(kept.get(f"val_{name}"), run["metrics"][name])]
    if other:
        raise ValueError(
            f"{who} was validated on other frames than those of its table ({', '.join(other)} of the kept "
            "epoch differ): epoch: last has no figures for the table"
        )
    return {**run["metrics"], **{name: last[f"val_{name}"] for name in known}}


def _close(one: float | None, two: float | None) -> bool:
    if one is None or two is None:
        return one is two
    return math.isclose(one, two, rel_tol=1e-3)

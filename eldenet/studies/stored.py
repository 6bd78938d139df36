"""The finished runs of a study's row, as they are stored beside its plan."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eldenet.comparison import with_every_rule
from eldenet.record import read_run
from eldenet.studies.composing import outdated
from eldenet.studies.plan import KEPT, Study, StudyRow


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
    return Stored([with_every_rule(run) for run in runs], [folder / "per_image.csv" for folder in folders])

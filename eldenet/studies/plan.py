"""The plan of a study: a folder with ``sweep.yaml``, whose rows become the rows of its tables."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from eldenet.compose import compose
from eldenet.configurable import check_arguments
from eldenet.evaluation.metric_names import METRICS
from eldenet.results.packed_runs import RUNS, read_records
from eldenet.system.files import read_yaml
from eldenet.train import TrainSettings

PLAN = "sweep.yaml"
STARTS = ("weights=", "teacher=", "model.backbone.pretrained=")  # overrides that bring in other data
SHARED = ("seeds", "block", "seen", "learning_rate")  # defaults of all rows, given beside `rows:`
RATE = "optimizer.lr"  # the setting that `learning_rate` and `learning_rates` set
PLOTS, EPOCHS = ("pareto", "differences"), ("chosen", "last")
# a setting that must be given -> the table's "... not given"; "data" for any other
WORDS = {"weights": "weights", "model.backbone.pretrained": "weights", "teacher": "teacher"}
_ROW_NAME = re.compile(r"\w[\w.+-]*")


@dataclass(frozen=True)
class StudyRow:
    """One row of the tables."""

    name: str  # of the row, of its runs and their folders
    # of eldenet.train, after the study's own; {runs} stands for the study's run folder, {seed} for the run's
    # seed
    overrides: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)  # one run each
    block: str = "scratch"  # start class or data set; rows are compared within their block only
    # data that its weights have seen before and during training; "not stated" by default where other weights
    # take part
    seen: str = "the training frames alone"
    # name -> setting that the command line must give (given.kitti=/data/kitti) before the row can run, such
    # as {kitti: data.root}
    given: Mapping[str, str] = field(default_factory=dict)
    # of the optimizer; None: the study's learning_rates are searched, if it has any
    learning_rate: float | None = None
    rate_overrides: tuple[str, ...] = ()  # of its trials, after the study's rate_overrides
    # the study that the row is taken from: it runs with that study's settings and is stored there
    owner: "Study | None" = None

    @property
    def not_given(self) -> str:
        """Status in the table while something that the row needs is not given."""
        return f"{next((WORDS[name] for name in self.given.values() if name in WORDS), 'data')} not given"


@dataclass(frozen=True)
class Study:
    """The plan of a study."""

    folder: Path  # of sweep.yaml and of the results
    rows: tuple[StudyRow, ...]  # in the order of the tables
    overrides: tuple[str, ...] = ()  # of eldenet.train, shared by all rows
    # values of optimizer.lr that every row tries; empty: the optimizer's own is used
    learning_rates: tuple[float, ...] = ()
    # of a trial: fewer epochs, and a held-out part of the training split as data.test
    rate_overrides: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()  # rows that the others of their block are compared with, image by image
    compare: str = "delta1"  # the metric of that comparison
    # metrics of the tables
    columns: tuple[str, ...] = ("abs_rel", "rmse", "mae", "mse", "delta1", "delta2", "delta3")
    # "chosen": metrics of the epoch whose weights a run kept; "last": of its last epoch, from the training's
    # history, where the epoch was chosen on the frames of the table. There are no differences then, since the
    # metrics of single images are those of the kept weights
    epoch: str = "chosen"
    # "pareto" (accuracy against latency or, without one, multiply-adds), "differences" (to the reference
    # rows, with intervals)
    plots: tuple[str, ...] = ("pareto",)
    # CSV in the study's folder that eldenet.benchmark study=... wrote; None: no latencies, since those that
    # runs measure beside other work mislead
    latency: str | None = None

    @property
    def name(self) -> str:
        """Name of the folder, also where that is given as ``.``."""
        return _folder_name(self.folder)

    def chosen(self, names: Sequence[str] | str | None) -> list[StudyRow]:
        """The rows of these names in the plan's order; None: all.

        Raises:
            ValueError: there is no such row.
        """
        wanted = [names] if isinstance(names, str) else names
        known = [row.name for row in self.rows]
        unknown = [name for name in wanted or () if name not in known]
        if unknown:
            raise ValueError(f"rows={unknown}: {self.folder / PLAN} has the rows {', '.join(known)}")
        return [row for row in self.rows if wanted is None or row.name in wanted]

    def owner_of(self, row: StudyRow) -> "Study":
        """The study that runs and stores a row: this one, or the one that the row is taken from."""
        return row.owner or self

    def overrides_of(self, row: StudyRow, *, trial: bool = False) -> list[str]:
        """Overrides of a row's trainings, or of its trials of learning rates."""
        owner = self.owner_of(row)
        shared = [*owner.overrides, *row.overrides]
        return [*shared, *owner.rate_overrides, *row.rate_overrides] if trial else shared

    def searches_rate(self, row: StudyRow) -> bool:
        """Whether a row's learning rate is the best of several trials."""
        return row.learning_rate is None and bool(self.owner_of(row).learning_rates)

    def stored(self, row: StudyRow, seed: int) -> dict[str, Any] | None:
        """The ``run.json`` of a finished run; None: there is none."""
        return read_records(self.owner_of(row).folder / RUNS).get(run_name(row, seed))

    def stored_rate(self, row: StudyRow) -> dict[str, Any] | None:
        """The choice of a row's trials; None: there is none."""
        return read_records(self.owner_of(row).folder / RUNS).get(rate_name(row))


def run_name(row: StudyRow, seed: int) -> str:
    """The name of a row's run, and of its folder."""
    return f"{row.name}/seed{seed}"


def rate_name(row: StudyRow) -> str:
    """The name of the choice of a row's learning rate."""
    return f"{row.name}/learning_rate"


def training_settings(overrides: Sequence[str]) -> dict[str, Any]:
    """The resolved settings of ``eldenet.train`` with these overrides, as ``run.json`` stores them."""
    return asdict(compose(TrainSettings, overrides))


def read_study(folder: str | Path, _readers: tuple[str, ...] = ()) -> Study:
    """Read ``sweep.yaml`` in ``folder``.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it has no rows, an unknown or wrong entry, or two learning rates for a row.
    """
    folder = Path(folder)
    path = folder / PLAN
    if not path.is_file():
        raise FileNotFoundError(
            f"no {PLAN} in {folder}: give a study's folder, such as study=experiments/ablations"
        )
    content = read_yaml(path)
    if not isinstance(content, dict) or not isinstance(content.get("rows"), dict) or not content["rows"]:
        raise ValueError(f"{path} has no rows: it needs 'rows: {{name: {{overrides: [...]}}}}'")
    described = content.pop("rows")
    shared = {name: content.pop(name) for name in SHARED if name in content}
    rows = []
    for name, entry in described.items():
        where = f"{path}: row {name}"
        if not _ROW_NAME.fullmatch(str(name)):  # it names folders, and stands in overrides
            raise ValueError(f"{where}: give a name of letters, digits and ._+-")
        if not isinstance(entry, dict | None):
            raise ValueError(f"{where}: give a mapping, such as {{overrides: [model=eldenet]}}")
        if entry and "from" in entry:
            rows.append(_taken_row(path, str(name), entry, _readers))
        else:
            own = _checked(where, shared | (entry or {}), StudyRow, without=("name", "owner"))
            row = StudyRow(str(name), **own)
            starts = any(word.startswith(STARTS) for word in row.overrides)
            rows.append(replace(row, seen="not stated") if starts and "seen" not in own else row)
    own = _checked(str(path), content, Study, without=("folder", "rows"))
    study = Study(folder, tuple(rows), **own)
    for name, values, allowed in (
        ("reference", study.reference, tuple(map(str, described))),
        ("columns", study.columns, METRICS),
        ("compare", (study.compare,), METRICS),
        ("plots", study.plots, PLOTS),
        ("epoch", (study.epoch,), EPOCHS),
    ):
        if unknown := [value for value in values if value not in allowed]:
            raise ValueError(f"{path}: {name}={unknown}: choose from {', '.join(allowed)}")
    if study.epoch == "last" and study.reference:
        raise ValueError(
            f"{path}: reference compares image by image, and epoch: last has no metrics of single images: "
            "remove one of them"
        )
    for row in study.rows:
        if not row.seeds or len(set(row.seeds)) < len(row.seeds):
            raise ValueError(f"{path}: row {row.name}: seeds={list(row.seeds)}: give different seeds: [0, 1]")
        _refuse_second_rate(path, study, row)
    return study


def _folder_name(folder: Path) -> str:
    return Path(os.path.abspath(folder)).name


def _taken_row(path: Path, name: str, entry: Mapping[str, Any], readers: tuple[str, ...]) -> StudyRow:
    """A row of another study beside this one: the same runs, so that no table trains them again."""
    if set(entry) - {"from", "block"}:
        raise ValueError(f"{path}: row {name}, taken from another study: it may have a block, nothing else")
    readers = (*readers, _folder_name(path.parent))
    if entry["from"] in readers:
        raise ValueError(f"{path}: row {name} refers to itself: {' -> '.join((*readers, entry['from']))}")
    owner = read_study(os.path.normpath(path.parent / ".." / str(entry["from"])), readers)
    (row,) = owner.chosen(name)
    return replace(row, block=entry.get("block", row.block), owner=owner.owner_of(row))


def _refuse_second_rate(path: Path, study: Study, row: StudyRow) -> None:
    """Refuse a learning rate among overrides that the row's own rate or the search would replace."""
    searched = study.searches_rate(row)
    if row.owner is not None or not (searched or row.learning_rate is not None):
        return
    for text in study.overrides_of(row, trial=searched):
        if text.lstrip("+").startswith(f"{RATE}="):
            instead = "the search of learning_rates" if searched else f"learning_rate: {row.learning_rate:g}"
            raise ValueError(
                f"{path}: row {row.name}: {instead} replaces the override {text}: write learning_rate: "
                f"{text.partition('=')[2]} as an entry of the row, which is then not searched, or remove the "
                "override"
            )


def _checked(
    where: str, entries: Mapping[str, Any], target: type, *, without: Sequence[str]
) -> dict[str, Any]:
    """Entries of the plan with tuples for lists; refuse names and types that ``target`` does not have."""
    known = {entry.name for entry in fields(target)} - {*without}
    if unknown := sorted(set(entries) - known):
        raise ValueError(f"{where}: unknown entries {unknown}: choose from {', '.join(sorted(known))}")
    check_arguments(target, entries, f"{where}: ")
    return {name: tuple(value) if isinstance(value, list) else value for name, value in entries.items()}

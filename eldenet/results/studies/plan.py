"""What a study is: a folder with ``sweep.yaml``, whose rows become the rows of its tables."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from eldenet import config as cfg
from eldenet.evaluation.metrics import METRICS

PLAN = "sweep.yaml"
SHARED = ("seeds", "block", "seen", "learning_rate")  # of all rows that do not say otherwise
STORED = "stored"  # results of finished runs, small enough for git
RATE_FILE = "learning_rate.json"  # beside them: what the trials of a row chose
RATE = "optimizer.lr"  # what `learning_rate` and `learning_rates` give
KEPT = ("per_image.csv", "run.json")  # of each; the last one says that it is stored
# of what a row needs, by its setting: "weights not given"; else data
WORDS = {"weights": "weights", "model.backbone.pretrained": "weights", "teacher": "teacher"}


@dataclass(frozen=True)
class StudyRow:
    """One row of the tables.

    Attributes:
        name: of the row, of its runs and their folders.
        overrides: of ``eldenet.train``, after the study's own; ``{runs}`` stands for the study's run folder,
            ``{seed}`` for the run's seed.
        seeds: one run each.
        block: the start class (or data set) that the row is compared within.
        seen: what its weights have seen before and during training.
        given: name -> setting that must be given on the command line (``given.kitti=/data/kitti``) for the
            row to run, such as ``{kitti: data.root}``.
        learning_rate: of the optimizer; None: by the study's rule, if it has one.
        rate_overrides: what its trials change beside the study's ``rate_overrides``.
        owner: the study that the row is taken from: it is run by that study's settings, and stored there.
    """

    name: str
    overrides: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)
    block: str = "scratch"
    seen: str = "the training frames alone"
    given: Mapping[str, str] | None = None
    learning_rate: float | None = None
    rate_overrides: tuple[str, ...] = ()
    owner: "Study | None" = None

    @property
    def missing_word(self) -> str:
        """What the table says while something the row needs was not given."""
        settings = (self.given or {}).values()
        return f"{next((WORDS[name] for name in settings if name in WORDS), 'data')} not given"


@dataclass(frozen=True)
class Study:
    """A study's plan.

    Attributes:
        folder: where ``sweep.yaml`` lies and the results go.
        rows: in the order of the tables.
        overrides: of ``eldenet.train``, shared by all rows.
        learning_rates: values of ``optimizer.lr`` that every row tries; none: the optimizer's own is taken.
        rate_overrides: what a trial of a learning rate changes: fewer epochs, and a part of the training
            split that is held out of it as its ``data.test``.
        reference: rows that the others of their block are compared with, image by image.
        compare: the metric of that comparison.
        columns: metrics of the tables.
        epoch: "chosen": figures of the epoch whose weights a run kept; "last": of its last epoch, from the
            training's history, where the table's frames are those that the epoch was chosen on. There are no
            differences then: figures of single images are those of the kept weights.
        plots: "pareto" (accuracy against latency, else multiply-adds), "differences" (to the reference rows,
            with intervals), "convergence" (curves of epochs).
        latency: CSV in the study's folder that ``eldenet.benchmark study=...`` wrote; None: no latencies, for
            those that runs measured beside other work mislead.
    """

    folder: Path
    rows: tuple[StudyRow, ...]
    overrides: tuple[str, ...] = ()
    learning_rates: tuple[float, ...] = ()
    rate_overrides: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()
    compare: str = "delta1"
    columns: tuple[str, ...] = ("abs_rel", "rmse", "mae", "mse", "delta1", "delta2", "delta3")
    epoch: str = "chosen"
    plots: tuple[str, ...] = ("pareto",)
    latency: str | None = None

    @property
    def name(self) -> str:
        """The folder's, also where that is given as ``.``."""
        return _name(self.folder)

    def chosen(self, names: Sequence[str] | str | None) -> list[StudyRow]:
        """The rows of these names, all without; in the plan's order.

        Raises:
            ValueError: there is no such row.
        """
        wanted = [names] if isinstance(names, str) else names
        known = [row.name for row in self.rows]
        unknown = [name for name in wanted or () if name not in known]
        if unknown:
            raise ValueError(f"rows={unknown}: {self.folder / PLAN} has the rows {', '.join(known)}")
        return [row for row in self.rows if wanted is None or row.name in wanted]

    def stored(self, row: StudyRow, seed: int) -> Path:
        """Where the results of one finished run are kept."""
        return (row.owner or self).folder / STORED / row.name / f"seed{seed}"


def read_study(folder: str | Path, _readers: tuple[str, ...] = ()) -> Study:
    """Read ``sweep.yaml``.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it has an entry that it should not have, lacks rows, or gives a learning rate twice.
    """
    folder = Path(folder)
    path = folder / PLAN
    if not path.is_file():
        raise FileNotFoundError(
            f"no {PLAN} in {folder}: give a study's folder, such as study=experiments/ablations"
        )
    content = cfg.read_yaml(path)
    if not isinstance(content, dict) or not isinstance(content.get("rows"), dict) or not content["rows"]:
        raise ValueError(f"{path} has no rows: it needs 'rows: {{name: {{overrides: [...]}}}}'")
    of_row = {field.name for field in fields(StudyRow)} - {"name", "owner"}
    of_study = {field.name for field in fields(Study)} - {"folder", "rows"}
    shared = {name: content.pop(name) for name in SHARED if name in content}
    described = content.pop("rows")
    _refuse_unknown(path, content, of_study | {"rows", *SHARED})
    rows = []
    for name, entry in described.items():
        if entry and "from" in entry:
            rows.append(_taken_row(path, str(name), entry, _readers))
            continue
        entry = shared | (entry or {})
        _refuse_unknown(path, entry, of_row | {"from"}, f"row {name}: ")
        values = {key: _frozen(value) for key, value in entry.items()}
        _check_kinds(path, values, f"row {name}: ")
        rows.append(StudyRow(str(name), **values))
    _check_kinds(path, {key: _frozen(value) for key, value in content.items()})
    study = Study(folder, tuple(rows), **{key: _frozen(value) for key, value in content.items()})
    for row in study.rows:
        _refuse_second_rate(path, study, row)
    unknown = [name for name in study.reference if name not in described]
    if unknown:
        raise ValueError(f"{path}: reference {unknown} are no rows of it")
    metrics = [name for name in (*study.columns, study.compare) if name not in METRICS]
    if metrics:
        raise ValueError(f"{path}: {metrics} are no metrics, choose among {', '.join(METRICS)}")
    if study.epoch == "last" and study.reference:
        raise ValueError(
            f"{path}: reference compares image by image, and epoch: last has no figures of images: drop one"
        )
    return study


def _name(folder: Path) -> str:
    return Path(os.path.abspath(folder)).name


def _taken_row(path: Path, name: str, entry: Mapping[str, Any], readers: tuple[str, ...]) -> StudyRow:
    """A row of another study beside this one: the same runs, so that no table trains them again."""
    _refuse_unknown(path, entry, {"from", "block"}, f"row {name}, taken from another study: ")
    readers = (*readers, _name(path.parent))
    if entry["from"] in readers:
        raise ValueError(f"{path}: row {name} is taken in a circle: {' -> '.join((*readers, entry['from']))}")
    owner = read_study(os.path.normpath(path.parent / ".." / entry["from"]), readers)
    (row,) = owner.chosen(name)
    return replace(row, block=entry.get("block", row.block), owner=row.owner or owner)


def _refuse_second_rate(path: Path, study: Study, row: StudyRow) -> None:
    """Refuse a learning rate among overrides where the row's own, or the search, would take its place."""
    searched = row.learning_rate is None and bool(study.learning_rates)
    if row.owner is not None or not (searched or row.learning_rate is not None):
        return
    texts = [*study.overrides, *row.overrides]
    if searched:
        texts += [*study.rate_overrides, *row.rate_overrides]
    written = next((text for text in texts if text.lstrip("+").startswith(f"{RATE}=")), None)
    if written is not None:
        value = written.partition("=")[2]
        instead = "the search of learning_rates" if searched else f"learning_rate: {row.learning_rate:g}"
        raise ValueError(
            f"{path}: row {row.name}: {instead} would take the place of the override {written}: write "
            f"learning_rate: {value} as an entry of the row instead, which is then not searched, or take the "
            "override out"
        )


def _refuse_unknown(path: Path, entry: Mapping[str, Any], allowed: set[str], where: str = "") -> None:
    unknown = sorted(set(entry) - allowed)
    if unknown:
        raise ValueError(
            f"{path}: {where}unknown entries {unknown}, allowed are {', '.join(sorted(allowed))}"
        )


def _check_kinds(path: Path, values: Mapping[str, Any], where: str = "") -> None:
    """Refuse what would only fail later, or do nothing."""
    for name, (fits, words) in KINDS.items():
        if name not in values or (values[name] is None and name == "learning_rate"):
            continue
        if not fits(values[name]):
            raise ValueError(f"{path}: {where}{name}={values[name]!r}: give {words}")


def _texts(value: Any) -> bool:
    return isinstance(value, tuple) and all(isinstance(one, str) for one in value)


def _rates(value: Any) -> bool:
    return isinstance(value, tuple) and all(isinstance(one, float) and one > 0 for one in value)


KINDS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "overrides": (_texts, "a list of overrides, such as [model=eldenet]"),
    "rate_overrides": (_texts, "a list of overrides, such as [trainer.epochs=6]"),
    "reference": (_texts, "a list of rows"),
    "columns": (_texts, "a list of metrics"),
    "seeds": (
        lambda value: (
            isinstance(value, tuple)
            and all(isinstance(one, int) for one in value)
            and 0 < len(value) == len(set(value))
        ),
        "a list of different seeds, such as [0, 1, 2]",
    ),
    "given": (lambda value: isinstance(value, Mapping), "a mapping, such as {kitti: data.root}"),
    "learning_rate": (
        lambda value: isinstance(value, float) and value > 0,
        "a number above 0, such as 1.0e-3",
    ),
    "learning_rates": (_rates, "a list of numbers above 0, such as [3.0e-4, 1.0e-3]"),
    "epoch": (lambda value: value in ("chosen", "last"), "chosen or last"),
    "plots": (
        lambda value: _texts(value) and set(value) <= {"pareto", "differences", "convergence"},
        "pareto, differences or convergence",
    ),
}


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def row_names(study: str, rows: Sequence[str] | None = None) -> str:
    """``a,b,c``: what Hydra's sweeper makes one job each of (see configs/study.yaml)."""
    return ",".join(row.name for row in read_study(study).chosen(rows))

"""Runs side by side: seeds share a row, and what does not compare shares no table."""

import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eldenet.evaluation.metrics import METRICS
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.results.fingerprints import KEYS, sources_of
from eldenet.results.run_record import RUN_FILE, differences, read_record, read_run
from eldenet.results.tables import COLUMNS, COSTS, heading, number

# a metrics column may hold one of each only; so may a cost column
SAME_FOR_METRICS = ("data", "split", "split_hash", "protocol")
# runs that share a row differ in their seed, and in nothing that shapes a training
SAME_IN_A_ROW = (
    "model",
    "data",
    "loss",
    "optimizer",
    "scheduler",
    "augmentation",
    "trainer",
    "normalization",
)
SAME_FOR_COSTS = ("runtime", "precision", "threads", "device", "height", "width", "batch", "processor")


@dataclass(frozen=True)
class Row:
    """One row: the runs of one model that differ in their seed only.

    Attributes:
        model: its name.
        runs: contents of their ``run.json``.
    """

    model: str
    runs: Sequence[Mapping[str, Any]]

    def values(self, group: str, name: str) -> list[float]:
        """The value of every run; none at all if one run has none: a mean over some seeds would mislead."""
        found = [run[group].get(name) for run in self.runs]
        return [] if None in found else found

    def text(self, group: str, name: str) -> str:
        """Mean, with the sample standard deviation if there are several seeds."""
        values = self.values(group, name)
        if not values:
            return "-"
        mean = number(name, statistics.fmean(values))
        if len(values) == 1 or group == "cost":
            return mean
        return f"{mean} ± {number(name, statistics.stdev(values))}"


def find_runs(sources: Sequence[str]) -> list[dict[str, Any]]:
    """All ``run.json`` of trainings and evaluations of depth below the given files and folders.

    Other commands leave records of that name, too (a detector's training, navigation): those in folders are
    passed by.

    Raises:
        FileNotFoundError: a source does not exist, or there is no run anywhere.
        ValueError: a file that was given is the record of another command.
    """
    files: dict[Path, None] = {}
    for source in map(Path, sources):
        if not source.exists():
            raise FileNotFoundError(f"no such file or folder: {source}")
        below = [source] if source.is_file() else sorted(source.rglob(RUN_FILE))
        files |= {file.resolve(): None for file in below if file == source or not _is_anothers(file)}
    runs = {file: read_run(file) for file in files}
    if not runs:
        raise FileNotFoundError(f"no {RUN_FILE} below {', '.join(map(str, sources))}: has a run finished?")
    for file, run in runs.items():
        if "protocol" not in run:
            raise ValueError(f"{file} has no protocol: it was not written by eldenet's train or evaluate")
    return [with_every_rule(run) for run in runs.values()]


def _is_anothers(file: Path) -> bool:
    """Whether a command that scores no depth wrote this record."""
    record = read_record(file)
    return "protocol" not in record and ("metrics" in record or "mode" in record)


def with_every_rule(run: Mapping[str, Any]) -> dict[str, Any]:
    """A run whose protocol has every rule: one that did not exist yet was not applied, so both compare."""
    return {**run, "protocol": EvalProtocol("").as_dict() | run["protocol"]}


def group_rows(runs: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Runs of one model, seeds together, in order of first appearance.

    Raises:
        ValueError: runs of one name have one seed, or differ in more than it.
    """
    rows: dict[str, list[Mapping[str, Any]]] = {}
    for run in runs:
        rows.setdefault(str(run["model"]), []).append(run)
    for model, members in rows.items():
        seeds = [run.get("seed") for run in members]
        if len(set(seeds)) < len(seeds):
            raise ValueError(
                f"{len(members)} runs are called {model!r} and seeds {seeds} repeat: give them names of "
                "their own (model_name=...), or report them apart"
            )
        for section in SAME_IN_A_ROW:
            settings = [run.get("config", {}).get(section) for run in members]
            _refuse_differences(model, settings, section, ignored=KEYS)
        _refuse_differences(model, _shared_sources(members), "sources")
        _refuse_differences(model, [run.get("train_split_hash") for run in members], "train_split_hash")
        precision = [run.get("resources", {}).get("precision") for run in members]
        _refuse_differences(model, precision, "precision")
    return [Row(model, members) for model, members in rows.items()]


def _shared_sources(members: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Content of the weights and teachers that each run was given, but of those that are each seed's own."""
    found: list[dict[str, Any]] = [dict(run.get("sources", {})) for run in members]
    places = [sources_of(run.get("config", {})) for run in members]
    for name in set().union(*found):
        owned = (
            re.search(rf"seed{run.get('seed')}(?!\d)", at.get(name, ""))
            for run, at in zip(members, places, strict=True)
        )
        if all(owned):
            for content in found:
                content.pop(name, None)
    return found


def _refuse_differences(
    model: str, settings: Sequence[Any], section: str, ignored: frozenset[str] = frozenset()
) -> None:
    different = [
        text for other in settings for text in differences(settings[0], other, section, ignored=ignored)
    ]
    if different:
        raise ValueError(
            f"{len(settings)} runs are called {model!r}, but {section} differs: seeds share a row, other "
            f"settings do not ({different[0]}). Give them names of their own (model_name=...)"
        )


def refuse_mixtures(runs: Sequence[Mapping[str, Any]], *, costs: bool) -> None:
    """Refuse columns whose numbers do not compare.

    Raises:
        ValueError: names what differs.
    """
    for name in SAME_FOR_METRICS:
        _refuse(name, [run[name] for run in runs])
    if costs:
        for name in SAME_FOR_COSTS:
            _refuse(
                name,
                [run["hardware"]["processor"] if name == "processor" else run["cost"][name] for run in runs],
            )


def _refuse(name: str, values: Sequence[Any]) -> None:
    different = list(dict.fromkeys(str(value) for value in values))
    if len(different) > 1:
        raise ValueError(
            f"these runs do not compare: {name} differs ({' | '.join(different[:3])}). Report them "
            "apart" + ("" if name in SAME_FOR_METRICS else ", or without costs (costs=false)")
        )


def table_of(
    runs: Sequence[Mapping[str, Any]], columns: Sequence[str] = COLUMNS, *, costs: bool = True
) -> tuple[list[str], list[list[str]]]:
    """Titles and rows of the table over ``runs``."""
    unknown = [name for name in columns if name not in METRICS]
    if unknown:
        raise ValueError(f"columns={unknown}: choose among {', '.join(METRICS)}")
    refuse_mixtures(runs, costs=costs)
    wanted = [("metrics", name) for name in columns] + [("cost", name) for name in COSTS if costs]
    titles = ["model", "seeds", *(heading(name, runs[0]) for _, name in wanted)]
    rows = [
        [row.model, str(len(row.runs)), *(row.text(group, name) for group, name in wanted)]
        for row in group_rows(runs)
    ]
    costless = ["-"] * len(wanted[len(columns) :])
    rows += [[label, "-", *shown, *costless] for label, shown in constant_rows(runs, columns)]
    return titles, rows


def constant_rows(runs: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Labels and figures of the constant predictor: one line, or one for each that the runs do not share.

    It depends on the training frames and on the size of their depth, which runs of one table may differ in.
    """
    models: dict[tuple[str, ...], list[str]] = {}  # figures -> whose they are
    for run in runs:
        if (constant := run["constant_predictor"]) is not None:
            shown = tuple(number(name, constant.get(name)) for name in columns)
            models.setdefault(shown, []).append(str(run["model"]))
    if len(models) == 1:
        return [("constant predictor", list(shown)) for shown in models]
    labels = (f"constant predictor of {_few(list(dict.fromkeys(names)))}" for names in models.values())
    return [(label, list(shown)) for label, shown in zip(labels, models, strict=True)]


def _few(names: Sequence[str], shown: int = 3) -> str:
    return ", ".join(names[:shown]) + (f" and {len(names) - shown} more" if len(names) > shown else "")

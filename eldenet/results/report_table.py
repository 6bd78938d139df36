"""Runs side by side: seeds share a row; runs that do not compare share no table."""

import os
import re
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eldenet.evaluation.metric_names import METRICS
from eldenet.results.fingerprints import KEYS, differences, sources_of
from eldenet.results.packed_runs import RUNS, read_records
from eldenet.results.run_log import RunLog
from eldenet.results.run_record import RUN_FILE, read_record, scored_run
from eldenet.results.tables import (
    COLUMNS,
    CORE,
    COSTS,
    MARK,
    cost_line,
    cost_text,
    heading,
    number,
    protocol_line,
    to_csv,
    to_latex,
    to_markdown,
)
from eldenet.system.errors import some_of
from eldenet.system.files import write_rows, write_text

# equal in all runs of a table: of its metrics, and of its costs
SAME_FOR_METRICS = ("data", "split", "split_hash", "protocol")
SAME_FOR_COSTS = ("runtime", "precision", "threads", "device", "height", "width", "batch", "processor")
NEEDED_FOR_COSTS = ("hardware.processor", *(f"cost.{name}" for name in SAME_FOR_COSTS[:-1]))
# settings that name no row
UNNAMED = ("seed", "output", "run_dir", "ckpt_path", "model", "model_name")
# equal in all runs of a row, which differ in their seed: the sections that shape a training
SAME_IN_A_ROW = (
    *("model", "data", "loss", "optimizer", "scheduler", "augmentation", "trainer", "normalization"),
)
OF_A_NETWORK = ("params", "height", "width", "precision")  # among its costs: no seed changes them


def report_runs(
    sources: Sequence[str],
    output: Path,
    *,
    columns: Sequence[str] | None = None,
    costs: bool = True,
    names: Sequence[str] = (),
) -> None:
    """Print the table of some runs and write it as Markdown, CSV and LaTeX.

    Args:
        sources: ``run.json`` files, or folders that hold some.
        output: path of the table; ``.md``, ``.csv`` and ``.tex`` are written.
        columns: metrics; None: those of :data:`COLUMNS`, and in LaTeX what fits a page.
        costs: whether costs are shown too.
        names: of the rows, one for each of ``sources``; empty: the names that the runs have.
    """
    runs = find_runs(sources, needed=("metrics.images", *(NEEDED_FOR_COSTS if costs else ())), names=names)
    shown = COLUMNS if columns is None else columns
    titles, rows = table_of(runs, shown, costs=costs)
    measured = 2 + len(shown)  # model, seeds, metrics; then the costs
    metrics = titles[:measured], [row[:measured] for row in rows]

    def costs_of(rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
        kept = [[row[0], *row[measured:]] for row in rows if set(row[measured:]) - {"-"}]
        return [titles[0], *titles[measured:]], kept

    core = [2 + place for place, name in enumerate(shown) if name in CORE or columns is not None]
    sure = [[row[0], *("-" if cell.endswith(MARK) else cell for cell in row[1:])] for row in rows]
    busy = sure != rows
    notes = [protocol_line(runs[0])] + ([cost_line(runs[0], busy=busy)] if costs else [])
    stem = output.stem if output.suffix in (".md", ".csv", ".tex") else output.name  # "v0.5" has no ending
    write_rows(output.with_name(f"{stem}.csv"), *to_csv(titles, sure))
    write_text(output.with_name(f"{stem}.md"), to_markdown(titles, rows, notes))
    latex = [to_latex(*metrics, notes[:1], core if columns is None else None)]
    latex += [to_latex(*costs_of(sure), notes[1:])] if costs else []
    write_text(output.with_name(f"{stem}.tex"), "\n".join(latex))
    log = RunLog(output.parent)
    log.table(notes[0], *metrics, core)
    if costs:
        log.table(notes[1], *costs_of(rows))
    log.say(f"written to {output.with_name(stem)}.md, .csv and .tex")


@dataclass(frozen=True)
class Row:
    """The runs of one model, which differ in their seed alone; ``runs`` are contents of ``run.json``."""

    model: str
    runs: Sequence[Mapping[str, Any]]

    def values(self, group: str, name: str) -> list[float]:
        """The value of every run; empty if one run has none, since a mean over some seeds would mislead."""
        found = [run[group].get(name) for run in self.runs]
        return [] if None in found else found

    def text(self, group: str, name: str) -> str:
        """Mean, with the sample standard deviation if there are several seeds."""
        values = self.values(group, name)
        if not values:
            return "-"
        if group == "cost":
            return cost_text(name, [run[group] for run in self.runs])
        mean = number(name, statistics.fmean(values))
        if len(values) == 1:
            return mean
        return f"{mean} ± {number(name, statistics.stdev(values))}"


def find_runs(
    sources: Sequence[str], needed: Sequence[str] = (), names: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """All runs of ``train`` and ``evaluate`` below the given files and folders, packed ones too.

    Records of other commands (navigation) are skipped in folders.

    Args:
        sources: ``run.json`` or ``runs.jsonl.xz`` files, and folders.
        needed: entries that every record must have, beside those of its metrics.
        names: for the runs below each of ``sources``, instead of their own.

    Raises:
        FileNotFoundError: a source does not exist, or there is no run in any.
        ValueError: a given file is the record of another command, a record is damaged, or there are not as
            many names as sources.
    """
    if names and len(names) != len(sources):
        raise ValueError(
            f"names={list(names)}: give one name for each of the {len(sources)} runs=[...]; the folder of a "
            "sweep is one of them, so name its runs one by one: runs=[sweep/0,sweep/1]"
        )
    runs: dict[str, dict[str, Any]] = {}
    given: Sequence[str | None] = names or [None] * len(sources)
    for source, name in zip(map(Path, sources), given, strict=True):
        for where, record in _records_below(source).items():
            run = {"run": os.path.relpath(Path(where).parent)}
            run |= scored_run(where, record, *SAME_FOR_METRICS, *needed)  # a packed one has its name
            runs[where] = run if name is None else run | {"model": name}
    if not runs:
        raise FileNotFoundError(f"no {RUN_FILE} below {', '.join(map(str, sources))}: has a run finished?")
    return list(runs.values())


def _records_below(source: Path) -> dict[str, dict[str, Any]]:
    """Records of runs by where they stand."""
    if not source.exists():
        raise FileNotFoundError(f"no such file or folder: {source}: give run folders, or folders of runs")
    found: dict[str, dict[str, Any]] = {}
    packed = [source] if source.name == RUNS else sorted(source.rglob(RUNS))
    for file in packed:
        records = {name: record for name, record in read_records(file).items() if "metrics" in record}
        found |= {f"{file.resolve()}, {name}": record for name, record in records.items()}
    for file in [source] if source.is_file() and not packed else sorted(source.rglob(RUN_FILE)):
        record = read_record(file)
        if source.is_file() or "protocol" in record or not {"metrics", "mode"} & record.keys():
            found[str(file.resolve())] = record
    return found


def group_rows(runs: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Runs of one model and settings, seeds together, in order of first appearance.

    Rows of one model, as a sweep trains them, are named by the settings of the command line that differ.

    Raises:
        ValueError: runs of one name have the same seed, or differ in more than the seed.
    """
    rows: dict[str, list[Mapping[str, Any]]] = {}
    for run in runs:
        rows.setdefault(str(run["model"]), []).append(run)
    rows = {name: alike for model, runs in rows.items() for name, alike in _by_settings(model, runs)}
    for model, members in rows.items():
        seeds = [run.get("seed") for run in members]
        if len(set(seeds)) < len(seeds):
            raise ValueError(
                f"{some_of([*map(_place, members)], 3)}: all are called {model!r}, but seeds {seeds} repeat: "
                "give one name for each of runs=[...] (names=[...]), or report them separately"
            )
        for section, text in _row_differences(members):
            raise ValueError(
                f"{len(members)} runs are called {model!r}, but {section} differs ({text}), and runs that "
                "share a row may differ in their seed only: give a name for each of runs=[...] (names=[...])"
            )
    return [Row(model, members) for model, members in rows.items()]


def _by_settings(
    model: str, members: Sequence[Mapping[str, Any]]
) -> list[tuple[str, list[Mapping[str, Any]]]]:
    """Names and runs of the rows of one model: a single row where no setting tells them apart."""
    rows: list[list[Mapping[str, Any]]] = []
    for run in members:
        row = next((row for row in rows if not any(_row_differences([row[0], run]))), None)
        if row is None:
            rows.append([run])
        else:
            row.append(run)
    given = [
        dict(word.lstrip("+").split("=", 1) for word in row[0].get("overrides", ()) if "=" in word)
        for row in rows
    ]
    keys = [
        key
        for key in dict.fromkeys(key for one in given for key in one)
        if key not in UNNAMED and len({one.get(key) for one in given}) > 1
    ]
    names = [" ".join([model, *(f"{key}={one[key]}" for key in keys if key in one)]) for one in given]
    if len(set(names)) < len(names):
        return [(model, list(members))]
    return list(zip(names, rows, strict=True))


def _row_differences(members: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Sections in which runs of one row must agree and these do not, and how they differ."""
    compared = {section: [run.get("config", {}).get(section) for run in members] for section in SAME_IN_A_ROW}
    compared["sources"] = _shared_sources(members)
    compared["train_split_hash"] = [run.get("train_split_hash") for run in members]
    compared["precision"] = [run.get("resources", {}).get("precision") for run in members]
    # the record of an evaluation does not say how its network was trained, but what it is
    measured = [run.get("cost", {}) for run in members]
    compared["network"] = [{name: cost.get(name) for name in OF_A_NETWORK} for cost in measured]
    for section, values in compared.items():
        ignored = KEYS if section in SAME_IN_A_ROW else frozenset[str]()
        for other in values:
            yield from ((section, text) for text in differences(values[0], other, section, ignored=ignored))


def _shared_sources(members: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Fingerprints of the weights and teachers of each run, without those that belong to its seed."""
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


def refuse_mixtures(runs: Sequence[Mapping[str, Any]], *, costs: bool) -> None:
    """Raise ValueError for runs whose metrics, or whose costs, do not compare."""
    for name in (*SAME_FOR_METRICS, *(SAME_FOR_COSTS if costs else ())):
        of_cost = name in SAME_FOR_COSTS
        values = [(run["cost"] | run["hardware"] if of_cost else run)[name] for run in runs]
        for run, value in zip(runs, values, strict=True):
            if str(value) != str(values[0]):
                found = differences(values[0], value, name) or [f"{name}={values[0]} (there {value})"]
                raise ValueError(
                    f"{_place(runs[0])} and {_place(run)} cannot be compared: {name} differs "
                    f"({some_of(found, 3)}). Report them separately"
                    + (", or without costs (costs=false)" if of_cost else "")
                )
    counts = [run["metrics"].get("pixels") for run in runs]
    for run, count in zip(runs, counts, strict=True):
        if count != counts[0]:
            raise ValueError(
                f"{_place(runs[0])} and {_place(run)} cannot be compared: they scored {counts[0]} and "
                f"{count} pixels of frames of the same names, so their depth maps differ (data.root, "
                "data.size, data.min_confidence, ...). Report them separately"
            )


def _place(run: Mapping[str, Any]) -> str:
    """Where a run is stored, or its model's name."""
    return str(run.get("run", run["model"]))


def table_of(
    runs: Sequence[Mapping[str, Any]], columns: Sequence[str] = COLUMNS, *, costs: bool = True
) -> tuple[list[str], list[list[str]]]:
    """Titles and rows of the table over ``runs``."""
    unknown = [name for name in columns if name not in METRICS]
    if unknown:
        raise ValueError(f"columns={unknown}: choose from {', '.join(METRICS)}")
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
    """Labels and metrics of the constant predictors of ``runs``, in one line if all of them share one.

    It depends on the training frames and on the size of their depth, in which runs of a table may differ.
    """
    models: dict[tuple[str, ...], list[str]] = {}  # metrics -> models of the runs
    for run in runs:
        if (constant := run.get("constant_predictor")) is not None:
            shown = tuple(number(name, constant.get(name)) for name in columns)
            models.setdefault(shown, []).append(str(run["model"]))
    if len(models) == 1:
        return [("constant predictor", list(shown)) for shown in models]
    labels = (f"constant predictor of {some_of(list(dict.fromkeys(names)), 3)}" for names in models.values())
    return [(label, list(shown)) for label, shown in zip(labels, models, strict=True)]

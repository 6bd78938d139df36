"""The tables of a study from its stored runs: one block per start class, compared with no other."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from eldenet.evaluation.metric_names import LOWER_IS_BETTER
from eldenet.results import paired_intervals
from eldenet.results.paired_intervals import Difference
from eldenet.results.report_table import Row, constant_rows, group_rows, refuse_mixtures
from eldenet.results.run_record import check_figures
from eldenet.results.tables import CORE, heading, number, protocol_line, training_line
from eldenet.studies.latency import Latencies
from eldenet.studies.matching import outdated_search, stored_choice, stored_runs
from eldenet.studies.plan import Study, StudyRow, run_name
from eldenet.system.errors import reading
from eldenet.system.files import read_table

PUBLISHED = ("abs_rel", "rmse", "delta1")
COUNTED = ("params", "gmacs")  # costs that a busy machine does not change; a benchmark measures latencies
SEEN = "weights have seen"  # title of a column
SEEDS_OF_A_VERDICT = 3  # fewer runs of a row say nothing about the chance in a training
EXPECTED_HEADER = ("row", "block", "status", *PUBLISHED, "protocol", "source")


class Column(NamedTuple):
    """A column of a block."""

    title: str
    kind: str  # "row", "seeds", "seen", "metric", "difference", "cost" or "published"
    cell: Callable[["Member"], str]
    core: bool = False  # whether it comes first where there is no room for all


@dataclass(frozen=True)
class Block:
    """One table: rows of one start class."""

    name: str  # of the start class
    columns: list[Column]
    rows: list[list[str]]  # cells
    notes: list[str]  # lines below the table
    points: list[tuple[str, float, float]]  # row, latency [ms] or GMACs, metric, for the plot
    differences: dict[str, Difference]  # to the reference row, by row
    reference: str  # that row; "" without one

    @property
    def titles(self) -> list[str]:
        """Titles of all columns."""
        return [column.title for column in self.columns]

    def part(self, *kinds: str) -> tuple[list[str], list[list[str]], list[int]]:
        """Titles and core columns of these kinds, and the rows that have a figure of the last one."""
        places = [place for place, column in enumerate(self.columns) if column.kind in kinds]
        figures = [place for place in places if self.columns[place].kind == kinds[-1]]
        rows = [row for row in self.rows if any(row[place] != "-" for place in figures)]
        core = [number for number, place in enumerate(places) if self.columns[place].core]
        titles = [self.columns[place].title for place in places]
        return titles, [[row[place] for place in places] for row in rows], core

    def measured_here(self) -> tuple[list[str], list[list[str]]]:
        """Titles and rows without the published figures, which are shown in a separate table."""
        count = sum(column.kind != "published" for column in self.columns)
        return self.titles[:count], [row[:count] for row in self.rows]

    def apart(self) -> list[tuple[list[str], list[list[str]], list[int]]]:
        """Titles, rows with figures, and core columns of the metrics, the difference and the costs."""
        kinds = ("row", "seeds", "metric"), ("row", "difference"), ("row", "cost")
        return [table for table in (self.part(*each) for each in kinds) if table[1]]

    def without_figures(self) -> dict[str, list[str]]:
        """Names of the rows without a run, by the reason."""
        with_figures = {row[0] for row in self.part("row", "metric")[1]}
        found: dict[str, list[str]] = {}
        for name, status, *_ in self.rows:
            if name not in with_figures:
                found.setdefault(status, []).append(name)
        return found

    def published_elsewhere(self) -> tuple[list[str], list[list[str]]]:
        """Titles and rows of the published figures, where there are any."""
        return self.part("row", "published")[:2]


def read_expected(folder: Path) -> list[dict[str, str]]:
    """Lines of ``expected.csv``: published figures with their sources, and rivals that cannot be run.

    Raises:
        ValueError: another header, or a figure without a source.
    """
    path = folder / "expected.csv"
    if not path.is_file():
        return []
    entries = read_table(path, EXPECTED_HEADER)
    for entry in entries:
        figures = {name: entry[name] for name in PUBLISHED if entry[name]}
        with reading(path, "table of published figures", f"correct the line of {entry['row']}"):
            check_figures(path, {name: float(figure) for name, figure in figures.items()})
        if figures and not (entry["source"] and entry["protocol"]):
            raise ValueError(f"{path}: {entry['row']} has a figure but no protocol or source: give both")
    return entries


@dataclass(frozen=True)
class Member:
    """A row of a block with its runs and published figures."""

    row: StudyRow  # of the plan
    expected: Mapping[str, str]  # its line of expected.csv; empty if it has none
    grouped: Row | None = None  # its finished runs; None: there are none
    planned: bool = True  # False for a rival that has that line only
    outdated: str | None = None  # why its stored runs are not shown

    @property
    def runs(self) -> Sequence[Mapping[str, Any]]:
        """One per finished seed."""
        return self.grouped.runs if self.grouped else []

    @property
    def status(self) -> str:
        """Number of seeds, or why there is none."""
        if self.outdated:
            return f"outdated: {self.outdated}"
        if self.runs:
            planned = len(self.row.seeds)
            return f"{len(self.runs)} of {planned}" if len(self.runs) < planned else str(planned)
        if self.row.given:
            return self.row.not_given
        return "not run" if self.planned else self.expected["status"] or "not run"

    def text(self, group: str, name: str) -> str:
        """Mean and spread of a metric or cost, "-" without runs."""
        return self.grouped.text(group, name) if self.grouped else "-"

    def published(self, name: str) -> str:
        """A column of ``expected.csv``; without a source its status, such as "not published"."""
        return self.expected.get(name) or (self.expected.get("status") if name == "source" else None) or "-"


def build_blocks(study: Study) -> list[Block]:
    """All tables of a study, in the order of its plan.

    Raises:
        ValueError: runs of one block do not compare (other protocol or frames).
    """
    expected = read_expected(study.folder)
    names = list(dict.fromkeys([row.block for row in study.rows] + [line["block"] for line in expected]))
    return [_block(study, name, [line for line in expected if line["block"] == name]) for name in names]


def _block(study: Study, block: str, expected: Sequence[Mapping[str, str]]) -> Block:
    lines = {line["row"]: line for line in expected}
    members = [_member(study, row, lines.pop(row.name, {})) for row in study.rows if row.block == block]
    for rival, line in lines.items():  # figures of others alone
        members.append(Member(StudyRow(rival, block=block, seen="-"), line, planned=False))
    latencies = Latencies.read(study)
    for member in members:
        if latencies and member.runs:
            latencies.check(member.row, member.runs[0])
    every = [run for member in members for run in member.runs]
    reference = next((m for m in members if m.row.name in study.reference and m.runs), None)
    differences = {} if reference is None else _differences(study, reference, members)
    columns = [
        Column("row", "row", lambda member: member.row.name),
        Column("seeds", "seeds", lambda member: member.status),
        Column(SEEN, "seen", lambda member: member.row.seen),
    ]
    for metric in study.columns:
        title = heading(metric, every[0]) if every else metric
        cell = partial(Member.text, group="metrics", name=metric)
        columns.append(Column(title, "metric", cell, core=metric in CORE))
    if reference is not None:
        shown = {row: difference.text for row, difference in differences.items()}
        title = f"{study.compare} - {reference.row.name}'s [95 %]"
        columns.append(Column(title, "difference", lambda member: shown.get(member.row.name, "-")))
    for cost in COUNTED if every else ():
        columns.append(Column(heading(cost, every[0]), "cost", partial(Member.text, group="cost", name=cost)))
    if latencies:
        title, of = f"{latencies.title} ↓", latencies.of
        columns.append(
            Column(title, "cost", lambda member: number("latency_ms_p50", of(member.row.name)), core=True)
        )
    if any(line[column] for line in expected for column in PUBLISHED):
        for name in (*PUBLISHED, "protocol", "source"):
            columns.append(Column(f"published {name}", "published", partial(Member.published, name=name)))
    rows = [[column.cell(member) for column in columns] for member in members]
    for label, metrics in constant_rows(every, study.columns):
        cells = [label, "-", "depth of the training frames", *metrics]
        rows.append(cells + ["-"] * (len(columns) - len(cells)))
    points = [point for member in members if (point := _point(study, member, latencies))]
    compared = "" if reference is None else reference.row.name
    notes = _notes(study, members, latencies, compared)
    return Block(block, columns, rows, notes, points, differences, compared)


def _member(study: Study, row: StudyRow, expected: Mapping[str, str]) -> Member:
    stored = stored_runs(study, row)
    if not stored.runs:
        return Member(row, expected, outdated=stored.outdated)
    try:
        grouped = group_rows(stored.runs)
        if len(grouped) > 1:
            raise ValueError(f"the stored runs have the names {', '.join(one.model for one in grouped)}")
    except ValueError as error:  # the other rows have their table
        return Member(row, expected, outdated=f"{error}; train all of its seeds again (rerun=true)")
    return Member(row, expected, grouped[0])


def _notes(study: Study, members: Sequence[Member], latencies: Latencies | None, reference: str) -> list[str]:
    """The protocol, the machines and the statistics behind the numbers."""
    runs = [run for member in members for run in member.runs]
    if not runs:
        stored = any(member.outdated for member in members)
        return ["the stored runs are outdated, see above" if stored else "no run is stored yet"]
    refuse_mixtures(runs, costs=False)
    sizes = sorted({(run["cost"]["height"], run["cost"]["width"]) for run in runs})
    inputs = ", ".join(f"{height} x {width}" for height, width in sizes)
    notes = [protocol_line(runs[0]), training_line(runs), f"GMACs at an input of {inputs}; 1 MAC = 2 FLOPs"]
    if latencies:
        notes.append(latencies.line)
    if reference:
        notes.append(
            f"difference in {study.compare} to {reference}: mean over the images, with the 95 % interval "
            f"of a paired bootstrap over scenes ({paired_intervals.DRAWS} draws). Where both rows have "
            f"{SEEDS_OF_A_VERDICT} seeds, it draws seeds and scenes, and "
            '"better" or "worse" means that the interval excludes 0; '
            f"elsewhere it draws {paired_intervals.SCENES_ALONE}, too little for a verdict"
        )
    if study.epoch == "last":
        notes.append("metrics of the last epoch, since the best epoch was chosen on the same frames")
    return notes + _searches(study, members)


def _searches(study: Study, members: Sequence[Member]) -> list[str]:
    """Notes on rows whose search for a learning rate ended at its edge, or does not follow the plan."""
    edges, others = [], []
    for member in members:
        choice = stored_choice(study, member.row) if member.runs else None
        if choice is None:
            continue
        if choice.at_the_edge:
            tried = f"tried: {choice.tried[0]:g} to {choice.tried[-1]:g}"
            edges.append(f"{member.row.name} ({choice.rate:g}; {tried})")
        if different := outdated_search(study, member.row, choice):
            others.append(f"{member.row.name} ({'; '.join(different[:2])})")
    found = {
        "learning rate at the edge of the search, so a better one may lie beyond": edges,
        "learning rate chosen by other trials than sweep.yaml plans; to repeat them, rerun=true": others,
    }
    return [f"{words}: {', '.join(rows)}" for words, rows in found.items() if rows]


def _differences(study: Study, reference: Member, members: Sequence[Member]) -> dict[str, Difference]:
    """Differences to the reference of every other row with runs."""
    found = {}
    for member in members:
        if member is reference or not member.runs:
            continue
        ours, theirs = (_scores(study, one) for one in (member, reference))
        seeds = min(len(member.runs), len(reference.runs)) >= SEEDS_OF_A_VERDICT
        mean, low, high = paired_intervals.paired_interval(ours, theirs, draw_seeds=seeds)
        found[member.row.name] = Difference(mean, low, high, seeds, study.compare in LOWER_IS_BETTER)
    return found


def _scores(study: Study, member: Member) -> paired_intervals.Scores:
    """The compared metric of every image in a row's runs."""
    runs = {run_name(member.row, run["seed"]): run for run in member.runs}
    return paired_intervals.per_image(runs, study.compare)


def _point(study: Study, member: Member, latencies: Latencies | None) -> tuple[str, float, float] | None:
    """Place of a row in the plot: its benchmarked latency or, without one, its multiply-adds."""
    if member.grouped is None:
        return None
    cost = latencies.of(member.row.name) if latencies else float(member.runs[0]["cost"]["gmacs"])
    values = member.grouped.values("metrics", study.compare)
    return (member.row.name, cost, sum(values) / len(values)) if cost and values else None

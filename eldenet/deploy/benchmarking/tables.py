"""Tables, notes and picture that ``python -m eldenet.benchmark`` writes."""

import statistics
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.deploy.benchmarking.rows import COLUMNS, KEY
from eldenet.system.files import part_file, write_rows, write_text

if TYPE_CHECKING:
    from eldenet.results.run_log import RunLog


CORE = ("latency_ms_p50", "fps", "ratio_latency", "params", "gmacs")  # columns that come first
Accuracies = tuple[Mapping[str, float], str]  # by model, and the title of the axis


def write_results(
    rows: Sequence[Mapping[str, Any]], accuracies: Accuracies | None, output: Path, log: "RunLog"
) -> None:
    """Write ``results.csv`` (full figures), ``.md`` and ``.tex`` (rounded) and ``.png``; print the table."""
    from eldenet.results.tables import to_latex, to_markdown

    write_rows(output / "results.csv", COLUMNS, [[row[name] for name in COLUMNS] for row in rows])
    cells = [[text_of(name, row[name]) for name in COLUMNS] for row in rows]
    notes = notes_of(rows)
    write_text(output / "results.md", to_markdown(COLUMNS, cells, notes))
    # a page and a terminal are narrow: the title shows what all rows share
    same = {name for name in KEY[1:] if len({row[name] for row in rows}) == 1}
    shown = [position for position, name in enumerate(COLUMNS) if name not in same]
    title = ", ".join(f"{name} {rows[0][name]}" for name in COLUMNS if name in same)
    titles = [COLUMNS[position] for position in shown]
    core = [place for place, name in enumerate(titles) if name in KEY[1:] or name in CORE]
    lines = [[line[position] for position in shown] for line in cells]
    write_text(output / "results.tex", to_latex(titles, lines, [title, *notes], core))
    log.table(title, titles, lines, core)
    for note in notes:
        log.say(note)
    drawn = draw(rows, accuracies, output / "results.png")
    log.say(f"written to {output}: results.md, .csv, .tex{', .png' if drawn else ''}, rows.jsonl")


def text_of(name: str, value: Any) -> str:
    """A figure as text for a table."""
    if value is None:
        return "-"
    if not isinstance(value, float):
        return f"{value:,}" if name == "params" else str(value)
    if name in ("gmacs", "gflops", "share_of_peak", "ratio_latency"):
        return f"{value:.3f}"
    return f"{value:.1f}" if abs(value) >= 100 else f"{value:.2f}"


def notes_of(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Notes below a table: machine, versions, how it was measured, what other jobs spoiled, what failed."""
    from eldenet.results.tables import BUSY

    notes, compared = [], any(row.get("ratio_latency") is not None for row in rows)
    for row in rows:
        versions = ", ".join(f"{name} {version}" for name, version in row["versions"].items() if version)
        notes.append(f"{row['processor']}, {row['cores']} cores; {versions}")
        notes.append(
            f"latency: median of one call, {row['rounds']} interleaved rounds of {row['seconds']} s for each "
            "row; "
            + f"ratio_latency to {row['reference']}, fp32, in the same rounds; " * compared
            + "1 MAC = 2 FLOPs"
        )
        notes.append(f"made by `{row['command']}`")
    notes.append(
        "fps: calls per second; peak_memory_mb: added to a process by loading and running; share_of_peak: of "
        "the best matrix product's FLOP/s in the same precision and rounds (torch); gmacs and gflops are of "
        "the network as it is defined, gflops_per_s of its inference form (eldenet.deploy.fold)"
    )
    if busy := sum((row.get("waiting") or 1.0) > BUSY for row in rows):
        notes.append(
            f"other jobs used the machine while {busy} of {len(rows)} rows were measured, so their times are "
            "too long: end those jobs and measure again with overwrite=true"
        )
    failed = [
        f"not measured: {row['model']}, {row['runtime']}, {row['precision']}: {row['failed']}"
        for row in rows
        if row["failed"]
    ]
    return list(dict.fromkeys(notes + failed))


def read_accuracies(folders: Sequence[str], metric: str, models: Collection[str]) -> Accuracies | None:
    """Mean accuracy of each model over the seeds of its runs, and the axis' title; None without folders.

    Runs of other models are left out.

    Raises:
        FileNotFoundError: there is no run.
        ValueError: no run is of one of the models, the runs do not compare (other frames, another protocol),
            or runs of one name differ in more than their seed.
    """
    from eldenet.results.report_table import find_runs, group_rows, refuse_mixtures
    from eldenet.results.tables import heading

    if not folders:
        return None
    found = find_runs(list(folders), needed=("cost.height", "cost.width"))
    runs = [run for run in found if str(run["model"]) in models]
    if not runs:
        names = ", ".join(sorted({str(run["model"]) for run in found}))
        raise ValueError(
            f"accuracies={list(folders)}: these runs are of {names}, but the models are {', '.join(models)}: "
            "give runs of the models"
        )
    try:
        refuse_mixtures(runs, costs=False)
        rows = {row.model: row.values("metrics", metric) for row in group_rows(runs)}
        if split := [name for name in rows if name not in models]:  # group_rows names rows of a sweep apart
            raise ValueError(
                f"runs of one model differ in more than their seed ({', '.join(split)}): give only the runs "
                "of the networks that are measured"
            )
    except ValueError as error:
        raise ValueError(f"accuracies={list(folders)}: {error}") from error
    title = f"{heading(metric, runs[0])}, {runs[0]['protocol']['name']}, {runs[0]['data']}/{runs[0]['split']}"
    scored_at = sorted({f"{run['cost']['height']}x{run['cost']['width']}" for run in runs})
    title += f", at {' and '.join(scored_at)}"
    return {model: statistics.fmean(values) for model, values in rows.items() if values}, title


def draw(rows: Sequence[Mapping[str, Any]], accuracies: Accuracies | None, path: Path) -> bool:
    """Draw accuracy (None: parameters) over latency; return whether there was a point to draw."""
    from matplotlib.ticker import LogLocator

    from eldenet.results.plots import name_points, pyplot_for_files

    given = accuracies is not None
    accuracy, title = accuracies or ({}, "")
    shown = [row for row in rows if row["latency_ms_p50"] and (not given or row["model"] in accuracy)]
    if not shown:
        return False
    pyplot = pyplot_for_files()
    figure, axes = pyplot.subplots(figsize=(7, 5), layout="constrained")
    series: dict[str, list[Mapping[str, Any]]] = {}
    for row in shown:
        label = (
            f"{row['runtime']}, {row['precision']}, {row['height']}x{row['width']}, batch {row['batch']}, "
        )
        series.setdefault(f"{label}{row['threads']} threads", []).append(row)
    points: dict[str, list[tuple[float, float]]] = {}  # of each model
    for label, members in series.items():
        latency = [row["latency_ms_p50"] for row in members]
        heights = [accuracy[row["model"]] if given else row["params"] / 1e6 for row in members]
        axes.scatter(latency, heights, label=label, s=24)
        for row, x, y in zip(members, latency, heights, strict=True):
            points.setdefault(row["model"], []).append((x, y))
    axes.margins(x=0.18)
    axes.set(
        xscale="log",
        xlabel=f"latency [ms], {shown[0]['processor']}",
        ylabel=title if given else "parameters [M]",
        yscale="linear" if given else "log",
    )
    for axis in (axes.xaxis, axes.yaxis) if not given else (axes.xaxis,):  # logarithmic
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(LogLocator(subs=(2, 5)))
        axis.set_minor_formatter("{x:g}")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=7, loc="upper left")
    name_points(axes, points)
    with part_file(path) as unfinished:
        figure.savefig(unfinished, dpi=150)
    pyplot.close(figure)
    return True

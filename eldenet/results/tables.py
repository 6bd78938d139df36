"""Format of tables: numbers, titles, notes on the protocol and the machine, Markdown and LaTeX."""

import math
import re
import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from eldenet.evaluation.metric_names import CLASS_METRICS, LOWER_IS_BETTER, UNCERTAINTY_METRICS, UNITS
from eldenet.results.run_record import RUN_FILE
from eldenet.system import escaping
from eldenet.system.files import displayed

if TYPE_CHECKING:
    from eldenet.results.run_log import RunLog

COLUMNS = ("abs_rel", "rmse", "mae", "mse", "delta1", "delta2", "delta3")
CORE = ("abs_rel", "rmse", "delta1")
TIMES = ("latency_ms_p50", "throughput_img_s")
BUSY = 1.5  # by how much times may differ: in two runs, or on the clock and of the processors
MARK = "(busy)"  # beside times that say nothing; LaTeX and CSV leave them out
BUSY_NOTE = f"{MARK}: other jobs used the machine, so measure again (eldenet benchmark); not in LaTeX and CSV"
COSTS = {  # and their headings
    "params": "params ↓",
    "gmacs": "GMACs ↓",
    "gflops": "GFLOPs ↓",
    "latency_ms_p50": "latency [ms] ↓",
    "throughput_img_s": "img/s ↑",
}
WORDS = {
    "abs_rel": "AbsRel",
    "rmse": "RMSE",
    "mae": "MAE",
    "mse": "MSE",
    "silog": "SILog",
    "ssim": "SSIM",
    "ause_abs_rel": "AUSE AbsRel",
    "ause_rmse": "AUSE RMSE",
    "abs_rel_sure80": "AbsRel of sure 80 %",
    "nll": "NLL",
    "scale_error": "error of scale",
} | {f"delta{power}": f"δ{power}" for power in (1, 2, 3)}


# of a LaTeX table in \\small on a page of 345 pt, in digits of 4.6 pt: page, gap beside a column, text
PAGE, GAP, TEXT = 69, 1.3, 15
TEXTS = ("protocol", "source")  # columns whose cells are wrapped
TEXT_COLUMN = r"p{7em}"
_SIGNED = r"[+-]\d+\.\d+"
_INTERVAL = re.compile(rf"({_SIGNED}) \[({_SIGNED}), ({_SIGNED})\] ?(.*)")
_MILLIONS = re.compile(r"\d+\.\d+ M")


def number(name: str, value: float | None) -> str:
    """A value as a table shows it."""
    if value is None:
        return "-"
    if name == "params":
        return f"{value / 1e6:.3f} M"
    if name in ("latency_ms_p50", "latency_ms_p95"):
        return "-" if math.isnan(value) else f"{value:.2f}"  # a file of a fixed batch has none
    if name == "throughput_img_s":
        return f"{value:.0f}"
    return f"{value:.3f}"


def is_busy(name: str, costs: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether the times ``name`` of one network say nothing, because other jobs had the processors.

    They waited while they were timed, or differ by more than ``BUSY`` times.
    """
    if name not in TIMES:
        return False
    values = [cost[name] for cost in costs]
    return max(cost.get("waiting", 1.0) for cost in costs) > BUSY or max(values) > BUSY * min(values)


def cost_text(name: str, costs: Sequence[Mapping[str, Any]]) -> str:
    """The mean cost of one network's runs as a table shows it, with a mark if the machine was busy."""
    shown = number(name, statistics.fmean(cost[name] for cost in costs))
    return f"{shown} {MARK}" if is_busy(name, costs) else shown


def heading(name: str, run: Mapping[str, Any] | None = None) -> str:
    """Column title with unit and direction; where a run scored an inverse depth, it has no unit."""
    if name in COSTS:
        return COSTS[name]
    inverse = run is not None and run["protocol"].get("inverse_scale")
    unit = f" [{UNITS[name].replace('^2', '²')}]" if name in UNITS and not inverse else ""
    if name.startswith("coverage"):  # neither more nor less is better
        return f"in {name.removeprefix('coverage')} %"
    return f"{WORDS.get(name, name)}{unit} {'↓' if name in LOWER_IS_BETTER else '↑'}"


def protocol_line(run: Mapping[str, Any]) -> str:
    """One line on the rules of the metrics."""
    rules = run["protocol"]
    parts = [
        f"protocol {rules['name']}: {rules['ground_truth']} ground truth",
        f"{rules['min_depth']:g} to {rules['max_depth']:g} m",
        _scored_part(rules),
        f"mean per {rules['average']}",
        f"{rules['scale']} scale",
    ]
    if rules["flip"] != "none":
        parts.append("mirror averaged")
    if rules.get("inverse_scale"):
        parts.append(f"scored as inverse depth, {rules['inverse_scale']:g} m / depth")
    return ", ".join(parts) + (
        f"; {run['data']}/{run['split']} {run['split_hash']}, {run['metrics']['images']} images"
    )


def _scored_part(rules: Mapping[str, Any]) -> str:
    """The scored part of the camera's frame: its crops and resizes, then the crop within them."""
    steps = []
    if rules["frame_box"]:
        steps.append(f"cut to {tuple(rules['frame_box'])}")
    if isinstance(rules["resize"], Sequence):
        steps.append(f"resized to {tuple(rules['resize'])}")
    elif rules["resize"]:
        steps.append(f"resized by {rules['resize']:g}")
    place = f"{tuple(rules['frame_crop'] or ())} at the {rules['frame_anchor']}"
    if rules["frame_crop"] and not rules["paste"]:
        steps.append(f"cut to {place}")
    if rules["frame_size"]:
        steps.append(f"resized to {tuple(rules['frame_size'])}")
    if rules["crop"]:
        crop = f"crop {tuple(rules['crop'])}"
    elif rules["crop_fractions"]:
        crop = f"crop {tuple(round(share, 4) for share in rules['crop_fractions'])} of height and width"
    else:
        crop = "all of it scored" if steps else "no crop"
    if rules["paste"]:
        crop += f", scored where predicted: {place}"
    return f"frame {', then '.join(steps)}, {crop}" if steps else crop


def cost_line(run: Mapping[str, Any], *, busy: bool = False) -> str:
    """One line on what the costs were measured on, with ``busy`` that some say nothing."""
    cost = run["cost"]
    return (
        f"costs: {cost['runtime']}, {cost['precision']}, {cost['threads']} threads, {cost['device']} "
        f"({run['hardware']['processor']}), input {cost['height']} x {cost['width']}, latency at batch 1 "
        f"(median), throughput at batch {cost['batch']}; 1 MAC = 2 FLOPs" + (f"; {BUSY_NOTE}" if busy else "")
    )


def training_line(runs: Sequence[Mapping[str, Any]]) -> str:
    """One line on what the runs of a table were trained on."""
    used = set()
    for run in runs:
        machine = run["hardware"].get("accelerator") or run["hardware"]["processor"]
        used.add(f"{run['resources']['precision']} on {machine}, torch {run['versions']['torch']}")
    return f"trained in {'; '.join(sorted(used))}; {min(run['date'] for run in runs)[:10]} and later"


def closing_table(log: "RunLog", run: Mapping[str, Any]) -> None:
    """Print metrics of one run beside the constant predictor's, errors by class, and costs."""
    names = ("model", *(heading(name, run) for name in COLUMNS))
    rows = [
        [label, *(number(name, run[group][name]) for name in COLUMNS)]
        for label, group in ((str(run["model"]), "metrics"), ("constant predictor", "constant_predictor"))
        if run[group] is not None
    ]
    core = [1 + COLUMNS.index(name) for name in CORE]
    log.table(protocol_line(run), names, rows, core)
    if "nll" in run["metrics"]:
        log.table(
            f"sigma, protocol {run['uncertainty_protocol']['name']}: AUSE, AbsRel without the least certain "
            "fifth of each image, coverage of intervals, likelihood of ln depth",
            [heading(name, run) for name in UNCERTAINTY_METRICS],
            [[number(name, run["metrics"][name]) for name in UNCERTAINTY_METRICS]],
        )
    classes = run.get("errors_by_class") or {}
    if classes:
        rows = [
            [name, *(number(metric, errors[metric]) for metric in CLASS_METRICS), f"{errors['pixels']:,}"]
            for name, errors in classes.items()
        ]
        columns = ["class", *(heading(metric, run) for metric in CLASS_METRICS), "pixels"]
        log.table("errors by class, all of its pixels pooled", columns, rows)
    log.table(
        cost_line(run, busy=any(is_busy(name, [run["cost"]]) for name in TIMES)),
        [heading(name, run) for name in COSTS],
        [[cost_text(name, [run["cost"]]) for name in COSTS]],
    )
    weights = ", model/ ..." if (log.folder / "model").is_dir() else ""  # an evaluation writes none
    log.say(f"written to {displayed(log.folder)}: {RUN_FILE}, per_image.csv, predictions.png{weights}")


def to_markdown(titles: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    """A Markdown table with notes below."""

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(map(escaping.markdown, cells))} |"

    lines = [line(titles), f"|---|{'---:|' * (len(titles) - 1)}", *map(line, rows)]
    return "\n".join([*lines, "", *(f"- {escaping.markdown_note(note)}" for note in notes), ""])


def to_latex(
    titles: Sequence[str],
    rows: Sequence[Sequence[str]],
    notes: Sequence[str],
    core: Sequence[int] | None = None,
) -> str:
    """A LaTeX table (booktabs) with the notes as comments.

    ``core`` are the numbers of the columns that come first where the page has no room for all; a comment
    names the others. None: all columns, also beyond the page.
    """

    def line(cells: Sequence[str]) -> str:
        return " & ".join(escaping.latex(cells[place]) for place in kept) + r" \\"

    widths = [max(map(len, cells)) for cells in zip(titles, *rows, strict=True)]
    wrapped = [place > 0 and (title in TEXTS or widths[place] > 38) for place, title in enumerate(titles)]
    widths = [TEXT if wrap else width for width, wrap in zip(widths, wrapped, strict=True)]
    size, kept = r"\small", list(range(len(titles)))
    page: float = PAGE
    if core is not None:
        kept = sorted([0, *(core or [1])])  # a table of names alone says nothing
        if sum(widths[place] + GAP for place in kept) > page:
            size, page = r"\footnotesize", PAGE * 9 / 8
        for place in range(1, len(titles)):
            if place not in kept and sum(widths[other] + GAP for other in [*kept, place]) <= page:
                kept = sorted([*kept, place])
    kinds = "".join("l" if place == 0 else TEXT_COLUMN if wrapped[place] else "r" for place in kept)
    body = [r"\toprule", line(titles), r"\midrule", *(line(row) for row in rows), r"\bottomrule"]
    head = [f"% {escaping.one_line(note)}" for note in notes]
    if left_out := [title for place, title in enumerate(titles) if place not in kept]:
        head.append(f"% not in this table, which fits a page: {escaping.one_line(', '.join(left_out))}")
    head.append("{" + size + r"\setlength{\tabcolsep}{3pt}\begin{tabular}{" + kinds + "}")
    return "\n".join([*head, *body, r"\end{tabular}}", ""])


def to_csv(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """Titles and cells of one figure each: mean, std and ends of intervals have separate columns."""
    columns: list[list[str]] = []
    for title, *cells in zip(titles, *rows, strict=True):
        if any(" ± " in cell for cell in cells):
            parts = [cell.partition(" ± ") for cell in cells]
            columns.append([title, *(part[0] for part in parts)])
            columns.append([f"{title.split()[0]} std", *(part[2] for part in parts)])
        elif any(map(_INTERVAL.fullmatch, cells)):
            found = [_INTERVAL.fullmatch(cell) for cell in cells]
            for number, name in enumerate((title, "low", "high", "verdict"), 1):
                columns.append([name, *("" if match is None else match[number] for match in found)])
        elif any(_MILLIONS.fullmatch(cell) for cell in cells):
            columns.append(
                [title.replace("params", "params [M]"), *(cell.removesuffix(" M") for cell in cells)]
            )
        else:
            columns.append([title, *cells])
    header, *lines = ([column[place] for column in columns] for place in range(len(rows) + 1))
    return header, lines

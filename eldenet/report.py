"""``python -m eldenet.report``: ``run.json`` files -> tables that never mix what does not compare."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.metrics import CLASS_METRICS, LOWER_IS_BETTER, METRICS, UNITS, EvalProtocol
from eldenet.record import RUN_FILE, differences, read_run

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.runlog import RunLog

COLUMNS = ("abs_rel", "rmse", "mae", "mse", "delta1", "delta2", "delta3")
COSTS = ("params", "gmacs", "gflops", "latency_ms_p50", "throughput_img_s")
# a metrics column may hold one of each only; so may a cost column
SAME_FOR_METRICS = ("data", "split", "split_hash", "protocol")
# runs that share a row differ in their seed, and in nothing that shapes a training
SAME_IN_A_ROW = ("model", "loss", "optimizer", "scheduler", "augmentation", "trainer")
SAME_FOR_COSTS = ("runtime", "precision", "threads", "device", "height", "width", "batch", "processor")
WORDS = {
    "abs_rel": "AbsRel",
    "rmse": "RMSE",
    "mae": "MAE",
    "mse": "MSE",
    "silog": "SILog",
    "ssim": "SSIM",
} | {f"delta{power}": f"δ{power}" for power in (1, 2, 3)}


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


def number(name: str, value: float | None) -> str:
    """A value as a table shows it."""
    if value is None:
        return "-"
    if name == "params":
        return f"{value / 1e6:.3f} M"
    if name in ("latency_ms_p50", "latency_ms_p95"):
        return f"{value:.2f}"
    if name == "throughput_img_s":
        return f"{value:.0f}"
    return f"{value:.3f}"


def heading(name: str, run: Mapping[str, Any]) -> str:
    """Column title with unit and direction; an inverse depth has no unit."""
    costs = {
        "params": "params ↓",
        "gmacs": "GMACs ↓",
        "gflops": "GFLOPs ↓",
        "latency_ms_p50": "latency [ms] ↓",
        "throughput_img_s": "img/s ↑",
    }
    if name in costs:
        return costs[name]
    unit = f" [{UNITS[name].replace('^2', '²')}]" if name in UNITS else ""
    unit = "" if run["protocol"].get("inverse_scale") else unit
    return f"{WORDS.get(name, name)}{unit} {'↓' if name in LOWER_IS_BETTER else '↑'}"


def protocol_line(run: Mapping[str, Any]) -> str:
    """One line that says under which rules the metrics were made."""
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
    """What of the frame is scored."""
    if rules["crop"]:
        words = f"crop {tuple(rules['crop'])}"
    elif rules["crop_fractions"]:
        words = f"crop {tuple(round(share, 4) for share in rules['crop_fractions'])} of height and width"
    else:
        words = "no crop"
    if rules["paste"]:
        words += f", predicted from {rules['frame_anchor']} {tuple(rules['frame_crop'])}"
    return words


def cost_line(run: Mapping[str, Any]) -> str:
    """One line that says what the costs were measured on."""
    cost = run["cost"]
    return (
        f"costs: {cost['runtime']}, {cost['precision']}, {cost['threads']} threads, {cost['device']} "
        f"({run['hardware']['processor']}), input {cost['height']} x {cost['width']}, latency at batch 1 "
        f"(median), throughput at batch {cost['batch']}; 1 MAC = 2 FLOPs"
    )


def closing_table(log: "RunLog", run: Mapping[str, Any]) -> None:
    """Print what one run reached, beside the constant predictor, and what it costs."""
    names = ("model", *(heading(name, run) for name in COLUMNS))
    rows = [
        [label, *(number(name, run[group][name]) for name in COLUMNS)]
        for label, group in ((str(run["model"]), "metrics"), ("constant predictor", "constant_predictor"))
        if run[group] is not None
    ]
    log.table(protocol_line(run), names, rows)
    classes = run.get("errors_by_class") or {}
    if classes:
        rows = [
            [name, *(number(metric, errors[metric]) for metric in CLASS_METRICS), f"{errors['pixels']:,}"]
            for name, errors in classes.items()
        ]
        columns = ["class", *(heading(metric, run) for metric in CLASS_METRICS), "pixels"]
        log.table("errors by class, all of its pixels pooled", columns, rows)
    log.table(
        cost_line(run),
        [heading(name, run) for name in COSTS],
        [[number(name, run["cost"][name]) for name in COSTS]],
    )
    log.say(f"written to {log.folder}: {RUN_FILE}, per_image.csv, predictions.png, model/ ...")


# ------------------------------------------------------------------ many runs


def find_runs(sources: Sequence[str]) -> list[dict[str, Any]]:
    """All ``run.json`` below the given files and folders.

    Raises:
        FileNotFoundError: a source does not exist, or there is no run anywhere.
    """
    files: list[Path] = []
    for source in map(Path, sources):
        if not source.exists():
            raise FileNotFoundError(f"no such file or folder: {source}")
        files += [source] if source.is_file() else sorted(source.rglob(RUN_FILE))
    runs = [read_run(file) for file in dict.fromkeys(file.resolve() for file in files)]
    if not runs:
        raise FileNotFoundError(f"no {RUN_FILE} below {', '.join(map(str, sources))}: has a run finished?")
    # a rule that did not exist yet was not applied: runs of before and after compare
    rules = EvalProtocol("").as_dict()
    return [run | {"protocol": rules | run["protocol"]} for run in runs]


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
            different = [text for other in settings for text in differences(settings[0], other, section)]
            if different:
                raise ValueError(
                    f"{len(members)} runs are called {model!r}, but {section} differs in their config: seeds "
                    f"share a row, other settings do not ({different[0]}). Give them names of their own "
                    "(model_name=...)"
                )
    return [Row(model, members) for model, members in rows.items()]


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
    constant = next((run["constant_predictor"] for run in runs if run["constant_predictor"]), None)
    if constant is not None:
        shown = [number(name, constant.get(name)) for name in columns]
        rows.append(["constant predictor", "-", *shown, *("-" for _ in wanted[len(columns) :])])
    return titles, rows


def to_markdown(titles: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    """A Markdown table with the notes that make it believable below."""

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

    lines = [line(titles), f"|---|{'---:|' * (len(titles) - 1)}", *map(line, rows)]
    return "\n".join([*lines, "", *(f"- {note}" for note in notes), ""])


def to_latex(titles: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    """A booktabs table."""
    swaps: dict[str, str | int | None] = {
        **{sign: f"\\{sign}" for sign in "_&%#${}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "δ": r"$\delta$",
        "±": r"$\pm$",
        "↓": r"$\downarrow$",
        "↑": r"$\uparrow$",
        "²": "$^2$",
    }

    def line(cells: Sequence[str]) -> str:
        return " & ".join(cell.translate(str.maketrans(swaps)) for cell in cells) + r" \\"

    body = [r"\toprule", line(titles), r"\midrule", *(line(row) for row in rows), r"\bottomrule"]
    head = [f"% {note}" for note in notes] + [r"\begin{tabular}{l" + "r" * (len(titles) - 1) + "}"]
    return "\n".join([*head, *body, r"\end{tabular}", ""])


@cfg.entry_point("report")
def main(config: "DictConfig", folder: Path) -> None:
    """Read runs, refuse mixtures, print the table and write it as Markdown, CSV and LaTeX."""
    from eldenet.record import write_rows
    from eldenet.runlog import RunLog

    if config.study is not None:
        from eldenet.studies.tables import write_study_report

        log = RunLog(Path(config.study))
        for block in write_study_report(config.study):
            log.table(block.name, *block.measured_here())
        log.say(f"written to {Path(config.study) / 'results'}.md, .csv and .tex")
        return
    runs = find_runs(cfg.plain(config.runs))
    titles, rows = table_of(runs, cfg.plain(config.columns), costs=config.costs)
    notes = [protocol_line(runs[0])] + ([cost_line(runs[0])] if config.costs else [])
    output = Path(config.output)
    stem = output.stem if output.suffix in (".md", ".csv", ".tex") else output.name  # "v0.5" has no ending
    output.parent.mkdir(parents=True, exist_ok=True)
    output.with_name(f"{stem}.md").write_text(to_markdown(titles, rows, notes))
    output.with_name(f"{stem}.tex").write_text(to_latex(titles, rows, notes))
    write_rows(output.with_name(f"{stem}.csv"), titles, rows)
    log = RunLog(output.parent)
    log.table(notes[0], titles, rows)
    log.say(f"written to {output.with_name(stem)}.md, .csv and .tex")


if __name__ == "__main__":
    main()

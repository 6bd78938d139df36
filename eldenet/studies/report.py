"""The report of a study from its stored runs: ``results.md``, ``.csv``, ``.tex`` and plots."""

from collections.abc import Sequence
from pathlib import Path

from eldenet.evaluation.metric_names import LOWER_IS_BETTER
from eldenet.results.plots import differences_plot, pareto_plot
from eldenet.results.run_log import RunLog
from eldenet.results.tables import WORDS, to_csv, to_latex, to_markdown
from eldenet.studies.latency import Latencies
from eldenet.studies.plan import Study, read_study
from eldenet.studies.tables import Block, build_blocks
from eldenet.system import escaping
from eldenet.system.extras import require
from eldenet.system.files import write_rows, write_text

Cells = tuple[list[str], list[list[str]]]  # titles, rows


def report_study(folder: Path) -> None:
    """Write the report of a study and print its tables."""
    log = RunLog(folder)
    for block in write_study_report(folder):
        for number, (titles, rows, core) in enumerate(block.apart()):
            log.table("" if number else block.name, titles, rows, core)
        for reason, names in block.without_figures().items():
            log.say(f"{reason}: {', '.join(names)}")
        log.say("")
    log.say(f"written to {folder / 'results'}.md, .csv and .tex")


def write_study_report(folder: str | Path) -> list[Block]:
    """Write ``results.md``, ``.csv``, ``.tex`` and the plots of a study from what is stored in its folder."""
    study = read_study(folder)
    if study.plots:
        require("the report of a study", "matplotlib")
    blocks = build_blocks(study)
    tables = [table for block in blocks for table in _tables_of(block)]
    markdown = [f"# {escaping.markdown(study.name)}", ""]
    markdown += [
        f"{level} {escaping.markdown(name)}\n\n{to_markdown(*cells, notes)}"
        for level, name, cells, notes in tables
    ]
    latex = [table for block in blocks for table in _latex_of(block)]
    points = {block.name: block.points for block in blocks if block.points}
    if "pareto" in study.plots and points:
        latencies = Latencies.read(study)
        pareto_plot(
            study.folder / "pareto.png",
            points,
            metric=WORDS.get(study.compare, study.compare),
            cost=latencies.title if latencies else "GMACs",
            lower_is_better=study.compare in LOWER_IS_BETTER,
        )
        markdown += ["![accuracy against cost](pareto.png)", ""]
    differences = {block.name: block.differences for block in blocks if block.differences}
    if "differences" in study.plots and differences:
        differences_plot(
            study.folder / "differences.png",
            differences,
            metric=WORDS.get(study.compare, study.compare),
            references={block.name: block.reference for block in blocks},
        )
        markdown += ["![differences to the reference row, with 95 % intervals](differences.png)", ""]
    place = study.folder.as_posix() if study.folder.name not in ("", "..") else study.name
    markdown += [escaping.markdown_note(f"Made by `python -m eldenet.report study={place}`."), ""]
    write_text(study.folder / "results.md", "\n".join(markdown))
    write_text(study.folder / "results.tex", "\n".join(latex))
    _write_csv(study, blocks)
    return blocks


def _tables_of(block: Block) -> list[tuple[str, str, Cells, list[str]]]:
    """Heading level, name, cells and notes of a block's tables."""
    tables = [("##", block.name, block.measured_here(), block.notes)]
    titles, rows = block.published_elsewhere()
    if rows:
        notes = [
            "published with other data, input sizes and initial weights: not comparable with the table above"
        ]
        tables.append(("###", f"{block.name}: published elsewhere", (titles, rows), notes))
    return tables


def _latex_of(block: Block) -> list[str]:
    """Tables of a block that fit a page: metrics, differences, costs and published figures apart."""
    left_out = [f"{reason}: {', '.join(names)}" for reason, names in block.without_figures().items()]
    tables: list[str] = []
    for titles, rows, core in block.apart():
        tables.append(to_latex(titles, rows, [] if tables else [block.name, *block.notes, *left_out], core))
    titles, rows = block.published_elsewhere()
    if rows:
        short = [title.removeprefix("published ") for title in titles]
        tables.append(to_latex(short, rows, [f"{block.name}: published elsewhere"]))
    return tables


def _write_csv(study: Study, blocks: Sequence[Block]) -> None:
    """All blocks in one file, published figures included: a column for every title that any of them has."""
    titles = list(dict.fromkeys(title for block in blocks for title in block.titles))
    cells = [
        (block.name, dict(zip(block.titles, row, strict=True))) for block in blocks for row in block.rows
    ]
    table = [[name, *(row.get(title, "") for title in titles)] for name, row in cells]
    write_rows(study.folder / "results.csv", *to_csv(["block", *titles], table))

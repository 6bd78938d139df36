"""``python -m eldenet.report``: ``run.json`` files -> tables that never mix what does not compare."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point, refuse_unread

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("report")
def main(config: "DictConfig", folder: Path) -> None:
    """Read runs, refuse mixtures, print the table and write it as Markdown, CSV and LaTeX."""
    from eldenet.results.comparison import find_runs, table_of
    from eldenet.results.run_log import RunLog
    from eldenet.results.tables import cost_line, protocol_line, to_latex, to_markdown
    from eldenet.system.files import write_rows

    if config.study is not None:
        refuse_unread(
            ("runs", "columns", "costs", "output"),
            "not read with study=, whose sweep.yaml says what its tables show",
        )
        from eldenet.results.studies.report import write_study_report

        log = RunLog(Path(config.study))
        for block in write_study_report(config.study):
            log.table(block.name, *block.on_a_screen())
        log.say(f"written to {Path(config.study) / 'results'}.md, .csv and .tex")
        return
    runs = find_runs(cfg.listed(config.runs))
    titles, rows = table_of(runs, cfg.listed(config.columns), costs=config.costs)
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

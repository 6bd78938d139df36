"""``python -m eldenet.report``: ``run.json`` files -> tables that never mix what does not compare."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point, refuse_unread

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("report")
def main(config: "DictConfig", folder: Path) -> None:
    """Print the table of some runs, or the tables of a study, and write them as Markdown, CSV and LaTeX."""
    from eldenet.results.comparison import report_runs
    from eldenet.results.studies.report import report_study

    setup = cfg.build_report(config)
    if setup.study is not None:
        refuse_unread(
            ("runs", "names", "columns", "costs", "output"),
            "not read with study=, whose sweep.yaml says what its tables show",
        )
        report_study(setup.study, cfg.training_composition())
    else:
        report_runs(setup)


if __name__ == "__main__":
    main()

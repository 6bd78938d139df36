"""``python -m eldenet.report``: ``run.json`` files -> tables that never mix what does not compare.

python -m eldenet.report 'runs=[runs]' output=table
python -m eldenet.report 'runs=[runs/a,runs/b]' 'names=[baseline,ours]' 'columns=[abs_rel,rmse,delta1]'
python -m eldenet.report study=experiments/table3_rivals     the tables of a study from its stored runs
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.compose import listed


@dataclass(frozen=True)
class ReportSettings:
    """What ``python -m eldenet.report`` reads."""

    study: str | None = None  # folder of a study, whose sweep.yaml sets everything below
    runs: Any = None  # run.json files, or folders with such files (required without study)
    # names of the rows, one for each of runs; []: the names of their networks, with the settings that differ
    names: Any = field(default_factory=list)
    # metrics: some of abs_rel, rmse, mae, mse, delta1, delta2, delta3, log10, silog, ssim; null: the first
    # seven, and in LaTeX those that fit on a page
    columns: Any = None
    costs: bool = True  # false: only metrics, for runs measured on different machines
    output: str = "runs/report"  # name of the files, which the next report overwrites: .md, .csv, .tex


def report(s: ReportSettings) -> None:
    """Print the table of some runs, or the tables of a study, and write them as Markdown, CSV and LaTeX.

    Raises:
        ValueError: the runs do not compare, or there are none.
    """
    if s.study is not None:
        from eldenet.studies.report import report_study

        return report_study(Path(s.study))
    if s.runs is None:
        raise ValueError("give runs=... on the command line")
    from eldenet.results.report_table import report_runs

    report_runs(
        listed(s.runs),
        Path(s.output),
        columns=None if s.columns is None else listed(s.columns),
        costs=s.costs,
        names=[str(name) for name in listed(s.names)],
    )


@entry_point(ReportSettings)
def main(s: ReportSettings) -> None:
    """Refuse what a study's plan sets, then report."""
    if s.study is not None:
        refuse_unread(
            ("runs", "names", "columns", "costs", "output"),
            "not read with study=, whose sweep.yaml says what its tables show",
        )
    report(s)


if __name__ == "__main__":
    main()

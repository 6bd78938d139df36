"""A study of a few seconds: its plan, how it is run, and how its table is read."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

from eldenet.studies.plan import Study, read_study
from eldenet.studies.runner import Outcome, run_row

TINY = """
overrides:
  - data=rooms
  - "data.root='{cache}'"
  - "data.size=[32,40]"
  - "data.input_size=[32,40]"
  - "data.frames={{train: 16, val: 4, test: 6}}"
  - trainer.epochs=1
  - trainer.batch_size=4
  - runtime.threads=1
  - runtime.workers=0
learning_rates: [1.0e-4, 1.0e-3]
rate_overrides:
  - data.test.split=train
  - data.test.frames=16
  - "data.subset={{train: [0, 12], test: [12, 16]}}"
  - data.subset_seed=0
reference: [eldenet_s]
columns: [rmse, delta1]
plots: [pareto]
rows:
  eldenet_s: {{overrides: [model=eldenet_s], seeds: [0, 1]}}
  wrong: {{overrides: [model=eldenet_s, trainer.monitor=accuracy], learning_rate: 1.0e-3}}
  eldenet: {{overrides: [model=eldenet], learning_rate: 1.0e-3}}
  elsewhere: {{overrides: [data=kitti], given: {{kitti: data.root}}}}
  pretrained: {{block: rooms, given: {{rooms: weights}}}}
"""
EXPECTED = """row,block,status,abs_rel,rmse,delta1,protocol,source
eldenet,scratch,,,0.5,0.9,"NYU, 654 images",a paper
unknown,scratch,no code identified,,,,,
"""


def write_tiny_study(folder: Path, cache: str) -> Path:
    folder.mkdir()
    (folder / "sweep.yaml").write_text(TINY.format(cache=cache))
    (folder / "expected.csv").write_text(EXPECTED)
    return folder


def short(plan: str) -> str:
    """One seed, no trials."""
    return plan.replace("[0, 1]", "[0]").replace("learning_rates: [1.0e-4, 1.0e-3]\n", "")


def cells(folder: Path) -> dict[str, dict[str, str]]:
    """Rows of results.csv by block and name, as title -> cell."""
    with (folder / "results.csv").open(newline="") as lines:
        return {f"{line['block']}/{line['row']}": line for line in csv.DictReader(lines)}


def run(
    study: Study, name: str, runs: Path, say: Callable[[str], None] = lambda text: None, **options: Any
) -> list[Outcome]:
    """Run one row."""
    (row,) = study.chosen(name)
    return run_row(study, row, runs, say=say, **options)


def run_all(folder: Path, runs: Path) -> tuple[dict[str, str], list[str]]:
    """Statuses of all runs, and what was printed."""
    study, said = read_study(folder), []
    outcomes = [outcome for row in study.rows for outcome in run(study, row.name, runs, said.append)]
    return {outcome.run: outcome.status for outcome in outcomes}, said

"""What is stored in experiments/ and what its pages tell a reader to type name the rows of today."""

import re
from pathlib import Path

import pytest
import yaml

from eldenet.results.packed_runs import RUNS, read_records

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
PLANS = sorted(EXPERIMENTS.glob("*/sweep.yaml"))
ROWS = re.compile(r"\brows?=\[?([\w,]+)")
TYPED = re.compile(r"study=experiments/(\w+)[^`\n]*?\brows?='?\[?([\w,]+)")


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.parent.name)
def test_stored_commands_train_the_row_they_lie_in(plan: Path) -> None:
    rows = yaml.safe_load(plan.read_text())["rows"]
    for name, record in read_records(plan.parent / RUNS).items():
        row, kind = name.split("/")
        assert row in rows, name
        if kind.startswith("seed") and (named := ROWS.search(record["command"])):
            assert row in named[1].split(","), f"{name}: {record['command']}"


def test_commands_on_pages_name_rows_that_exist() -> None:
    root, seen = EXPERIMENTS.parent, 0
    for page in [
        *root.glob("experiments/*.md"),
        *root.glob("experiments/*/README.md"),
        *root.glob("docs/*.md"),
    ]:
        for study, named in TYPED.findall(page.read_text()):
            rows = yaml.safe_load((EXPERIMENTS / study / "sweep.yaml").read_text())["rows"]
            assert set(named.split(",")) <= set(rows), f"{page}: {named}"
            seen += 1
    assert seen > 5

"""What is stored in experiments/ and what its pages tell a reader to type name the rows of today."""

import json
import re
from pathlib import Path

import pytest
import yaml

EXPERIMENTS = Path(__file__).resolve().parents[3] / "experiments"
PLANS = sorted(EXPERIMENTS.glob("*/sweep.yaml"))
ROWS = re.compile(r"\brows?=\[?([\w,]+)")
TYPED = re.compile(r"study=experiments/(\w+)[^`\n]*?\brows?='?\[?([\w,]+)")


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.parent.name)
def test_stored_commands_train_the_row_they_lie_in(plan: Path) -> None:
    rows = yaml.safe_load(plan.read_text())["rows"]
    for file in sorted(plan.parent.glob("stored/*/seed*/run.json")):
        row, command = file.parts[-3], json.loads(file.read_text())["command"]
        assert row in rows, file
        if named := ROWS.search(command):
            assert row in named[1].split(","), f"{file}: {command}"


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

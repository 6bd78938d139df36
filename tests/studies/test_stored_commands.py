"""What is stored in experiments/ and what its pages tell a reader to type name the rows of today."""

import ast
import importlib
import pkgutil
import re
from pathlib import Path
from types import ModuleType

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


def test_scripts_import_names_that_exist() -> None:
    scripts = {path: ast.parse(path.read_text()) for path in EXPERIMENTS.rglob("*.py")}
    seen = 0
    for path, tree in scripts.items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.ImportFrom) or node.module is None:
                continue
            names = {alias.name for alias in node.names}
            if node.module.partition(".")[0] == "eldenet":
                module = importlib.import_module(node.module)
                there = names & (set(dir(module)) | _submodules(module))
            elif beside := [other for other in scripts if other.stem == node.module]:
                there = names & set().union(*(_names_of(scripts[other]) for other in beside))
            else:
                continue
            seen += 1
            assert there == names, f"{path}: {node.module} has no {', '.join(sorted(names - there))}"
    assert seen > 100


def _submodules(package: ModuleType) -> set[str]:
    return {module.name for module in pkgutil.iter_modules(getattr(package, "__path__", []))}


def _names_of(tree: ast.Module) -> set[str]:
    """The names that a script defines or imports."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            found |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found

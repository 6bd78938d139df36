"""The modules of experiments/table5_success, and options of its command: what their tests share."""

import importlib
import sys
from argparse import Namespace
from pathlib import Path

MODULES = ("rows", "command", "methods", "panels", "inputs", "comparisons", "run", "trajectories")
FOLDER = Path(__file__).parents[2] / "experiments" / "table5_success"


def modules_of_table5(monkeypatch):
    """Imports its modules by their names; other studies have some of the same name."""
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in MODULES:
        sys.modules.pop(name, None)
    yield importlib.import_module
    for name in MODULES:
        sys.modules.pop(name, None)


def given(tmp_path: Path, **options) -> Namespace:
    settings = {
        "worlds": 2, "seeds": 1, "methods": "straight", "sensors": "ranges", "physics": "kinematic",
        "courses": "5,20+10", "depth": None, "detector": None, "errors": "packaged",
        "goal": "known", "out": None, "runs": tmp_path / "runs",
        "rows": tmp_path / "rows",
    }  # fmt: skip
    return Namespace(**(settings | options))

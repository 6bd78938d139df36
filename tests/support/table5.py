"""The modules of experiments/table5_success, and options of its command: what their tests share."""

from argparse import Namespace
from pathlib import Path

MODULES = ("rows", "command", "methods", "inputs", "comparisons", "episodes", "run", "trajectories")
FOLDER = Path(__file__).parents[2] / "experiments" / "table5_success"


def given(tmp_path: Path, **options) -> Namespace:
    settings = {
        "worlds": 2, "seeds": 1, "methods": "straight", "sensors": "ranges", "physics": "kinematic",
        "courses": "5,20+10", "depth": None, "detector": None, "errors": "packaged",
        "goal": "known", "out": None, "runs": tmp_path / "runs",
        "rows": tmp_path / "rows", "stored": False,
    }  # fmt: skip
    return Namespace(**(settings | options))

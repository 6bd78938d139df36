"""Scripts of ``experiments/`` as modules, for the tests of what they compute."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def load_scripts(folder: str, *names: str) -> list[ModuleType]:
    """Import modules of ``experiments/<folder>``; other folders may have modules of the same names."""
    here = EXPERIMENTS / folder
    own = {path.stem for path in here.glob("*.py")}
    hidden = {name: sys.modules.pop(name) for name in own & sys.modules.keys()}
    sys.path.insert(0, str(here))
    try:
        return [importlib.import_module(name) for name in names]
    finally:
        sys.path.remove(str(here))
        for name in own:
            sys.modules.pop(name, None)
        sys.modules.update(hidden)

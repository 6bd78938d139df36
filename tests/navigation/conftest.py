"""The modules of experiments/table5_success, for the tests of its commands."""

import importlib
import sys

import pytest
from support.table5 import FOLDER, MODULES


@pytest.fixture
def study(monkeypatch):
    """Import a module of the study by its name; other studies have modules of the same names."""
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in MODULES:
        sys.modules.pop(name, None)
    yield importlib.import_module
    for name in MODULES:
        sys.modules.pop(name, None)

"""The quickstart notebook runs from top to bottom, and what is stored of it is small."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from support.composing import composed

REPOSITORY = Path(__file__).resolve().parents[1]
NOTEBOOK = REPOSITORY / "docs" / "notebooks" / "quickstart.ipynb"
MOST_KB = 250
CELLS = json.loads(NOTEBOOK.read_text())["cells"]
SHELL = [
    "".join(cell["source"]).replace("\\\n", " ")
    for cell in CELLS
    if cell["cell_type"] == "code" and "".join(cell["source"]).startswith("%%bash")
]


def test_what_is_stored_is_small_and_clean():
    assert NOTEBOOK.stat().st_size < MOST_KB * 1024
    printed = [output for cell in CELLS for output in cell.get("outputs", [])]
    assert {output["output_type"] for output in printed} <= {"stream", "display_data", "execute_result"}
    assert any("image/jpeg" in output.get("data", {}) for output in printed)
    assert "\\u001b" not in NOTEBOOK.read_text()
    assert "/tmp" not in NOTEBOOK.read_text()


@pytest.mark.parametrize("text", SHELL, ids=lambda text: text.split()[3])
def test_its_commands_have_settings_that_exist(text):
    for command, words in re.findall(r"python -m eldenet\.(\w+) (.*)", text):
        assert composed(command, shlex.split(words)) is not None


@pytest.mark.docs
@pytest.mark.timeout(1800)
def test_it_runs():
    pytest.importorskip("nbmake")
    pytest.importorskip("onnxruntime")
    words = ["-m", "pytest", "-q", "--nbmake", "--timeout=1700", "-p", "no:cacheprovider", str(NOTEBOOK)]
    done = subprocess.run([sys.executable, *words], cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:]

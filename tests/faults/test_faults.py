"""No damaged or hostile file ends in a traceback, a crash or a hang; none under a checksum passes unseen."""

import json
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_short_campaign(tmp_path: Path, command_server) -> None:
    pytest.importorskip("h5py")
    pytest.importorskip("OpenEXR")
    words = ["--quick", "--output", str(tmp_path / "results.json")]
    done = command_server.run("tests.faults", words, REPOSITORY)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = json.loads((tmp_path / "results.json").read_text())
    assert len(rows) > 60
    assert not any(row["wrong"] for row in rows)


def test_the_page_shows_the_stored_results() -> None:
    if not (REPOSITORY / "tests/faults/results.json").exists():
        pytest.skip("python -m tests.faults has not been run whole yet")
    sums = [0, 0]
    for row in json.loads((REPOSITORY / "tests/faults/results.json").read_text()):
        sums[row["part"] == "file"] += sum(row["counts"].values())
    page = (REPOSITORY / "docs/reliability.md").read_text()
    begin = page.index("| attack |")
    table = page[begin : page.index("\n\n", begin)]
    numbers = [int(line.split("|")[2]) for line in table.splitlines()[2:]]
    assert sum(numbers) == sum(sums)
    assert sums[True] >= 500

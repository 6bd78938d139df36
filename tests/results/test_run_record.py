"""``run.json`` states where it was written."""

from pathlib import Path

import pytest

from eldenet.results import run_record
from eldenet.results.run_record import processor_name


def test_a_processor_without_a_name_has_that_of_its_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("CPU_INFO", "BOARD"):
        monkeypatch.setattr(run_record, name, tmp_path / name)
    (tmp_path / "CPU_INFO").write_text("processor\t: 0\nCPU part\t: 0xd08\n")
    (tmp_path / "BOARD").write_bytes(b"Raspberry Pi 4 Model B Rev 1.4\0")
    assert processor_name() == "Raspberry Pi 4 Model B Rev 1.4"
    (tmp_path / "CPU_INFO").write_text("model name\t: AMD EPYC 7B13\n")
    assert processor_name() == "AMD EPYC 7B13"

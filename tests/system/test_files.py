"""Files appear whole, under safe names; a full disk and a closed folder say so in one line."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from eldenet.system.disk import DiskError, disk_errors, is_full
from eldenet.system.files import part_file, part_path, safe_stem, write_text


def test_an_error_while_writing_leaves_the_old_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.txt"
    write_text(path, "old")

    def fail() -> None:
        with part_file(path) as unfinished:
            unfinished.write_text("half")
            raise RuntimeError("odd")

    with pytest.raises(RuntimeError, match="odd"):
        fail()
    assert [file.name for file in path.parent.iterdir()] == ["a.txt"]
    assert path.read_text() == "old"


def test_what_a_killed_process_left_is_removed_by_the_next(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from eldenet.system.files import part_file\n"
        f"with part_file(Path({str(tmp_path / 'a.bin')!r})) as unfinished:\n"
        "    unfinished.write_bytes(b'half'); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code], check=False, timeout=60)
    (left,) = tmp_path.iterdir()
    mine = part_path(tmp_path / "video.mp4")
    mine.touch()  # of a process that lives
    write_text(tmp_path / "b.txt", "whole")
    assert not left.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([mine.name, "b.txt"])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    "write",
    [
        lambda file: file.write(b"0" * 10_000_000),
        lambda file: torch.save(torch.zeros(1_000_000), file),
        lambda file: np.save(file, np.zeros(1_000_000)),
    ],
    ids=["plain", "torch", "numpy"],
)
def test_a_full_disk_is_one_line(write, tmp_path: Path) -> None:
    with (
        pytest.raises(DiskError, match=rf"no space left on {tmp_path}: a\.pt was not written") as found,
        part_file(tmp_path / "a.pt"),
        open("/dev/full", "wb") as file,
    ):
        write(file)
    assert "\n" not in str(found.value)
    assert not list(tmp_path.iterdir())


def test_odd_words_of_a_library_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eldenet.system.disk._free", lambda folder: 0)
    with pytest.raises(DiskError, match="no space left on"), disk_errors(tmp_path, "a.xml"):
        raise RuntimeError("Check 'stream' failed at src/core.cpp:12")
    with pytest.raises(ValueError, match="wrong size"), disk_errors(tmp_path, "a.xml"):
        raise ValueError("wrong size")


def test_a_folder_that_cannot_be_one_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file") as found:
        write_text(tmp_path / "file" / "a.txt", "text")
    assert "\n" not in str(found.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_an_unwritable_folder_is_one_line(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(DiskError, match=rf"{tmp_path} cannot be written to .*give another folder"):
        write_text(tmp_path / "a.txt", "text")


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("eldenet_s-1.0+x", "eldenet_s-1.0+x"),
        ("../../ESCAPED", "_.._ESCAPED"),
        ("/etc/passwd", "_etc_passwd"),
        ("..", "unnamed"),
        ("a\nb", "a_b"),
        ("", "unnamed"),
        ("x" * 500, "x" * 100),
    ],
)
def test_names_from_foreign_data_stay_in_their_folder(name: str, stem: str) -> None:
    assert safe_stem(name) == stem


@pytest.mark.timeout(20)
def test_an_error_that_is_its_own_cause_ends_the_search_for_a_full_disk() -> None:
    first, second = ValueError("a"), ValueError("b")
    first.__cause__, second.__cause__ = second, first
    assert not is_full(first)

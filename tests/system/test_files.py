"""Files appear whole, under safe names; a full disk, a closed folder and one in use say so in one line."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from eldenet.system.errors import DiskError, line_of
from eldenet.system.files import LOCK, FolderInUse, part_file, part_path, safe_stem, sole_writer, write_text


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


@pytest.mark.parametrize(
    ("number", "reason"), [(errno.ENOSPC, "no space left on"), (errno.EFBIG, r".* \(File too large\)")]
)
def test_a_full_disk_is_one_line(number: int, reason: str, tmp_path: Path) -> None:
    with (
        pytest.raises(DiskError, match=rf"^{reason}[^\n]*: a\.pt was not written; [^\n]*$"),
        part_file(tmp_path / "a.pt"),
    ):
        raise OSError(number, os.strerror(number))
    assert not list(tmp_path.iterdir())
    assert line_of(FileExistsError(errno.EEXIST, "File exists", "a.jpg")).endswith(
        "give another folder or file"
    )
    assert line_of(OSError(errno.ENOSPC, "", "b.pt")).startswith("no space left on b.pt: free some space")


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


HOLDER = (
    "import sys, time\n"
    "from pathlib import Path\n"
    "from eldenet.system.files import sole_writer\n"
    "with sole_writer(Path(sys.argv[1])):\n"
    "    print('locked', flush=True)\n"
    "    time.sleep(100)\n"
)


def test_a_folder_is_locked_until_its_process_ends_however_it_ends(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "locked\n"
        with (
            pytest.raises(FolderInUse, match=rf"run is in use by process {holder.pid} on \S+: wait.*another"),
            sole_writer(folder),
        ):
            pass
        holder.kill()
    for _ in range(2):
        with sole_writer(folder):
            assert str(os.getpid()) in (folder / LOCK).read_text()


def test_a_locked_file_that_nobody_may_write_as_on_windows_locks_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    for name in ("read_text", "write_text", "unlink"):
        monkeypatch.setattr(Path, name, refuse)
    with (
        sole_writer(tmp_path),
        pytest.raises(FolderInUse, match="in use by another process"),
        sole_writer(tmp_path),
    ):
        pass

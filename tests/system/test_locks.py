"""One process writes into a run folder; its lock ends with it, and leaves no file behind."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from eldenet.system import locks
from eldenet.system.locks import FolderInUse, sole_writer

HOLDER = (
    "import sys, time\n"
    "from pathlib import Path\n"
    "from eldenet.system.locks import sole_writer\n"
    "with sole_writer(Path(sys.argv[1])):\n"
    "    print('locked', flush=True)\n"
    "    time.sleep(100)\n"
)

pytestmark = pytest.mark.skipif(locks.fcntl is None, reason="this system has no flock")


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
    with sole_writer(folder):
        assert str(os.getpid()) in (folder / locks.LOCK).read_text()
    assert list(folder.iterdir()) == []


def test_a_system_without_locks_trains_without_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "fcntl", None)
    with sole_writer(tmp_path), sole_writer(tmp_path):
        assert list(tmp_path.iterdir()) == []

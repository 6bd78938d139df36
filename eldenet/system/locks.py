"""A lock on a folder that the operating system holds: it ends with its process, however that ends."""

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

fcntl: Any
try:
    import fcntl
except ImportError:  # Windows: no lock
    fcntl = None

LOCK = ".lock"


class FolderInUse(ValueError):
    """Another process writes into the folder."""


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock ``folder``, which is made if need be, until the block or its process ends.

    On Windows, and on a file system without locks, there is none.

    Raises:
        FolderInUse: another process has the lock; the message names it.
    """
    if fcntl is None:
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    with _locked(path, folder) as file:
        file.truncate(0)
        file.write(f"process {os.getpid()} on {platform.node()}")
        file.flush()
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _locked(path: Path, folder: Path) -> Any:
    """Open ``path`` with its lock; if its holder removed it in between, it is opened again."""
    while True:
        file = path.open("a+")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            with file:
                file.seek(0)
                holder = file.read() or "another process"
            raise FolderInUse(
                f"{folder} is in use by {holder}: wait until that has ended, or give another folder"
            ) from None
        except OSError:  # a file system without locks
            return file
        if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
            return file
        file.close()

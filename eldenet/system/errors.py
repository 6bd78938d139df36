"""Errors in one line: of a damaged file, a full or closed disk, and all else that a user meets."""

import errno
import logging
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

USER_ERRORS = (ValueError, OSError, FloatingPointError, ImportError)
"""What a command shows in one line; any other error is a bug and shows its traceback."""
AGAIN = "fetch or write it again"
FULL = (errno.ENOSPC, errno.EDQUOT)
CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EFBIG)
# errors that name no file, and what to do
NAMELESS = {
    errno.EMFILE: "raise the number of files that may be open (ulimit -n 1024), or lower runtime.workers",
    errno.EROFS: "workers need a writable /dev/shm; runtime.workers=0 does without them",
    errno.EFBIG: "raise the largest size of a file (ulimit -f unlimited)",
}
# how torch hands over an error of a worker that loads data: with its traceback inside
_IN_A_WORKER = re.compile(r"Caught (\w+) in DataLoader worker process \d+\..*\n\1: (.*)", re.DOTALL)


class DiskError(OSError):
    """A disk is full, or a folder must not be written; the message is one line."""


@contextmanager
def reading(source: object, kind: str, advice: str = AGAIN) -> Iterator[None]:
    """Turn every error of a reader, which may be of any type, into a ``ValueError`` that names the file.

    Raises:
        FileNotFoundError: there is no such file.
    """
    try:
        yield
    except FileNotFoundError:
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {first_line(error)}"[:200]
        raise ValueError(f"{source} is truncated or not a valid {kind} ({reason}): {advice}") from error


@contextmanager
def writing(folder: Path, what: str) -> Iterator[None]:
    """Let the error of a full disk or a closed folder name the folder, and ``what`` was not written there.

    Raises:
        DiskError: in place of the system's error.
    """
    try:
        yield
    except DiskError:
        raise
    except OSError as error:
        if error.errno in FULL:
            reason, advice = f"no space left on {folder}", "free some space there and start again"
        elif error.errno in CLOSED:
            reason = f"{folder} cannot be written to ({os.strerror(error.errno)})"
            advice = "give another folder"
        else:
            raise
        raise DiskError(f"{reason}: {what} was not written; {advice}") from error


@lru_cache(maxsize=1000)
def warn_once(line: str) -> None:
    """Warn in one line, and say the same line only once."""
    logging.getLogger("eldenet").warning("%s", line)


def some_of(entries: Sequence[str], most: int = 10) -> str:
    """Return the first entries in words: "a, b and 3 more"."""
    more = f" and {len(entries) - most} more" if len(entries) > most else ""
    return ", ".join(entries[:most]) + more


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, without its number and file."""
    return ((getattr(error, "strerror", None) or str(error)).splitlines() or [""])[0]


def line_of(error: BaseException) -> str:
    """Return what a command prints for an error; the system's own errors name file and reason."""
    if isinstance(error, OSError) and error.errno in FULL:
        return f"no space left on {error.filename or 'this disk'}: free some space and start again"
    if isinstance(error, OSError) and error.errno in NAMELESS and not error.filename:
        return f"{error.strerror}: {NAMELESS[error.errno]}"
    if isinstance(error, OSError) and error.errno and error.filename:
        advice = ": give another folder or file" if error.errno in (*CLOSED, errno.EEXIST) else ""
        return f"{error.filename}: {error.strerror}{advice}"
    in_a_worker = _IN_A_WORKER.match(str(error))
    return in_a_worker[2].strip() if in_a_worker else str(error)

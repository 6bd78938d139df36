"""Errors of a disk that is full or must not be written, in one line whatever library met them."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FULL = (errno.ENOSPC, errno.EDQUOT)
CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR)
FULL_WORDS = ("No space left on device", "StorageFull", "Disk quota exceeded")
NO_ROOM = 64 * 1024  # [bytes] fewer are free: a writer that failed in odd words failed for want of space


class DiskError(OSError):
    """A disk is full, or a folder must not be written; the message is one line."""


@contextmanager
def disk_errors(folder: Path, what: str) -> Iterator[None]:
    """Turn an error of a full disk or of a folder that must not be written into one line.

    torch, safetensors, OpenVINO and others raise a ``RuntimeError`` in their own words, or only say that
    writing failed.

    Args:
        folder: that is written into.
        what: is written, for the message.

    Raises:
        DiskError: in place of the error.
    """
    try:
        yield
    except DiskError:
        raise
    except Exception as error:
        if is_full(error) or (not isinstance(error, ValueError) and _free(folder) < NO_ROOM):
            raise DiskError(
                f"no space left on {folder}: {what} was not written; free some space there and start again"
            ) from error
        if isinstance(error, OSError) and error.errno in CLOSED:
            raise DiskError(
                f"{folder} cannot be written to ({os.strerror(error.errno)}): {what} was not written; "
                "give another folder"
            ) from error
        raise


def is_full(error: BaseException | None) -> bool:
    """Whether an error, or one that it came from, is that of a full disk."""
    seen: list[BaseException] = []  # an error that was raised again from its own cause comes round
    while error is not None and error not in seen:
        seen.append(error)
        if isinstance(error, OSError) and error.errno in FULL:
            return True
        if any(words in str(error) for words in FULL_WORDS):
            return True
        error = error.__cause__ or error.__context__
    return False


def disk_line(error: BaseException) -> str | None:
    """Return the line to print for an error of a full disk or a closed folder; None: it is another error."""
    if isinstance(error, DiskError):
        return str(error)
    named = f"{error.filename}" if isinstance(error, OSError) and error.filename else "this disk"
    if is_full(error):
        return f"no space left on {named}: free some space and start again"
    if isinstance(error, OSError) and error.errno in CLOSED and error.filename:
        return f"{named} cannot be used ({os.strerror(error.errno)}): give another folder or file"
    return None


def _free(folder: Path) -> float:
    """Bytes that are free for ``folder``; infinity where that cannot be told."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return float("inf")

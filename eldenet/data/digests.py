"""SHA-256 digests of a data set's files, in a list that ``sha256sum -c`` reads too.

npy, HDF5, tar and JPEG files have no checksums of their own: a flipped bit changes depth unnoticed.
"""

import hashlib
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from eldenet.data.array_files import read_text
from eldenet.data.base import DepthDataset
from eldenet.system.files import part_file

LIST_NAME = "eldenet.sha256"
THREADS = 4  # hashing and reading overlap; more do not help a disk


def files_of(datasets: Iterable[DepthDataset]) -> list[Path]:
    """Return the files that frames of these splits are read from, each once.

    Raises:
        ValueError: the frames are rendered, not read.
    """
    return sorted(
        {file for data in datasets for index in range(len(data.names)) for file in data.frame_files(index)}
    )


def file_digests(files: Sequence[Path], advance: Callable[[int], None]) -> dict[Path, str]:
    """Return the SHA-256 of each file; ``advance`` is called with 1 per file."""

    def digest(file: Path) -> str:
        with file.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()

    found = {}
    with ThreadPoolExecutor(THREADS) as pool:
        for file, value in zip(files, pool.map(digest, files), strict=True):
            found[file] = value
            advance(1)
    return found


def write_digests(path: Path, digests: dict[Path, str]) -> None:
    """Write a list of digests; its files are relative to its folder.

    Raises:
        OSError: the folder cannot be written; says what to give instead.
    """
    folder = path.parent.resolve()
    lines = [f"{value}  {os.path.relpath(file.resolve(), folder)}\n" for file, value in digests.items()]
    try:
        with part_file(path) as unfinished:
            unfinished.write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise OSError(
            f"the list of digests {path} cannot be written ({error.strerror or error}): give a writable "
            "path, fingerprint=/my/folder/list.sha256"
        ) from error


def read_digests(path: Path) -> dict[Path, str]:
    """Return the digests of a list, by file.

    Raises:
        FileNotFoundError: there is no such list.
        ValueError: a line is not a digest and a file.
    """
    advice = "remove it, and run again to write it again"
    found = {}
    for number, line in enumerate(read_text(path, advice).splitlines(), 1):
        value, _, name = line.partition("  ")
        if len(value) != 64 or not name:
            raise ValueError(f"{path}, line {number}: {line[:90]!r} is not a digest and a file: {advice}")
        found[(path.parent / name).resolve()] = value
    return found


def compare_digests(
    path: Path, files: Sequence[Path], advance: Callable[[int], None]
) -> dict[str, list[str]]:
    """Check files against a list; return the changed, missing and new ones by these words.

    Args:
        path: of the list.
        files: that the data set has now.
        advance: called with 1 per file of the list.

    Raises:
        ValueError: the list is damaged.
    """
    listed = read_digests(path)
    there = [file for file in listed if file.is_file()]
    advance(len(listed) - len(there))
    now = file_digests(there, advance)
    return {
        "changed": [str(file) for file in there if now[file] != listed[file]],
        "missing": [str(file) for file in listed if file not in now],
        "new": [str(file) for file in files if file.resolve() not in listed],
    }

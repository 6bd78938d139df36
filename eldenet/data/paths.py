"""Where data lies on disk: a data set's root (``data.root``, or below ELDENET_DATA), its files, the cache."""

import csv
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

from eldenet.system.errors import reading, some_of, warn_once
from eldenet.system.files import read_text

VARIABLE = "ELDENET_DATA"
OTHER_PICTURES = (
    ".heic", ".heif", ".hif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef",
    ".srw", ".jpe", ".jfif", ".jxl", ".jp2", ".j2k", ".gif", ".pnm", ".pbm", ".tga", ".psd", ".hdr", ".ico",
)  # fmt: skip
"""Endings of pictures in formats that nothing here reads, unless a caller's own endings have them."""


def default_cache() -> Path:
    """Return ``$ELDENET_CACHE``, or ``~/.cache/eldenet``: where frames are cached and rendered."""
    return Path(os.environ.get("ELDENET_CACHE") or "~/.cache/eldenet").expanduser()


def natural_order(name: str) -> tuple[list[str | float], str]:
    """Return a key that sorts names as they were recorded: frame 2 before frame 10.

    Seconds since 1970 are decimal numbers, whose last zeros programs leave out: 1700000000.25 before .3.
    """
    parts = re.split(r"(\d{10,}\.\d+|\d+)", name)  # every second one is a number
    key: list[str | float] = [
        (float(part) if "." in part else int(part)) if n % 2 else part for n, part in enumerate(parts)
    ]
    return key, name


def visible_files(folder: Path, endings: Sequence[str]) -> list[Path]:
    """Return the files with these endings in a folder and below, but no hidden ones (``._a.jpg``).

    Pictures in other formats are counted and named in a warning.
    """
    return with_endings(files_below(folder), endings, folder)


def files_below(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and below, but no hidden ones.

    A link to a folder elsewhere, as of a scene on another disk, is followed once; one to a folder that is
    walked anyway is not.
    """
    walked = {folder.resolve()}
    for place, folders, names in os.walk(folder, followlinks=True):
        here = Path(place)
        yield from (here / name for name in names if not name.startswith("."))
        folders[:] = [name for name in sorted(folders) if not name.startswith(".")]
        for name in [name for name in folders if (here / name).is_symlink()]:
            target = (here / name).resolve()
            if any(target.is_relative_to(one) or one.is_relative_to(target) for one in walked):
                folders.remove(name)
            else:
                walked.add(target)


def with_endings(paths: Iterable[Path], endings: Sequence[str], folder: Path) -> list[Path]:
    """Return the paths with these endings; a warning counts and names pictures in other formats."""
    found, others = [], []
    for path in paths:
        ending = path.suffix.lower()
        if ending in endings:
            found.append(path)
        elif ending in OTHER_PICTURES:
            others.append(path)
    if others:
        counts = Counter(path.suffix.lower() for path in others)
        each = ", ".join(f"{count} {ending}" for ending, count in counts.most_common())
        warn_once(
            f"{folder}: pictures in formats that are not read are passed over ({each}; such as "
            f"{min(others).name}): convert them to JPEG or PNG"
        )
    return found


def composed(name: str) -> str:
    """Return a name in Unicode's composed form: macOS writes letters and their accents apart."""
    return unicodedata.normalize("NFC", name)


def as_on_disk(root: Path, file: str) -> str:
    """Return a path of a list as it is spelled below ``root``, where Unicode has several ways to write it."""
    if file.isascii() or (root / file).exists():
        return file
    place = Path()
    for part in Path(file).parts:
        folder = root / place
        same = [n for n in os.listdir(folder) if composed(n) == composed(part)] if folder.is_dir() else []
        place /= same[0] if len(same) == 1 else part
    return place.as_posix()


def find_root(
    root: str | Path | None,
    default: str | None,
    must_contain: Sequence[str],
    tree: str,
    setting: str = "data.root",
) -> Path:
    """Find the folder of a data set.

    Args:
        root: the folder itself, or None for ``$ELDENET_DATA/<default>``.
        default: the data set's folder below ELDENET_DATA; None if there is no usual one.
        must_contain: files and folders that it must contain, relative to it.
        tree: the expected tree, for the message.
        setting: that gives the folder, for the message.

    Raises:
        FileNotFoundError: the folder or what it must contain is missing; says what to set.
    """
    advice = f"set {setting} to the data set's folder"
    if default is not None:
        advice += f", or {VARIABLE} so that ${VARIABLE}/{default} is that folder"
    if root is None:
        base = os.environ.get(VARIABLE)
        if not base or default is None:
            raise incomplete("no folder given for the data set", tree, advice)
        root = Path(base) / default
    folder = Path(root).expanduser()
    if not folder.is_dir():
        raise incomplete(f"{folder} is not a folder", tree, advice)
    missing = [entry for entry in must_contain if not (folder / entry).exists()]
    if missing:
        raise incomplete(f"{folder} has no {', '.join(missing)}", tree, f"check {setting}")
    return folder


def incomplete(fault: str, tree: str, advice: str = "check data.root") -> FileNotFoundError:
    """Return the error about a data set whose files are not where they should be, with their tree."""
    return FileNotFoundError(f"{fault}: {advice}. Expected tree:\n{tree.strip()}")


def names_in(folder: Path) -> frozenset[str]:
    """Return the names in a folder, none if there is no such folder."""
    return frozenset(os.listdir(folder)) if folder.is_dir() else frozenset()


def missing_files(root: Path, files: Sequence[str]) -> list[str]:
    """Return those of ``files``, relative to ``root``, that do not exist.

    Each folder is listed once, so fifty thousand frames take a moment even on a network drive.
    """
    names = cache(names_in)
    return [file for file in files if os.path.basename(file) not in names(root / os.path.dirname(file))]


def check_files(root: Path, files: Sequence[str], advice: str = "") -> None:
    """Raise FileNotFoundError unless every file, relative to ``root``, exists; ``advice``: where to look."""
    missing = [str(root / file) for file in missing_files(root, files)]
    if missing:
        raise FileNotFoundError(
            f"{len(missing)} of {len(files)} files are missing: {some_of(missing)}. Complete the data set"
            f"{advice}, or leave these frames out (data.on_error=skip)"
        )


def check_inside(files: Iterable[str], source: Path, advice: str) -> None:
    """Raise ValueError, with ``advice``, if a file of a list leaves the data set's folder (``../``)."""
    for file in files:
        if os.path.isabs(file) or os.path.normpath(file).split(os.sep)[0] == os.pardir:
            raise ValueError(f"{source}: {file[:200]!r} is outside the data set's folder: {advice}")


def csv_pairs(table: Path) -> list[tuple[str, str]]:
    """Read lines ``image,depth`` of a CSV without a header; empty lines are skipped.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a line is not a pair, or the file is empty or not text.
    """
    pairs = []
    text = read_text(table, "fetch or write the list of frames again")
    with reading(table, "CSV"):
        rows = list(csv.reader(text.splitlines()))
    for number, row in enumerate(rows, 1):
        if not row:
            continue
        if len(row) != 2 or not all(cell.strip() for cell in row):
            raise ValueError(f"{table}, line {number}: expected image,depth, found {str(row)[:200]}")
        pairs.append((row[0].strip(), row[1].strip()))
    if not pairs:
        raise ValueError(f"{table} is empty: fetch or write the list of frames again")
    return pairs

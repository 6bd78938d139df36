"""Files that appear whole, and guarded readers of text, JSON, YAML and CSV."""

import csv
import json
import lzma
import math
import os
import platform
import re
import shutil
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import StringIO
from pathlib import Path
from typing import Any

from eldenet.system.errors import AGAIN, reading, writing
from eldenet.system.escaping import csv_cell

MOST_YAML, MOST_TEXT = 1_000_000, 100_000_000  # bytes; of a compressed file, those that it holds
DEEPEST = 50  # levels of a JSON file: far more than a record has, far fewer than Python can follow
LOCK = ".lock"


class FolderInUse(ValueError):
    """Another process writes into the folder."""


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock ``folder``, which is made if need be, until the block or its process ends, however it ends.

    Raises:
        FolderInUse: another process has the lock; the message names it.
    """
    from filelock import FileLock, Timeout

    folder.mkdir(parents=True, exist_ok=True)
    path, holder = folder / LOCK, "another process"
    try:
        lock = FileLock(path, timeout=0).acquire()
    except Timeout:
        with suppress(PermissionError):
            holder = path.read_text(errors="replace") or holder
        raise FolderInUse(
            f"{folder} is in use by {holder}: wait until that has ended, or give another folder"
        ) from None
    with lock:
        with suppress(PermissionError):  # Windows lets nobody read or write a locked file
            path.write_text(f"process {os.getpid()} on {platform.node()}")
        try:
            yield
        finally:
            with suppress(PermissionError):
                # whoever opened it in between sees that it is gone, and tries again
                path.unlink(missing_ok=True)


@contextmanager
def part_file(path: Path) -> Iterator[Path]:
    """Yield a hidden path beside ``path`` that replaces it at the end; after an error it is removed.

    What a killed process left in that folder is removed by the next one that writes there.

    Raises:
        DiskError: the disk is full, or the folder must not be written.
    """
    folder = path.parent
    try:
        with writing(folder, path.name):
            folder.mkdir(parents=True, exist_ok=True)
            remove_unfinished(folder)
            unfinished = part_path(path)
            unfinished.touch()  # a folder that must not be written says so here, before a library meets it
            yield unfinished
            unfinished.replace(path)
    finally:
        with suppress(OSError):
            part_path(path).unlink(missing_ok=True)


_MACHINE = f"{zlib.crc32(platform.node().encode()):08x}"  # folders may be shared between machines
_PART = re.compile(rf"\..*\.{_MACHINE}-(\d+)\.part(\.[^.]*)?")
_seen: set[tuple[int, Path]] = set()  # folders in which this process has looked


def part_path(path: Path) -> Path:
    """Return where this process writes ``path`` until it is complete."""
    return path.with_name(f".{path.stem[:200]}.{_MACHINE}-{os.getpid()}.part{path.suffix}")


def remove_unfinished(folder: Path) -> None:
    """Remove what dead processes of this machine left in ``folder``; each process looks once."""
    key = os.getpid(), folder.absolute()
    if key in _seen:
        return
    _seen.add(key)
    import psutil

    for name in os.listdir(folder):
        found = _PART.fullmatch(name)
        if found and not psutil.pid_exists(int(found[1])):
            with suppress(OSError):
                (folder / name).unlink()


def copy_file(source: Path, path: Path) -> None:
    """Copy a file; it appears whole."""
    with part_file(path) as unfinished:
        shutil.copy2(source, unfinished)


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file; it appears whole."""
    with part_file(path) as unfinished:
        unfinished.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8), compressed where its name ends with ``.xz``; it appears whole."""
    content = text.encode()
    write_bytes(path, lzma.compress(content) if path.suffix == ".xz" else content)


def safe_stem(name: str) -> str:
    """Return a name from foreign data as part of a file's name: no folders, no odd characters, not hidden."""
    return re.sub(r"[^\w.+-]+", "_", name).lstrip(".")[:100] or "unnamed"


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file; NaN and infinity become null, so that any reader can parse it."""
    write_text(path, json.dumps(_without_nan(content), indent=2, allow_nan=False) + "\n")


def _without_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def shipped_folder(name: str, file: str) -> Path:
    """Return a folder that comes with eldenet: beside the package in a checkout, inside it in a wheel.

    Raises:
        FileNotFoundError: there is none.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / name, package.parent / name):
        if (folder / file).is_file():
            return folder
    raise FileNotFoundError(f"no {name} beside {package}: the installation is incomplete, reinstall eldenet")


def displayed(path: Path) -> Path:
    """Return the path as people read it: from the working directory where it lies below that."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file; a text that a spreadsheet would run as a formula starts with an apostrophe there."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in (header, *rows):
        writer.writerow([csv_cell(cell) if isinstance(cell, str) else cell for cell in row])
    write_text(path, text.getvalue())


def write_yaml(path: Path, content: Mapping[str, Any]) -> None:
    """Write plain values as a YAML file."""
    import yaml

    write_text(path, yaml.safe_dump(dict(content), sort_keys=False))


# --- readers: a missing file is a FileNotFoundError, a damaged or too large one a ValueError; both name it


def read_text(path: Path, advice: str = AGAIN, most: int = MOST_TEXT) -> str:
    """Return the text of a file (UTF-8), which is compressed where its name ends with ``.xz``.

    It may hold ``most`` bytes; ``advice`` says what to do if it is missing or no text.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged, no text, or too long.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist{' as a file' * path.exists()}: {advice}")
    with reading(path, "text file", advice):
        with lzma.open(path) if path.suffix == ".xz" else path.open("rb") as file:
            content = file.read(most + 1)
        if len(content) > most:
            raise ValueError(f"it has more than the {most // 1_000_000} MB allowed")
        if b"\0" in content:
            raise ValueError("it contains zero bytes")
        return content.decode("utf-8-sig")  # some editors start files with a byte-order mark


def read_table(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Return the rows of a CSV file by column; it must have ``columns``, and each row a cell for each.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not text, lacks one of ``columns``, or has a row with more or fewer cells.
    """
    text = read_text(path)
    with reading(path, "table"):
        reader = csv.DictReader(StringIO(text, newline=""), strict=True)
        rows, header = list(reader), list(reader.fieldnames or ())
        if missing := [name for name in columns if name not in header]:
            raise ValueError(f"it has the columns {header}, but needs {missing}")
        cut = [number for number, row in enumerate(rows, 2) if None in row or None in row.values()]
        if cut:
            raise ValueError(f"line {cut[0]} has more or fewer cells")
    return rows


def read_yaml(path: Path) -> Any:
    """Return the plain values of a YAML file of at most :data:`MOST_YAML`.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not YAML, or larger than :data:`MOST_YAML`.
    """
    import yaml

    text = read_text(path, most=MOST_YAML)
    with reading(path, "YAML file"):
        try:
            return yaml.safe_load(text)
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else "?"
            raise ValueError(f"line {line}: {error.problem}") from error


def read_json(path: Path) -> Any:
    """Return the plain values of a JSON file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not JSON, larger than :data:`MOST_TEXT` or nested too deep.
    """
    return parse_json(read_text(path), path)


def parse_json(text: str, source: object) -> Any:
    """Return the plain values of a JSON text; ``source`` is for messages.

    Raises:
        ValueError: the text is not JSON, or nested too deep.
    """
    with reading(source, "JSON file"):
        level = [content := json.loads(text, parse_int=_whole_number, parse_constant=_refuse_constant)]
        for _ in range(DEEPEST):
            lists = [list(value.values()) if isinstance(value, dict) else value for value in level]
            level = [part for value in lists if isinstance(value, list) for part in value]
        if level:
            raise RecursionError("it is nested too deep")
    return content


def _whole_number(digits: str) -> int:
    number = int(digits)
    float(number)  # what no float holds raises OverflowError here, not wherever it is used
    return number


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a number in JSON")

"""Files that appear whole: written beside their place first, then renamed."""

import csv
import json
import math
import os
import platform
import re
import shutil
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from eldenet.system.disk import disk_errors


@contextmanager
def part_file(path: Path) -> Iterator[Path]:
    """Yield a hidden path beside ``path`` that replaces it at the end; after an error it is removed.

    What a killed process left in that folder is removed by the next one that writes there.

    Raises:
        DiskError: the disk is full, or the folder must not be written.
    """
    folder = path.parent
    try:
        with disk_errors(folder, path.name):
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
    for name in os.listdir(folder):
        found = _PART.fullmatch(name)
        if found and not _lives(int(found[1])):
            with suppress(OSError):
                (folder / name).unlink()


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        return True
    return True


def copy_file(source: Path, path: Path) -> None:
    """Copy a file; it appears whole."""
    with part_file(path) as unfinished:
        shutil.copy2(source, unfinished)


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8); it appears whole."""
    with part_file(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


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


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file."""
    with part_file(path) as unfinished, unfinished.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def write_yaml(path: Path, content: Mapping[str, Any]) -> None:
    """Write plain values as a YAML file."""
    import yaml

    write_text(path, yaml.safe_dump(dict(content), sort_keys=False))


def read_yaml(path: Path) -> Any:
    """Return the plain values of a YAML file.

    Raises:
        ValueError: the file is missing or not YAML.
    """
    import yaml

    try:
        return yaml.safe_load(path.read_text())
    except (yaml.YAMLError, OSError) as error:
        raise ValueError(f"{path} can't be read as YAML: {error}") from error

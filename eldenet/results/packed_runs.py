"""The runs of a study in one file, ``runs.jsonl.xz``: a line for each has its ``run.json`` and its images.

A run is named as its folder: ``eldenet/seed0``. Its line is ``run.json`` with two more entries: ``run``, the
name, and ``per_image``, the columns of ``per_image.csv``. :func:`pack` adds a run folder.
"""

import json
import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from eldenet.results.run_record import RUN_FILE, read_record
from eldenet.system.files import LOCK, parse_json, read_table, read_text, write_text

RUNS = "runs.jsonl.xz"
NAME, IMAGES = "run", "per_image"
DIGITS = 5  # of a metric of one image
MOST = 1_000_000_000  # bytes of all runs


def read_records(path: Path) -> dict[str, dict[str, Any]]:
    """Return the records of a ``.jsonl.xz`` file by their names; none without the file.

    Raises:
        ValueError: it is damaged.
    """
    return dict(_records(path, file_state(path))) if path.is_file() else {}


def file_state(path: Path) -> tuple[int, int, int]:
    """Return what changes when a file is written anew."""
    state = path.stat()
    return state.st_mtime_ns, state.st_ino, state.st_size


@lru_cache(maxsize=8)
def _records(path: Path, state: tuple[int, int, int]) -> dict[str, dict[str, Any]]:
    try:
        lines = read_text(path, most=MOST).splitlines()
        records = [parse_json(line, f"line {number}") for number, line in enumerate(lines, 1)]
        return {str(record.pop(NAME)): record for record in records}
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise ValueError(f"{path} is damaged or not eldenet's ({error}): restore it") from error


def write_records(path: Path, records: Mapping[str, Mapping[str, Any]]) -> None:
    """Write records, a line each."""
    lines = (json.dumps({NAME: name, **record}, separators=(",", ":")) for name, record in records.items())
    write_text(path, "".join(f"{line}\n" for line in lines))


def add_record(folder: Path, name: str, record: Mapping[str, Any]) -> None:
    """Add a record to those in ``folder``, or replace it. Processes that do so at once take turns."""
    from filelock import FileLock

    with FileLock(folder / LOCK):
        write_records(folder / RUNS, read_records(folder / RUNS) | {name: record})


def pack(run: Path, folder: Path, name: str) -> None:
    """Add the finished run in the folder ``run`` to the runs in ``folder``, or replace it."""
    add_record(folder, name, read_record(run / RUN_FILE) | {IMAGES: image_columns(run / "per_image.csv")})


def image_columns(path: Path) -> dict[str, list[Any]]:
    """Return the columns of a ``per_image.csv``: the images' names, and metrics, None for NaN."""
    rows = read_table(path, ("name",))
    metrics = list(rows[0])[1:] if rows else []
    columns = {metric: [_short(row[metric]) for row in rows] for metric in metrics}
    return {"name": [row["name"] for row in rows], **columns}


def _short(cell: str) -> float | None:
    value = float(cell or "nan")
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None

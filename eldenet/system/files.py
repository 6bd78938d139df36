"""Files that appear whole: written beside their place first, then renamed."""

import csv
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eldenet.system.escaping import csv_cell


@contextmanager
def part_file(path: Path) -> Iterator[Path]:
    """Yield a hidden path beside ``path`` that replaces it at the end; after an error it is removed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield unfinished
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file; NaN and infinity become null, so that any reader can parse it."""
    with part_file(path) as unfinished:
        unfinished.write_text(json.dumps(_without_nan(content), indent=2, allow_nan=False) + "\n")


def _without_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file; a text that a spreadsheet would run as a formula starts with an apostrophe there."""
    with part_file(path) as unfinished, unfinished.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for row in (header, *rows):
            writer.writerow([csv_cell(cell) if isinstance(cell, str) else cell for cell in row])


def read_table(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Return the rows of a CSV file by column.

    Raises:
        ValueError: it is not text, lacks one of ``columns``, or has a row with more or fewer cells.
    """
    try:
        with path.open(newline="", encoding="utf-8") as lines:
            reader = csv.DictReader(lines, strict=True)
            rows, header = list(reader), list(reader.fieldnames or ())
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path} is not a CSV file ({error}): restore it, or make it again") from error
    missing = [name for name in columns if name not in header]
    if missing:
        raise ValueError(
            f"{path} has the columns {header}, but needs {missing}: restore it, or make it again"
        )
    for number, row in enumerate(rows, 2):
        if None in row or None in row.values():
            raise ValueError(f"{path}, line {number} is cut or damaged: restore the file, or make it again")
    return rows


def write_yaml(path: Path, content: Mapping[str, Any]) -> None:
    """Write plain values as a YAML file."""
    import yaml

    with part_file(path) as unfinished:
        unfinished.write_text(yaml.safe_dump(dict(content), sort_keys=False))


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

"""Look up the figures of a page in the stored files that its comments name.

A comment stands before the paragraph, list or table whose figures it names::

    <!-- source: eldenet study study=experiments/table3_rivals
    table3_rivals/runs.jsonl.xz: eldenet_l
    table3_rivals/results.md: | eldenet_l ; | eldenet over meter_xs
    -->

It starts with the command that makes the files. Each line has a file, from the repository or from
experiments/, and keys in it. A table has one line for each of its rows with figures, in their order; a row
that needs two files has them joined by `` ;; ``. The keys, joined by `` ; ``:

- of ``runs.jsonl.xz``, a row of the study (or one run, ``ROW/seed0``): the mean and deviation of each
  metric over its seeds. ``ROW: constant_predictor`` and ``ROW: training`` have those of other entries of
  ``run.json``;
- of JSON, the start of a dotted path;
- of any other text (CSV, tables of ``results.md``, YAML), a part of a line, with ``*`` for anything: the
  numbers of the line. ``A over B`` has the ratios of two lines, column by column.

``python -m tests.support.sources`` lists what is wrong on the pages.
"""

import json
import re
import statistics
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from eldenet.results.packed_runs import RUNS, read_records

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = ("README.md", "docs/results.md", "docs/paper.md")
COMMENT = re.compile(r"<!-- source: (.+?)\n(.*?)\n?-->", re.S)
NO_FIGURES = re.compile(
    r"`[^`]*`"  # names and settings
    r"|\]\([^)]*\)"  # targets of links
    r'|"[^"]*"'  # what the paper says
    r"|\((?:Sections?|sections?|Tables?|[Ff]ig\w*\.?) [^)]*\)|[Ss]ections? [\d.]+(?: to [\d.]+)?"
    r"|95\s%|CC BY\s2\.0|Apache-2\.0|Python 3\.\d+|\b1\.25[²³]?(?!\d)|doi\.org/\S+|^#.*$",
    re.M,
)
FIGURE = re.compile(
    r"(?<![\w.,])(\d[\d,]*\.\d+|"
    r"\d[\d,]*(?=\s(?:%|ms|s|min|minutes?|of \d+|parameters|times)(?!\w)))(?: ([M%]))?"
)
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?(?:e-?\d+)?")


def problems(page: str, text: str) -> list[str]:
    """Return the figures of a page that have no source or another value there."""
    found, sources = [], None
    for block in re.split(r"\n\s*\n", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)):
        if match := COMMENT.fullmatch(block.strip()):
            sources = match[2].splitlines()
            continue
        rows = [row for row in _rows(block) if _figures(row)]
        if rows and sources is None:
            found += [f"{page}: no source: {_figures(row)} in {row[:90]}" for row in rows]
        elif sources is not None and not rows:
            found.append(f"{page}: a source without figures: {block[:90]}")
        elif sources is not None and block.startswith("|"):
            if len(rows) != len(sources):
                found.append(
                    f"{page}: {len(sources)} sources for {len(rows)} rows: {[row[:40] for row in rows]}"
                )
            for row, source in zip(rows, sources, strict=False):
                found += _wrong(page, row, source.split(" ;; "))
        elif sources is not None:
            found += _wrong(page, block, sources)
        sources = None
    return found


def _rows(block: str) -> list[str]:
    return block.splitlines() if block.startswith("|") else [block]


def _figures(text: str) -> list[tuple[str, str]]:
    return FIGURE.findall(NO_FIGURES.sub(" ", text))


def _wrong(page: str, text: str, sources: list[str]) -> Iterator[str]:
    try:
        values = [value for source in sources for value in stored(source)]
    except (LookupError, OSError) as error:
        yield f"{page}: {error}: {text[:90]}"
        return
    for figure, unit in _figures(text):
        number = figure.replace(",", "")
        within = 0.5000001 * 10.0 ** -len(number.partition(".")[2])
        scales = {"M": (1, 1e-6), "%": (1, 100)}.get(unit, (1,))
        if not any(abs(value * scale - float(number)) <= within for value in values for scale in scales):
            yield f"{page}: {figure} is not in {sources}: {text[:90]}"


def stored(source: str) -> list[float]:
    """Return the values, without their signs, that a line of a comment names: ``FILE: KEY ; KEY``."""
    name, _, keys = source.partition(": ")
    path = next((p for p in (REPOSITORY / "experiments" / name, REPOSITORY / name) if p.is_file()), None)
    if path is None:
        raise LookupError(f"no file {name}")
    values = [value for key in keys.split(" ; ") for value in _values(path, key.strip())]
    return [abs(value) for value in values]


def _values(path: Path, key: str) -> list[float]:
    if " over " in key:
        one, other = (_values(path, part) for part in key.split(" over "))
        return [a / b for a, b in zip(one, other, strict=False) if b]
    if path.name == RUNS:
        return _over_seeds(path, *key.split(": "))
    text = path.read_text()
    lines = list(_flat(json.loads(text))) if path.suffix == ".json" else text.splitlines()
    lines = [line.replace(",", ", ") if path.suffix == ".csv" else line for line in lines]
    found = [line for line in lines if fnmatchcase(line, f"*{key}*")]
    if not found:
        raise LookupError(f"{path.relative_to(REPOSITORY)} has no {key}")
    return [float(number.replace(",", "")) for line in found for number in NUMBER.findall(line)]


def _over_seeds(path: Path, row: str, entry: str = "metrics") -> list[float]:
    runs = [
        _entry(record, entry)
        for name, record in read_records(path).items()
        if name == row or name.startswith(f"{row}/seed")
    ]
    if not runs:
        raise LookupError(f"{path.relative_to(REPOSITORY)} has no {row}")
    columns = [[run[key] for run in runs if key in run] for key in runs[0] if isinstance(runs[0][key], float)]
    return [value for column in columns for value in (statistics.fmean(column), _deviation(column))]


def _entry(record: Any, entry: str) -> dict[str, Any]:
    for key in entry.split("."):
        record = record[-1] if key == "last" else record[key]
    return record


def _deviation(column: list[float]) -> float:
    return statistics.stdev(column) if len(column) > 1 else 0.0


def _flat(value: Any, path: str = "") -> Iterator[str]:
    if isinstance(value, dict):
        for key, below in value.items():
            yield from _flat(below, f"{path}.{key}" if path else key)
    else:
        yield f"{path} {value}"


if __name__ == "__main__":
    for page in PAGES:
        print(*problems(page, (REPOSITORY / page).read_text()), sep="\n")

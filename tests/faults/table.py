"""The campaign's results as the table of docs/reliability.md."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

from .campaign import CLASSES, CLEAR, HANG, RAW, SILENT, UNHARMED, Outcome

RESULTS = Path(__file__).with_name("results.json")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"
START, END = "<!-- table of python -m tests.faults -->", "<!-- end of the table -->"
TITLES = {
    "seen": "damaged files with a checksum",
    "unseen": "damaged files without one",
    "hostile": "hostile files",
    "mistake": "other units and odd files",
    "full disk": "full disk, by what is written",
    "accident": "kills and two processes",
}


class Row(NamedTuple):
    """Outcomes of one kind of attack; ``wrong`` are those that the page promises not to happen."""

    part: str
    name: str
    digest: bool
    counts: dict[str, int]
    wrong: list[str]


def counted(part: str, name: str, outcomes: Sequence[Outcome], digest: bool) -> Row:
    """A row: ``digest`` says whether a checksum could show the damage."""
    counts = Counter(outcome.what for outcome in outcomes)
    broken = (RAW, HANG, SILENT) if digest else (RAW, HANG)
    wrong = [f"{one.what}: {one.said[:300]}" for one in outcomes if one.what in broken]
    return Row(part, name, digest, {what: counts[what] for what in CLASSES}, list(dict.fromkeys(wrong)))


def is_wrong(row: Row) -> bool:
    return bool(row.wrong)


def write_page(rows: Sequence[Row]) -> None:
    """Put the table between its marks on the page."""
    before, _, rest = PAGE.read_text().partition(START)
    PAGE.write_text(f"{before}{START}\n{to_markdown(rows)}{END}{rest.partition(END)[2]}")


def to_markdown(rows: Sequence[Row]) -> str:
    """The sums, and the kinds of file whose damage cannot always be seen."""
    parts = {title: [row for row in rows if _part(row) == part] for part, title in TITLES.items()}
    lines = [*_head("attack"), *(_line(title, members) for title, members in parts.items() if members), ""]
    shown = sorted((row for row in rows if row.counts[SILENT]), key=lambda row: -row.counts[SILENT])
    if shown:
        kinds = ", ".join(f"{row.name} {row.counts[SILENT]}" for row in shown)
        lines += [fill(f"Damage that cannot be seen, in 30 attacks on each kind of file: {kinds}.", 120), ""]
    return "\n".join(["", *lines, ""])


def _part(row: Row) -> str:
    return row.part if row.part != "file" else "seen" if row.digest else "unseen"


def _head(first: str) -> list[str]:
    unseen = "cannot be seen"
    return [
        f"| {first} | attacks | {CLEAR} | {UNHARMED} | {SILENT} | {unseen} | {RAW} | {HANG} |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]


def _line(name: str, rows: Iterable[Row]) -> str:
    rows = list(rows)

    def of(what: str, members: Iterable[Row] = rows) -> int:
        return sum(row.counts[what] for row in members)

    silent = of(SILENT, [row for row in rows if row.digest])
    unseen = of(SILENT, [row for row in rows if not row.digest])
    attacks = sum(map(of, CLASSES))
    cells = [name, attacks, of(CLEAR), of(UNHARMED), silent, unseen, of(RAW), of(HANG)]
    return f"| {' | '.join(map(str, cells))} |"

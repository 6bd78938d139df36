"""Stored episodes of tables 5 and 6, and tests of two methods on the same arenas."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.navigation.evaluation import Episode
from eldenet.system.files import read_table, write_rows

EPISODE_COLUMNS = ("world", "outcome", "seconds", "travelled", "shortest")


def read_episodes(file: Path, labels: Sequence[str]) -> dict[tuple[str, ...], list[Episode]]:
    """Return what :func:`write_episodes` wrote; nothing where there is no file.

    Raises:
        ValueError: the file is damaged.
    """
    out: dict[tuple[str, ...], list[Episode]] = {}
    for line in read_table(file, [*labels, *EPISODE_COLUMNS]) if file.is_file() else []:
        density = int(line["world"].split("-")[-2].partition("+")[0])  # of "test-20+10-7", 20
        lengths = (float(line[name]) for name in EPISODE_COLUMNS[2:])
        key = tuple(line[name] for name in labels)
        out.setdefault(key, []).append(Episode(line["world"], density, line["outcome"], *lengths))
    return out


def write_episodes(
    file: Path, labels: Sequence[str], rows: Mapping[tuple[Any, ...], Sequence[Episode]]
) -> None:
    """Write the episodes of several rows of a table as CSV; ``labels`` are the columns that name a row."""
    lines = [
        [*key, *(getattr(episode, name) for name in EPISODE_COLUMNS)]
        for key, episodes in rows.items()
        for episode in episodes
    ]
    write_rows(file, [*labels, *EPISODE_COLUMNS], lines)


def solved_by_all(tables: Sequence[Sequence[Episode]]) -> np.ndarray:
    """Mask of the arenas that every method solved ``(arenas,)`` bool.

    Raises:
        ValueError: the tables are from different arenas.
    """
    names = [[row.world for row in table] for table in tables]
    if any(other != names[0] for other in names[1:]):
        raise ValueError("the tables are from different arenas: compare times on the same arenas only")
    return np.all([[row.outcome == "success" for row in table] for table in tables], axis=0)


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> tuple[int, int, float]:
    """Exact paired test of two methods on the same arenas: McNemar, Psychometrika 1947.

    Returns:
        Arenas that only the first solved, arenas that only the second solved, and the two-sided p-value.
    """
    from scipy.stats import binomtest

    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    only_first, only_second = int((a & ~b).sum()), int((b & ~a).sum())
    if only_first + only_second == 0:
        return 0, 0, 1.0
    return only_first, only_second, float(binomtest(only_first, only_first + only_second).pvalue)

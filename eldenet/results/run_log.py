"""Output of a run for people: progress (a bar on a terminal, else lines), loggers, images, tables."""

import os
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.markup import escape
from rich.table import Table

from eldenet.results.loggers import LOGGERS, Logger
from eldenet.system.errors import writing
from eldenet.system.escaping import one_line
from eldenet.system.files import write_rows
from eldenet.system.progress import Bar, open_console, progress_bar
from eldenet.system.terminal import printable

SHORTEST_NAME = 12  # characters of a row's name on a line
GAP = 2  # between the columns of a table


def untrained_note(source: str) -> str:
    """Return a note for the user on a network that was built by name, where trained weights are expected."""
    return f"note: {source} is a freshly initialized network, so its depth is meaningless"


class RunLog:
    """Console, loggers and images of one run folder; ``quiet`` (other processes) writes nothing.

    Args:
        folder: of the run.
        quiet: for processes that are not the main one.
        first_step: the next step of a resumed run: TensorBoard drops points that a killed process left from
            there on; None: it keeps all.
        loggers: names of :data:`~eldenet.results.loggers.LOGGERS`.
    """

    def __init__(
        self,
        folder: Path,
        *,
        quiet: bool = False,
        first_step: int | None = None,
        loggers: Sequence[str] = ("tensorboard",),
    ) -> None:
        self.folder, self.quiet, self.loggers = folder, quiet, loggers
        self.console = open_console(quiet=quiet)
        self._started = time.monotonic()
        if not self.console.is_terminal and "COLUMNS" not in os.environ:
            self.console.width = 500  # a file has no width: tables keep all columns
        self._open: list[Logger] | None = None
        self._first_step = first_step

    @property
    def seconds(self) -> float:
        """Time since this log was made, at the start of the run [s]."""
        return time.monotonic() - self._started

    def _opened(self) -> list[Logger]:
        """The loggers, opened when first used."""
        if self._open is None:
            self._open = [LOGGERS[name](self.folder, self._first_step) for name in self.loggers]
        return self._open

    def _writing(self) -> AbstractContextManager[None]:
        """Say that the loggers could not write, where a disk is full or must not be written."""
        return writing(self.folder, f"the log of {', '.join(self.loggers)}")

    def say(self, text: str) -> None:
        """Print one line: brackets are no markup, and long paths are not wrapped."""
        self.console.print(printable(text), highlight=False, markup=False, soft_wrap=True)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Write scalars under their names."""
        if not self.quiet:
            with self._writing():
                for logger in self._opened():
                    logger.scalars(step, values)

    def picture(self, name: str, step: int, picture: np.ndarray) -> None:
        """Write ``(H, W, 3)`` uint8 to the loggers and to ``<folder>/<name>.png``."""
        if not self.quiet:
            from eldenet.visualization import write_picture

            with self._writing():
                for logger in self._opened():
                    logger.picture(name, step, picture)
            write_picture(self.folder / f"{name}.png", picture)

    def history(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Write one line per epoch to ``history.csv``."""
        if not self.quiet and rows:
            header = list(dict.fromkeys(name for row in rows for name in row))
            write_rows(
                self.folder / "history.csv", header, [[row.get(name, "") for name in header] for row in rows]
            )

    def table(
        self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], core: Sequence[int] = ()
    ) -> None:
        """Print a table of the columns that fit, and the names of those that do not.

        Args:
            title: above it.
            columns: their titles. The first one's cells are wrapped where they must be; no other cell is.
            rows: cells.
            core: numbers of the columns that come before the others where there is not room for all.
        """
        cells = [[one_line(cell).replace(" ± ", "±") for cell in row] for row in (columns, *rows)]
        widths = [max(map(cell_len, column)) for column in zip(*cells, strict=True)]
        room = self.console.width
        widths[0] = min(widths[0], max(SHORTEST_NAME, room - sum(widths[place] + GAP for place in core)))
        kept = [0]
        for place in [*core, *(place for place in range(1, len(columns)) if place not in core)]:
            if sum(widths[other] + GAP for other in (*kept, place)) - GAP <= room:
                kept = sorted([*kept, place])
        self.console.print(one_line(title), highlight=False, markup=False, width=min(self.console.width, 120))
        table = Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False, collapse_padding=True)
        for place in kept:
            justify: Any = "right" if place else "left"
            table.add_column(  # escaped: rich would drop "[m]"
                escape(cells[0][place]), justify=justify, width=widths[place], overflow="fold"
            )
        for row in cells[1:]:
            table.add_row(*(escape(row[place]) for place in kept))
        self.console.print(table)
        if left_out := [title for place, title in enumerate(columns) if place not in kept]:
            self.say(f"no room for {', '.join(left_out)}: use a wider terminal, or the files")

    def bar(self, title: str, total: int, done: int = 0, unit: str = "img") -> AbstractContextManager[Bar]:
        """A progress bar over ``total`` images or other units (0: unknown), from ``done`` on."""
        return progress_bar(self.console, title, total, done, unit)

    def close(self) -> None:
        """Close the loggers."""
        with self._writing():
            for logger in self._open or ():
                logger.close()
        self._open = None

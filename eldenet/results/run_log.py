"""Output of a run for people: progress (a bar on a terminal, else lines), TensorBoard, images, tables."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from eldenet.system.files import write_rows

LINE_EVERY_S = 15.0


def untrained_note(source: str) -> str:
    """Return a note for the user on a network that was built by name, where trained weights are expected."""
    return f"note: {source} is a freshly initialized network, so its depth is meaningless"


class RunLog:
    """Console, TensorBoard and images of one run folder; ``quiet`` (other processes) writes nothing.

    Args:
        folder: of the run.
        quiet: for processes that are not the main one.
        first_step: of a resumed run: TensorBoard drops points from that step on, which a killed process left;
            None: it keeps all.
    """

    def __init__(self, folder: Path, *, quiet: bool = False, first_step: int | None = None) -> None:
        self.folder, self.quiet = folder, quiet
        self.console = Console(quiet=quiet)
        if not self.console.is_terminal:
            self.console.width = 200  # a file has no width; tables must not be cut off
        self._writer: Any = None
        self._first_step = first_step

    @property
    def writer(self) -> Any:
        """TensorBoard's writer, opened when first used."""
        if self._writer is None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(self.folder / "tensorboard"), purge_step=self._first_step)
        return self._writer

    def say(self, text: str) -> None:
        """Print one line unchanged: brackets are no markup, and long paths are not wrapped."""
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Write scalars under their names."""
        if not self.quiet:
            for name, value in values.items():
                self.writer.add_scalar(name, value, step)

    def picture(self, name: str, step: int, picture: np.ndarray) -> None:
        """Write ``(H, W, 3)`` uint8 to TensorBoard and to ``<folder>/<name>.png``."""
        if not self.quiet:
            from eldenet.visualization import write_picture

            self.writer.add_image(name, picture, step, dataformats="HWC")
            write_picture(self.folder / f"{name}.png", picture)

    def history(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Write one line per epoch to ``history.csv``."""
        if not self.quiet and rows:
            header = list(dict.fromkeys(name for row in rows for name in row))
            write_rows(
                self.folder / "history.csv", header, [[row.get(name, "") for name in header] for row in rows]
            )

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a table."""
        table = Table(title=escape(title), title_justify="left")  # escaped: rich would drop "[m]"
        for number, column in enumerate(columns):
            table.add_column(escape(column), justify="left" if number == 0 else "right")
        for row in rows:
            table.add_row(*map(escape, row))
        self.console.print(table)

    @contextmanager
    def bar(self, title: str, total: int, done: int = 0, unit: str = "img") -> Iterator["Bar"]:
        """A progress bar over ``total`` images or other units (0: unknown), from ``done`` on."""
        if self.quiet or not self.console.is_terminal:
            yield Bar(self, title, total, done, None, unit)
            return
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=self.console, transient=True) as progress:
            yield Bar(self, title, total, done, progress, unit)

    def close(self) -> None:
        """Close TensorBoard."""
        if self._writer is not None:
            self._writer.close()


class Bar:
    """Counts images or other units; shows their rate and a note."""

    def __init__(
        self, log: RunLog, title: str, total: int, done: int, progress: Progress | None, unit: str = "img"
    ) -> None:
        self.log, self.title, self.total, self.done, self.unit = log, title, total, done, unit
        self.progress = progress
        self.started = self.last_line = time.monotonic()
        self.first = done
        self.task = (
            None
            if progress is None
            else progress.add_task(title, total=total or None, completed=done, note="")
        )

    @property
    def rate(self) -> float:
        """Images per second since the bar began."""
        return (self.done - self.first) / max(time.monotonic() - self.started, 1e-9)

    def advance(self, images: int, note: str = "") -> None:
        """Count ``images`` more."""
        self.done += images
        digits = 0 if self.rate >= 10 else 2
        text = f"{self.rate:.{digits}f} {self.unit}/s  {note}"
        if self.progress is not None and self.task is not None:
            self.progress.update(self.task, completed=self.done, note=text)
        elif time.monotonic() - self.last_line > LINE_EVERY_S:
            self.last_line = time.monotonic()
            of, left = f"/{self.total}" if self.total else "", ""
            if self.total > self.done:  # 0 for a camera; a video's header may say too little
                left = f"  {(self.total - self.done) / max(self.rate, 1e-9):.0f} s left"
            self.log.say(f"{self.title}: {self.done}{of}  {text}{left}")

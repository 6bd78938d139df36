"""Output of a run for people: progress (a bar on a terminal, else lines), TensorBoard, images, tables."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from eldenet.system.disk import disk_errors
from eldenet.system.escaping import one_line
from eldenet.system.files import write_rows
from eldenet.system.progress import Bar, progress_bar


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
            with disk_errors(self.folder, "the log of TensorBoard"):
                for name, value in values.items():
                    self.writer.add_scalar(name, value, step)

    def picture(self, name: str, step: int, picture: np.ndarray) -> None:
        """Write ``(H, W, 3)`` uint8 to TensorBoard and to ``<folder>/<name>.png``."""
        if not self.quiet:
            from eldenet.visualization import write_picture

            with disk_errors(self.folder, "the log of TensorBoard"):
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
            table.add_row(*(escape(one_line(cell)) for cell in row))  # no terminal codes
        self.console.print(table)

    def bar(self, title: str, total: int, done: int = 0, unit: str = "img") -> AbstractContextManager[Bar]:
        """A progress bar over ``total`` images or other units (0: unknown), from ``done`` on."""
        return progress_bar(self.console, title, total, done, unit)

    def close(self) -> None:
        """Close TensorBoard."""
        if self._writer is not None:
            with disk_errors(self.folder, "the log of TensorBoard"):
                self._writer.close()

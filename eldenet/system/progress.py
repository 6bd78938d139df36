"""Progress for people: a bar on a terminal, elsewhere a line every 15 seconds."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

LINE_EVERY_S = 15.0


def open_console(*, quiet: bool = False, stderr: bool = False) -> Console:
    """A console that draws bars and bold letters on terminals alone.

    Rich would also draw them wherever FORCE_COLOR is set, as in a notebook, where a bar becomes many lines.
    """
    stream = sys.stderr if stderr else sys.stdout
    return Console(quiet=quiet, stderr=stderr, force_terminal=stream.isatty())


@contextmanager
def progress_bar(
    console: Console, title: str, total: int, done: int = 0, unit: str = "img"
) -> Iterator["Bar"]:
    """A progress bar over ``total`` images or other units (0: unknown), from ``done`` on."""
    bar = Bar(console, title, total, done, unit)
    if console.quiet or not console.is_terminal:
        yield bar
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(title, total=total or None, completed=done, note="")
        bar.show = lambda note: progress.update(task, completed=bar.done, note=note)
        yield bar


class Bar:
    """Counts images or other units; shows their rate and a note."""

    def __init__(self, console: Console, title: str, total: int, done: int, unit: str) -> None:
        self.console, self.title, self.total, self.done, self.unit = console, title, total, done, unit
        self.started = self.last_line = time.monotonic()
        self.first = done
        self.show: Callable[[str], None] = self._print_line

    @property
    def rate(self) -> float:
        """Images per second since the bar began."""
        return (self.done - self.first) / max(time.monotonic() - self.started, 1e-9)

    def advance(self, images: int, note: str = "") -> None:
        """Count ``images`` more."""
        self.done += images
        digits = 0 if self.rate >= 10 else 2
        self.show(f"{self.rate:.{digits}f} {self.unit}/s  {note}")

    def _print_line(self, text: str) -> None:
        if time.monotonic() - self.last_line > LINE_EVERY_S:
            self.last_line = time.monotonic()
            of, left = f"/{self.total}" if self.total else "", ""
            if self.total > self.done:  # 0 for a camera; a video's header may say too little
                left = f"  {(self.total - self.done) / max(self.rate, 1e-9):.0f} s left"
            line = f"{self.title}: {self.done}{of}  {text}{left}"
            self.console.print(line, highlight=False, markup=False, soft_wrap=True)

"""A bar is drawn for people alone."""

import io

import pytest
from rich.console import Console

from eldenet.system.progress import on_terminal, progress_bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_notebook_or_a_log_gets_no_bar_even_where_colors_are_forced(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as ipykernel and many CI services do
    console = Console(file=io.StringIO())
    with progress_bar(console, "epoch 1/3", 2) as bar:
        bar.advance(2)
    assert console.file.getvalue() == ""


def test_a_terminal_gets_one(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    console = Console(file=Terminal())
    assert on_terminal(console)
    with progress_bar(console, "epoch 1/3", 2) as bar:
        bar.advance(2)
    assert "epoch 1/3" in console.file.getvalue()

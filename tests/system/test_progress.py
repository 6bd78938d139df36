"""Bars are drawn for people alone."""

import io

import pytest

from eldenet.system.progress import open_console, progress_bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("stream", "drawn"), [(io.StringIO, False), (Terminal, True)])
def test_a_bar_is_drawn_on_a_terminal_alone(stream, drawn, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as notebooks and many CI services do
    monkeypatch.setenv("TERM", "xterm")
    written = stream()
    monkeypatch.setattr("sys.stdout", written)
    console = open_console()
    with progress_bar(console, "epoch 1/3", 2) as bar:
        bar.advance(2)
    assert ("epoch 1/3" in written.getvalue()) == drawn

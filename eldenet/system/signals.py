"""Stop on Ctrl-C or SIGTERM, once the current piece of work is finished."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Self

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # Ctrl-C, systemd or timeout, a closed connection


@contextmanager
def as_ctrl_c() -> Iterator[None]:
    """Within the block, SIGTERM raises ``KeyboardInterrupt`` as Ctrl-C does; in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class GracefulStop:
    """Context manager that turns signals into a flag; a second Ctrl-C interrupts at once.

    Signals that are ignored stay ignored (``nohup``). Outside the main thread, which alone receives signals,
    it does nothing.
    """

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None  # that arrived
        self.wake: Callable[[], None] = lambda: None  # called when it arrives, to end what waits
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (getattr(signal, name) for name in SIGNALS if hasattr(signal, name)):
                if signal.getsignal(number) not in (signal.SIG_IGN, None):
                    self._handlers[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if not self:
            self.signal = signal.Signals(number)
            self.wake()
        elif number == signal.SIGINT:  # a closing terminal sends the others twice
            raise KeyboardInterrupt

    def __bool__(self) -> bool:
        return self.signal is not None

    def __str__(self) -> str:
        """Return the signal's everyday name."""
        return "" if self.signal is None else {"SIGINT": "Ctrl-C"}.get(self.signal.name, self.signal.name)

    def obey(self) -> None:
        """End as the signal would have.

        Raises:
            KeyboardInterrupt: it was Ctrl-C.
            SystemExit: it was another signal, with the exit status 128 + its number.
        """
        if self.signal is signal.SIGINT:
            raise KeyboardInterrupt
        if self.signal is not None:
            raise SystemExit(128 + self.signal)

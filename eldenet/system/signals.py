"""Ctrl-C and a service manager's order to end, as a wish: what is in work is finished first."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # Ctrl-C, systemd or timeout, a connection that is gone


class StopWish:
    """Whether someone wants the work to end.

    Attributes:
        signal: by which it was said; None: nobody did.
        wake: is called at that moment, to end what waits.
    """

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        self.wake: Callable[[], None] = lambda: None

    def __bool__(self) -> bool:
        return self.signal is not None

    def __str__(self) -> str:
        """How a person calls it."""
        return "" if self.signal is None else {"SIGINT": "Ctrl-C"}.get(self.signal.name, self.signal.name)

    def obey(self) -> None:
        """End as the signal would have ended the work, now that it is in order.

        Raises:
            KeyboardInterrupt: it was Ctrl-C.
            SystemExit: it was another signal, of which the exit status tells.
        """
        if self.signal is signal.SIGINT:
            raise KeyboardInterrupt
        if self.signal is not None:
            raise SystemExit(128 + self.signal)


@contextmanager
def stop_wish() -> Iterator[StopWish]:
    """Take signals as a wish (in the main thread, where alone they come); a second Ctrl-C is an interrupt."""
    wish = StopWish()

    def ask(number: int, frame: FrameType | None) -> None:
        if not wish:
            wish.signal = signal.Signals(number)
            wish.wake()
        elif number == signal.SIGINT:  # of the others two come of themselves, as where a terminal is closed
            raise KeyboardInterrupt

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (getattr(signal, name) for name in SIGNALS if hasattr(signal, name)):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):  # nohup's choice stays
                before[number] = signal.signal(number, ask)
    try:
        yield wish
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

"""Standard output and error of a command: whatever they are connected to, and whatever a text holds."""

import logging
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from eldenet.system.escaping import one_line, without_password

TREE = "Expected tree:\n"  # of a data set, in lines


def printable(text: str) -> str:
    """Return a text as people may see it: without control characters of names, and without passwords.

    It is one line, but for the tree of a data set.
    """
    head, mark, tree = without_password(text).partition(TREE)
    return one_line(head) + mark + "\n".join(map(one_line, tree.split("\n")))


def print_note(text: str) -> None:
    """Print a line for people, beside what a command prints."""
    print(printable(text), file=sys.stderr)  # noqa: T201


def print_error(line: str) -> None:
    """Print what went wrong."""
    print_note(f"error: {line}")


@contextmanager
def terminal() -> Iterator[None]:
    """Let the block print on any terminal, file or pipe.

    What the encoding lacks is replaced. Without an output (``>&-``) nothing is printed. A reader that leaves
    (``| head``) ends the block quietly.

    Raises:
        SystemExit: the output cannot be written (a full disk), and one line says so; or Ctrl-C.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:  # else the next file that is opened would take its number
            stream = open(os.open(os.devnull, os.O_RDWR), "r" if number == 0 else "w")  # noqa: SIM115
            setattr(sys, name, stream)
        if number and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    warnings.formatwarning = lambda message, *where, **options: f"warning: {printable(str(message))}\n"
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        _drop_output()
    except OSError as error:
        _drop_output()
        print_error(f"standard output cannot be written ({error.strerror}): nothing more is printed")
        raise SystemExit(1) from None
    except BaseException as error:
        try:
            sys.stdout.flush()
        except OSError:
            _drop_output()
        if isinstance(error, KeyboardInterrupt):
            logging.disable()  # what libraries report as they end
            raise SystemExit(130) from None  # as shells count it
        raise


def _drop_output() -> None:
    """Send what is still to be printed nowhere: Python's last flush would fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def log_in_lines() -> None:
    """Let every message that is logged be one line."""
    for handler in logging.root.handlers:
        handler.addFilter(_as_line)


def _as_line(record: logging.LogRecord) -> bool:
    record.msg, record.args = printable(record.getMessage()), None
    return True

"""Attacks in processes of their own: a crash ends the process, a hang the time limit, nothing the campaign.

A further kind of file is one :class:`FileKind` in ``kinds.py``.
"""

import gc
import hashlib
import json
import logging
import os
import re
import resource
import select
import shutil
import signal
import sys
import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eldenet.system.errors import USER_ERRORS

CLEAR, UNHARMED, SILENT, RAW, HANG = CLASSES = ("clear", "unharmed", "silent", "raw", "hang")
SECONDS = 30.0  # for one attack; on a quiet machine none takes two
MEMORY = 6 << 30  # bytes of address space that an attack may take

Damage = Callable[[bytes, np.random.Generator], bytes]


@dataclass(frozen=True)
class FileKind:
    """A kind of file that eldenet reads.

    Attributes:
        name: in the table.
        file: that is damaged, relative to the folder.
        write: writes whole files into a folder.
        read: reads them as a user's command does; returns what it made of them.
        digest: whether the file carries or has beside it a checksum over all that is read.
        named: words of which a clear message contains one; the file's own name is always one.
    """

    name: str
    file: str
    write: Callable[[Path], object]
    read: Callable[[Path], Any]
    digest: bool = False
    named: tuple[str, ...] = ()


class Outcome(NamedTuple):
    """What happened: one of ``CLASSES``, and what was said."""

    what: str
    said: str


def flip(content: bytes, generator: np.random.Generator) -> bytes:
    """One bit, every second time in the first kilobyte, where headers are."""
    end = min(len(content), 1024) if generator.random() < 0.5 else len(content)
    at = int(generator.integers(end))
    return content[:at] + bytes([content[at] ^ 1 << int(generator.integers(8))]) + content[at + 1 :]


def cut(content: bytes, generator: np.random.Generator) -> bytes:
    """The first bytes alone, possibly none."""
    return content[: int(generator.integers(len(content)))]


def damages(flips: int, cuts: int) -> list[Damage]:
    return [flip] * flips + [cut] * cuts


def attack(kind: FileKind, folder: Path, how: Sequence[Damage]) -> list[Outcome]:
    """Damage the file in each of these ways, seeded by the kind's name and the number of the attack."""
    whole, work = folder / "whole", folder / "work"
    written = in_processes([lambda: str(kind.write(whole))])[0]
    if written.what in (RAW, HANG):
        raise RuntimeError(f"{kind.name} cannot be written: {written.said}")
    content = (whole / kind.file).read_bytes()

    def restore() -> None:
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(whole, work, symlinks=True)

    def whole_result() -> str:
        restore()
        return digest_of(kind.read(work))

    expected: list[str] = []  # each process reads the whole file once, before its first attack

    def one(number: int, damage: Damage) -> Outcome:
        if not expected:
            expected.append(whole_result())
        restore()
        generator = np.random.default_rng([zlib.crc32(kind.name.encode()), number])
        damaged = damage(content, generator)
        while damaged == content:  # a cut of no byte
            damaged = damage(content, generator)
        (work / kind.file).write_bytes(damaged)
        names = (Path(kind.file).name, Path(kind.file).stem, *kind.named)
        return judge(lambda: kind.read(work), names, expected[0])

    def read_whole() -> Outcome:
        expected.append(whole_result())
        same = whole_result() == expected[0]
        return Outcome(UNHARMED if same else SILENT, "the whole file, read twice")

    start, *outcomes = in_processes([read_whole, *(lambda n=n, d=d: one(n, d) for n, d in enumerate(how))])
    if start.what != UNHARMED:
        raise RuntimeError(f"{kind.name} cannot be read whole: {start.said}")
    return outcomes


def judge(read: Callable[[], Any], names: Sequence[str], expected: str | None) -> Outcome:
    """Class what ``read`` does; ``expected``: digest of the right result, None: any is harmless."""
    heard = _Heard()
    logging.getLogger("eldenet").addHandler(heard)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            result = read()
    except USER_ERRORS as error:  # those that a command shows in one line
        return Outcome(CLEAR if is_clear(str(error), names) else RAW, f"{type(error).__name__}: {error}")
    except SystemExit as end:
        return Outcome(CLEAR, f"exit {end.code}")
    except BaseException as error:
        return Outcome(RAW, f"{type(error).__name__}: {error}")
    finally:
        logging.getLogger("eldenet").removeHandler(heard)
    if expected is None or digest_of(result) == expected:
        return Outcome(UNHARMED, "")
    said = [*heard.lines, *(str(one.message) for one in warned)]
    named = next((line for line in said if is_clear(line, names)), None)
    return Outcome(SILENT, "; ".join(said)) if named is None else Outcome(CLEAR, named)


def is_clear(message: str, names: Sequence[str]) -> bool:
    """Whether a message names the file and is no listing or traceback."""
    return any(name in message for name in names) and len(message) < 2000 and "Traceback" not in message


class _Heard(logging.Handler):
    """The warnings that a user would see."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def digest_of(result: Any) -> str:
    """Check sum of arrays, tensors and plain values, nested in any way."""
    digest = hashlib.sha256()

    def add(value: Any) -> None:
        if hasattr(value, "detach"):
            value = value.detach().cpu().float().numpy()
        if isinstance(value, np.ndarray) and value.dtype != object:
            digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
        elif isinstance(value, Mapping):
            for key, item in value.items():
                digest.update(repr(key).encode())
                add(item)
        elif is_dataclass(value) and not isinstance(value, type):
            add({field.name: getattr(value, field.name) for field in fields(value)})
        elif isinstance(value, list | tuple | np.ndarray):
            digest.update(b"[%d" % len(value))
            for item in value:
                add(item)
        else:
            digest.update(re.sub(r" at 0x\w+", "", repr(value)).encode())

    add(result)
    return digest.hexdigest()


# --- processes ----------------------------------------------------------------------------------------------


def in_processes(jobs: Sequence[Callable[[], Any]], seconds: float = SECONDS) -> list[Outcome]:
    """Outcome of each job, in order: in one forked process, and in another one after each crash or hang.

    A job may return anything; what is no :class:`Outcome` is unharmed.
    """
    outcomes: list[Outcome] = []
    while len(outcomes) < len(jobs):
        outcomes += _until_one_ends_it(jobs[len(outcomes) :], seconds)
    return outcomes


def _until_one_ends_it(jobs: Sequence[Callable[[], Any]], seconds: float) -> list[Outcome]:
    sys.stdout.flush()
    sys.stderr.flush()
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        _work(jobs, writing)
    os.close(writing)
    outcomes, end, buffer = [], None, b""
    while len(outcomes) < len(jobs) and end is None:
        if not select.select([reading], [], [], seconds)[0]:
            end = Outcome(HANG, f"took more than {seconds:g} s")
        elif block := os.read(reading, 1 << 16):
            *lines, buffer = (buffer + block).split(b"\n")
            outcomes += [Outcome(*json.loads(line)) for line in lines]
        else:
            end = Outcome(RAW, "")
    os.close(reading)
    if len(outcomes) < len(jobs) and end is not None and end.what == HANG:
        os.killpg(child, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if len(outcomes) < len(jobs) and end is not None:
        outcomes.append(end if end.what == HANG else Outcome(RAW, f"the process ended with {status}"))
    return outcomes


def _work(jobs: Sequence[Callable[[], Any]], writing: int) -> None:
    """Do the jobs in this process and write an outcome for each; never returns."""
    os.setsid()
    quiet = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(quiet, number)
    _limit_memory()
    gc.freeze()
    for job in jobs:
        try:
            found = job()
        except BaseException as error:
            found = Outcome(RAW, f"{type(error).__name__}: {error}")
        outcome = found if isinstance(found, Outcome) else Outcome(UNHARMED, str(found))
        text = json.dumps([outcome.what, outcome.said[:2000]])
        os.write(writing, text.encode() + b"\n")
    os._exit(0)


def _limit_memory() -> None:
    """Let a bomb end in MemoryError instead of taking the machine."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))

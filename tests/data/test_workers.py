"""Workers on systems that lack what Linux has: they start, and end when their trainer says so."""

import signal
import time
from multiprocessing import get_context
from multiprocessing.connection import Connection

import pytest

from eldenet.data import workers
from eldenet.data.workers import prepare_worker, worker_options


def test_windows_starts_each_worker_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "get_all_start_methods", lambda: ["spawn"])
    assert worker_options(1)["multiprocessing_context"].get_start_method() == "spawn"


def test_on_macos_a_worker_ends_when_its_trainer_terminates_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(signal, "sigtimedwait")
    context = get_context("fork")
    here, there = context.Pipe()
    worker = context.Process(target=work, args=(there,))
    worker.start()
    here.recv()
    worker.terminate()  # as Python does at its end, and then it waits
    worker.join(10)
    ended = worker.exitcode
    worker.kill()
    assert ended is not None


def work(ready: Connection) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})  # as the server leaves them
    prepare_worker(0)
    ready.send(True)
    time.sleep(60)

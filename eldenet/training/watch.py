"""Several processes: each notices when another one is gone or hangs, and ends."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eldenet.system.resources import Resources

PERIOD = 1.0  # [s] between two calls of the roll
GRACE = 5.0  # [s] in which the watch finds the process that broke the training's own messages
LONGEST_WAIT = timedelta(days=2)  # of the training's own messages: the first process may render for hours


@contextmanager
def watched_processes(resources: "Resources", seconds: float) -> Iterator[None]:
    """End this process, with one line, once another one of the job has not answered for ``seconds``.

    A thread of every process takes part in a sum over all of them, again and again. So a process may
    compute, load or render for as long as it likes; one that was killed or stopped, or whose machine is
    gone, does not answer. Alone, a process is not watched.
    """
    if resources.processes == 1:
        yield
        return
    from accelerate import PartialState
    from accelerate.state import AcceleratorState

    AcceleratorState._reset_state(reset_partial_state=True)  # an earlier run of this process chose its own
    PartialState(cpu=resources.device == "cpu", timeout=LONGEST_WAIT)
    watch = _Watch(resources.processes, seconds)
    watch.start()
    try:
        yield
    except RuntimeError:  # of a message to a process that is gone, if the watch says so
        watch.join(GRACE)
        raise
    watch.ends.set()
    watch.join()  # once all of them are here


class _Watch(threading.Thread):
    """Calls the roll.

    Args:
        processes: their number.
        seconds: to wait for an answer.

    Attributes:
        ends: set where this process needs the others no more; the thread ends when all of them are there.
    """

    def __init__(self, processes: int, seconds: float) -> None:
        from torch import distributed

        super().__init__(daemon=True)
        self.processes, self.seconds, self.ends = processes, seconds, threading.Event()
        # a group of its own, on the CPU: it waits for nothing that the training sends
        self.group: Any = distributed.new_group(backend="gloo", timeout=timedelta(seconds=seconds))

    def run(self) -> None:
        import torch
        from torch import distributed

        try:
            while True:
                at_end = torch.tensor(int(self.ends.is_set()))
                distributed.all_reduce(at_end, group=self.group)
                if at_end == self.processes:
                    return
                self.ends.wait(PERIOD)
        except RuntimeError:
            print(  # noqa: T201
                f"error: another of the {self.processes} processes has ended, or has not responded for "
                f"process_timeout={self.seconds:g} s. The last checkpoint is complete: run the same "
                "command again "
                "with ckpt_path=auto",
                file=sys.stderr,
                flush=True,
            )
            os._exit(1)  # the main thread waits for a message that never comes

"""Two processes of one group, forked from a server that holds torch."""

import os
import socket
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import NamedTuple


class Rank(NamedTuple):
    """A process, the pipe to it, and the file of what it writes to standard error."""

    process: BaseProcess
    pipe: Connection
    errors: Path


def start_ranks(folder: Path, *, seconds: float, waiting: int) -> list[Rank]:
    """Start two processes that wait ``seconds`` for each other; rank ``waiting`` waits for a message."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    context = get_context("forkserver")
    context.set_forkserver_preload(["torch.distributed", "accelerate"])
    ranks = []
    for number in range(2):
        ours, theirs = context.Pipe()
        errors = folder / f"errors-{number}"
        process = context.Process(
            target=_watched, args=(number, port, seconds, number == waiting, theirs, errors), daemon=True
        )
        process.start()
        ranks.append(Rank(process, ours, errors))
    return ranks


def _watched(number: int, port: int, seconds: float, waits: bool, pipe: Connection, errors: Path) -> None:
    os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT), 2)
    os.environ |= {"RANK": str(number), "LOCAL_RANK": str(number), "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2"}
    os.environ |= {"MASTER_ADDR": "localhost", "MASTER_PORT": str(port)}
    from torch import distributed

    from eldenet.system.resources import Resources, join_processes

    join_processes(Resources("cpu", "fp32", 1, 0, 1, processes=2), seconds)
    distributed.barrier()
    pipe.send(os.getpid())
    if waits:
        pipe.recv()
    distributed.barrier()
    distributed.destroy_process_group()

"""Processes that load data: they fork from a server that has done the imports, and end with their trainer."""

import os
import signal
import threading
from multiprocessing import get_all_start_methods, get_context, parent_process
from typing import TYPE_CHECKING, Any

from eldenet.system.resources import prepare_environment
from eldenet.system.signals import SIGNALS

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext

#: The last one for commands: a worker imports its trainer's main module anew.
PRELOADED = ("torch", "cv2", "albumentations", "eldenet.data.loaders", "eldenet.cli.entry_point")


def start_server() -> "ForkServerContext | SpawnContext":
    """Start the server of this process, unless it runs; its imports take seconds, in the background.

    Windows has no such server: each worker starts anew there.

    ``timeout``, SLURM and Ctrl-C signal the whole process group. That is for the trainer alone to answer, so
    the server and its workers are born with these signals blocked.
    """
    prepare_environment()  # the server inherits it
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    from multiprocessing import forkserver, resource_tracker

    context = get_context("forkserver")
    context.set_forkserver_preload(["__main__", *PRELOADED])
    resource_tracker.ensure_running()  # it would unblock the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {getattr(signal, name) for name in SIGNALS})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return context


def worker_options(workers: int) -> dict[str, Any]:
    """Return a loader's options for ``workers`` processes, which end with the loader."""
    import torch

    # without a generator, the start of each epoch would draw from torch's global one
    options: dict[str, Any] = {"generator": torch.Generator(), "num_workers": workers}
    if workers:
        options |= {"persistent_workers": True, "worker_init_fn": prepare_worker}
        options |= {"multiprocessing_context": start_server()}
    return options


def prepare_worker(_: int) -> None:
    """Limit a worker to one thread, which counts as its core, and let it end with its trainer."""
    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows cannot block it
    if not hasattr(signal, "sigtimedwait") and hasattr(os, "setpgid"):  # macOS
        os.setpgid(0, 0)  # signals to the group are for the trainer; its own to this worker pass
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    threading.Thread(target=_end_with_trainer, daemon=True).start()


def _end_with_trainer() -> None:
    """End this worker once the trainer is gone or terminates it; drop the signals of others."""
    trainer = parent_process()
    assert trainer is not None
    if not hasattr(signal, "sigtimedwait"):  # macOS, Windows
        trainer.join()
    while trainer.is_alive():
        received = signal.sigtimedwait([signal.SIGTERM], 0.5)
        if received is not None and received.si_pid == trainer.pid:
            break
    os._exit(1)

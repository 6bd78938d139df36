"""Threads, workers, device and precision: chosen once, before a run starts, and recorded."""

import math
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from eldenet.system.checks import one_of

MOST = 1024  # threads, or workers
CGROUP = Path("/sys/fs/cgroup")
LONGEST_WAIT = timedelta(days=2)  # for the process that prepares data: it may render for hours


def prepare_environment() -> None:
    """Set what torch and albumentations read while they load; call it before they are imported.

    Two OpenMP threads that spin while another process wants their core slow each other down more than
    tenfold; threads that wait passively keep three quarters of the speed. cuBLAS repeats its results only
    with this workspace, and torch warns without it. Albumentations would ask the network for a newer version.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")


def available_cores() -> int:
    """Return the number of cores this process may use, at most its container's quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota, _, period = _cgroup("cpu.max").partition(" ")
    return min(cores, max(1, math.ceil(int(quota) / int(period)))) if quota.isdigit() else cores


def available_memory() -> int:
    """Return the bytes of memory that are still free on this machine or in this container."""
    import psutil

    free: int = psutil.virtual_memory().available
    most = _cgroup("memory.max")
    if not most.isdigit():
        return free
    stat = dict(line.split() for line in _cgroup("memory.stat").splitlines())
    # the cache of inactive files is freed when memory is needed
    used = int(_cgroup("memory.current") or 0) - int(stat.get("inactive_file", 0))
    return min(free, max(0, int(most) - used))


def _cgroup(name: str) -> str:
    """Return a file of this container's control group (version 2), "" if there is none."""
    file = CGROUP / name
    return file.read_text().strip() if file.is_file() else ""


@dataclass(frozen=True)
class Resources:
    """What a run computes with. ``threads + workers <= cores`` on a CPU.

    All but ``processes``, the number that ``torchrun`` or ``accelerate launch`` started, is per process.
    """

    device: str
    precision: str
    threads: int
    workers: int
    cores: int
    processes: int = 1


def choose_resources(
    *,
    device: str = "auto",
    precision: str = "auto",
    threads: int | str = "auto",
    workers: int | str = "auto",
    for_torch: bool = True,
) -> Resources:
    """Resolve "auto" into what this machine does best, and apply the thread count and :func:`full_fp32`.

    Args:
        device: "auto", "cpu" or "cuda".
        precision: "auto", "fp32", "bf16" or "fp16"; auto takes bf16 where the hardware multiplies it.
        threads: of torch in this process, or "auto".
        workers: processes that load data, or "auto".
        for_torch: False where another runtime computes: torch is not loaded, a device "auto" is the CPU, and
            the runtime itself checks any other.

    Raises:
        ValueError: an unknown choice, or one that this machine doesn't support.

    Warns:
        UserWarning: more threads and workers than cores on a CPU.
    """
    for name, count, least in (("threads", threads, 1), ("workers", workers, 0)):
        if count != "auto" and not (type(count) is int and least <= count <= MOST):
            raise ValueError(f"runtime.{name}={count}: give a whole number from {least} to {MOST}, or auto")
    one_of("device", device, ("auto", "cpu", "cuda"))
    if for_torch:
        import torch

        if device == "auto":
            device = "cuda" if torch.cuda.is_available() else "cpu"
        check_torch_device(device)
    elif device == "auto":
        device = "cpu"
    # processes of one machine (torchrun, accelerate launch) share its cores
    cores = max(1, available_cores() // int(os.environ.get("LOCAL_WORLD_SIZE", "1")))
    if threads == "auto":
        # half of them: while a machine is idle a second thread gives a small network a quarter more
        # (experiments/training_speed), and it costs most of the speed once anything else wants a core
        half = min(2, cores // 2) if device == "cuda" else cores // 2  # beside a GPU, workers need the cores
        threads = max(1, half if workers == "auto" else cores - int(workers))
    threads = int(threads)
    workers = max(0, cores - threads) if workers == "auto" else int(workers)
    if device == "cpu" and threads + workers > cores:
        warnings.warn(
            f"threads={threads} + workers={workers} exceed the {cores} cores: they take turns and slow each "
            "other down; lower one, or leave both on auto",
            stacklevel=2,
        )
    if not for_torch:
        return Resources(device, "fp32", threads, workers, cores, number_of_processes())
    torch.set_num_threads(threads)
    full_fp32()
    precision = resolve_precision(precision, device)
    return Resources(device, precision, threads, workers, cores, number_of_processes())


def check_torch_device(device: str) -> None:
    """Raise ValueError unless torch can compute on ``device`` here, "cpu" or "cuda"."""
    import torch

    one_of("device", device, ("cpu", "cuda"))
    if device == "cuda" and not torch.cuda.is_available():
        raise ValueError("device=cuda, but torch sees no CUDA device: use device=cpu")


def full_fp32() -> None:
    """Turn TF32 off in this process: on CUDA torch's convolutions round to its ten bits by default."""
    import torch

    with warnings.catch_warnings():
        # from 2.9 on torch wants its newer switches, which leave this one, and what reads it, in disagreement
        warnings.filterwarnings("ignore", message=".*TF32")
        torch.backends.cudnn.allow_tf32 = False


def resolve_precision(precision: str, device: str) -> str:
    """Resolve "auto" into fp32, bf16 or fp16; refuse what the device doesn't support."""
    import torch

    one_of("precision", precision, ("auto", "fp32", "bf16", "fp16"))
    if precision == "fp16" and device == "cpu":
        raise ValueError("precision=fp16 trains on CUDA only: on a CPU use bf16, fp32 or auto")
    if precision != "auto":
        return precision
    if device == "cuda":
        return "bf16" if torch.cuda.is_bf16_supported() else "fp16"
    multiplies_bf16 = torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    return "bf16" if multiplies_bf16 else "fp32"


def make_accelerator(resources: Resources) -> Any:
    """Accelerate's device, autocast and DDP for these resources."""
    from accelerate import Accelerator
    from accelerate.state import AcceleratorState

    AcceleratorState._reset_state(reset_partial_state=True)  # an earlier run of this process chose its own
    precision = {"fp32": "no"}.get(resources.precision, resources.precision)
    return Accelerator(mixed_precision=precision, cpu=resources.device == "cpu")


def number_of_processes() -> int:
    """Return how many processes ``torchrun`` or ``accelerate launch`` started for this job."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def is_main_process() -> bool:
    """Whether this process speaks and writes, of those that ``torchrun`` or ``accelerate launch`` started."""
    return os.environ.get("RANK", "0") == "0"


def join_processes(resources: Resources, seconds: float) -> None:
    """Let the processes of a job find each other; a message that waits longer than ``seconds`` is an error.

    So a process ends where another one hangs. Where one was killed, the next message fails at once, and
    ``torchrun`` ends the others sooner than that.
    """
    if resources.processes == 1:
        return
    from accelerate import PartialState
    from accelerate.state import AcceleratorState

    AcceleratorState._reset_state(reset_partial_state=True)  # an earlier run of this process chose its own
    PartialState(cpu=resources.device == "cpu", timeout=timedelta(seconds=seconds))


@contextmanager
def main_process_first(resources: Resources) -> Iterator[None]:
    """Run the block in a job's main process first, then in one per machine, then in the others.

    So files that the block prepares (rendered frames, an index, a download) are prepared once. The others
    wait up to :data:`LONGEST_WAIT`.
    """
    if number_of_processes() == 1:
        yield
        return
    from accelerate import PartialState
    from torch import distributed

    state = PartialState(cpu=resources.device == "cpu")
    group: Any = distributed.new_group(backend="gloo", timeout=LONGEST_WAIT)
    turn = 0 if state.is_main_process else 1 if state.is_local_main_process else 2
    for _ in range(turn):
        distributed.barrier(group)
    yield
    for _ in range(turn, 2):
        distributed.barrier(group)


def seed_everything(seed: int) -> None:
    """Seed Python, numpy and torch; ask for repeatable algorithms."""
    import random

    import numpy as np
    import torch

    random.seed(seed)
    np.random.seed(seed % 2**32)
    torch.manual_seed(seed)
    repeatable(True)


def repeatable(on: bool) -> None:
    """Ask torch for the same result each time, or for the fastest kernels."""
    import torch

    torch.backends.cudnn.benchmark = not on
    torch.use_deterministic_algorithms(on, warn_only=True)

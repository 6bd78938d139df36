"""Latency of many networks under many runtimes, in interleaved rounds, so that ratios can be trusted.

:func:`~eldenet.system.timing.time_interleaved` times the calls, and warms each up at the start of its turn.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from eldenet.deploy import runtimes
from eldenet.deploy.benchmarking.rows import COLUMNS
from eldenet.deploy.metadata import files_of
from eldenet.system.timing import Waiting, median_ms, percentile_ms, time_interleaved

PEAK_SIDE = 1024  # of the square matrices whose product gives the peak
PEAK_DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}


@dataclass(frozen=True)
class Case:
    """One row to measure, by what identifies it."""

    model: str
    height: int
    width: int
    batch: int
    runtime: str
    precision: str
    threads: int
    device: str

    @property
    def key(self) -> tuple[Any, ...]:
        """Columns that identify a row."""
        return tuple(asdict(self).values())

    @property
    def group(self) -> tuple[Any, ...]:
        """Group whose cases are measured in turns; ratios are taken within it."""
        return (self.height, self.width, self.batch, self.runtime, self.threads, self.device)


@dataclass(frozen=True)
class Network:
    """What a case runs, and what is known without running it.

    Attributes:
        source: file or folder for :func:`eldenet.deploy.runtimes.load`; None: the export failed.
        params: number of parameters.
        macs: multiply-adds of one image by the network as defined.
        run_macs: multiply-adds of its folded form, which runs; the FLOP/s are counted in these.
        failed: why the export failed.
    """

    source: Path | None
    params: int | None = None
    macs: int | None = None
    run_macs: int | None = None
    failed: str | None = None


def measure_group(
    cases: Sequence[Case],
    networks: Mapping[Case, Network],
    *,
    reference: str,
    rounds: int = 7,
    seconds: float = 0.2,
    memory: bool = True,
    trusted_modules: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Measure the cases of one group in interleaved rounds, along with the machine's matrix product.

    Args:
        cases: of one runtime, thread count and device; in a study each model may have its own input.
        networks: what each case runs.
        reference: model whose fp32 row has ``ratio_latency`` 1.
        rounds: turns of each case.
        seconds: of each turn.
        memory: measure each case's memory, in a separate process.
        trusted_modules: packages whose classes a model folder's config may name.

    Returns:
        One row per case: the columns, and "failed" (a reason, or None), "peak_gflops_per_s", and "waiting":
        on a CPU, time on the clock over that of the processors while the group was timed.
    """
    ready, rows = {}, {}
    for case in cases:
        network = networks[case]
        rows[case] = {**dict.fromkeys(COLUMNS), **asdict(case), **static_columns(network)}
        rows[case] |= {"failed": network.failed, "peak_gflops_per_s": None, "waiting": None}
        if network.source is not None:
            try:
                loaded = _load(case, network.source, trusted_modules)
                if loaded.device != case.device:
                    rows[case]["device"] = f"{case.device} ({loaded.device})"
                ready[case] = call_of(loaded, _images(case))
            except Exception as error:  # a failure is the row's result
                rows[case]["failed"] = reason_of(error)
    if not ready:
        return list(rows.values())
    peaks = {f"peak {name}": peak_call(cases[0], name) for name in _peak_precisions(ready)}
    calls = {**{str(case.key): call for case, call in ready.items()}, **peaks}
    with Waiting() as waiting:
        times = time_interleaved(calls, rounds=rounds, seconds=seconds)
    for case in ready:
        network, peak = networks[case], times.get(f"peak {case.precision}")
        row = rows[case] | timed_columns(case, times[str(case.key)], network.run_macs)
        row["waiting"] = waiting.ratio if case.device == "cpu" else None
        if peak is not None and row["gflops_per_s"] is not None:
            row["peak_gflops_per_s"] = 2 * PEAK_SIDE**3 / min(peak) / 1e9  # the best call
            row["share_of_peak"] = row["gflops_per_s"] / row["peak_gflops_per_s"]
        if memory and network.source is not None:
            row["peak_memory_mb"] = memory_of(case, network.source, trusted_modules)
        rows[case] = row
    base = next((rows[case] for case in ready if (case.model, case.precision) == (reference, "fp32")), None)
    for case in ready if base is not None else ():
        rows[case]["ratio_latency"] = rows[case]["latency_ms_p50"] / base["latency_ms_p50"]  # type: ignore[index]
    return list(rows.values())


def reason_of(error: Exception) -> str:
    """One line about an error, for the table."""
    lines = str(error).splitlines() or [""]
    return lines[0] if isinstance(error, ValueError | ImportError) else f"{type(error).__name__}: {lines[0]}"


def static_columns(network: Network) -> dict[str, Any]:
    """Columns that are known without running."""
    macs = network.macs
    return {
        "params": network.params,
        "gmacs": None if macs is None else macs / 1e9,
        "gflops": None if macs is None else 2 * macs / 1e9,
        "file_mb": None if network.source is None else _megabytes(network.source),
    }


def timed_columns(case: Case, times: Sequence[float], macs: int | None) -> dict[str, Any]:
    """Columns from the times of one call [s]; ``fps`` counts calls, ``throughput_img_s`` images."""
    median = median_ms(times)
    return {
        "latency_ms_p50": median,
        "latency_ms_p95": percentile_ms(times, 95),
        "fps": 1e3 / median,
        "throughput_img_s": 1e3 * case.batch / median,
        "gflops_per_s": None if macs is None else 2 * macs * case.batch / median / 1e6,
    }


def call_of(network: runtimes.Runtime, images: np.ndarray) -> Callable[[], None]:
    """The call to time, after a first run that shows that it works and triggers compilation."""
    inputs = network.prepared(images)

    def call() -> None:
        network.run_prepared(inputs)
        network.synchronize()

    call()
    return call


def _load(case: Case, source: Path, trusted_modules: Sequence[str]) -> runtimes.Runtime:
    return runtimes.load(
        source,
        case.runtime,
        case.precision,
        threads=case.threads,
        device=case.device,
        trusted_modules=trusted_modules,
    )


def _images(case: Case) -> np.ndarray:
    shape = (case.batch, 3, case.height, case.width)
    return np.random.default_rng(0).random(shape, dtype=np.float32)


def _peak_precisions(cases: Mapping[Case, Any]) -> list[str]:
    """Precisions whose peak torch can measure; none on devices that torch does not support."""
    device = next(iter(cases)).device
    if device != "cpu" and not (device in ("cuda", "tensorrt") and torch.cuda.is_available()):
        return []
    return [name for name in PEAK_DTYPES if any(case.precision == name for case in cases)]


def peak_call(case: Case, precision: str) -> Callable[[], None]:
    """The call that gives the peak: a product of square matrices on the case's device, with its threads."""
    target = torch.device("cuda" if case.device in ("cuda", "tensorrt") else "cpu")
    left, right = (torch.rand(PEAK_SIDE, PEAK_SIDE).to(target, PEAK_DTYPES[precision]) for _ in range(2))

    def call() -> None:
        if target.type == "cpu":
            torch.set_num_threads(case.threads)
        torch.matmul(left, right)
        if target.type == "cuda":
            torch.cuda.synchronize()

    return call


def _megabytes(source: Path) -> float:
    if source.is_dir():
        return sum(file.stat().st_size for file in source.rglob("*.safetensors")) / 1e6
    return sum(file.stat().st_size for file in files_of(source)) / 1e6


# --- memory -------------------------------------------------------------------------------------------------


def memory_of(case: Case, source: Path, trusted_modules: Sequence[str] = ()) -> float | None:
    """Peak memory that loading and running a case adds to a fresh process that has imported torch [MB].

    On CUDA the device's memory. None where it cannot be measured (it needs Linux).
    """
    module = "eldenet.deploy.benchmarking.measure"
    code = f"import sys; from {module} import print_memory; print_memory(*sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(asdict(case)), str(source), *trusted_modules],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": str(case.threads)},
    )
    return float(done.stdout.split()[-1]) if done.returncode == 0 else None


def print_memory(case: str, source: str, *trusted_modules: str) -> None:
    """Print the memory of this process, which :func:`memory_of` has started."""
    this = Case(**json.loads(case))
    cuda = this.device in ("cuda", "tensorrt")
    images = _images(this)
    before = torch.cuda.mem_get_info()[0] if cuda else _resident_kib("VmRSS")
    network = _load(this, Path(source), trusted_modules)
    for _ in range(3):
        network.run(images)
    if cuda:
        print((before - torch.cuda.mem_get_info()[0]) / 1e6)  # noqa: T201
    else:
        print((_resident_kib("VmHWM") - before) * 1024 / 1e6)  # noqa: T201


def _resident_kib(kind: str) -> int:
    """Memory of this process now ("VmRSS") or at its peak ("VmHWM") on Linux.

    A child process inherits its parent's ``ru_maxrss``, so that is no use here.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(kind))

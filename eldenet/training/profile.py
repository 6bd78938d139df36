"""Where the time of a training goes: a table of its parts, and a trace of a few steps."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

PARTS = ("data", "forward", "loss", "backward", "optimizer", "validation")
ON_HOST = ("data", "validation")
TRACE = "trace.json"
SKIPPED, TRACED = 4, 4  # steps before the trace, and in it


class Profile:
    """Times the parts of a training; the trace opens in Perfetto or ``chrome://tracing``.

    On a GPU a part of the step lasts from when the GPU reaches its first kernel until it has finished its
    last one. Where the GPU waits for the host in between, that counts too. Nothing waits for the GPU.

    Args:
        folder: of the run, which gets ``trace.json``.
    """

    def __init__(self, folder: Path, device: torch.device) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self.steps, self.started = 0, time.perf_counter()
        self._on_gpu = device.type == "cuda"
        self._spans: list[tuple[str, torch.cuda.Event, torch.cuda.Event]] = []
        os.environ.setdefault("KINETO_LOG_LEVEL", "5")  # it prints its own start and stop
        kinds = torch.profiler.ProfilerActivity
        self._trace = torch.profiler.profile(
            activities=[kinds.CPU, kinds.CUDA] if self._on_gpu else [kinds.CPU],
            schedule=torch.profiler.schedule(wait=SKIPPED - 1, warmup=1, active=TRACED, repeat=1),
            on_trace_ready=lambda trace: trace.export_chrome_trace(str(folder / TRACE)),
        )
        self._trace.start()

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Time the block as one of :data:`PARTS`."""
        with torch.profiler.record_function(name):
            if not self._on_gpu or name in ON_HOST:
                started = time.perf_counter()
                yield
                self.seconds[name] += time.perf_counter() - started
            else:
                first, last = (torch.cuda.Event(enable_timing=True) for _ in range(2))
                first.record()
                yield
                last.record()
                self._spans.append((name, first, last))

    def step(self) -> None:
        """Count a step."""
        self.steps += 1
        self._trace.step()

    def close(self) -> list[tuple[str, str, str, str]]:
        """End the trace; return rows of the table: part, seconds, share of the whole, milliseconds a step."""
        for name, first, last in self._spans:
            last.synchronize()
            self.seconds[name] += first.elapsed_time(last) / 1000
        self._trace.stop()
        whole = time.perf_counter() - self.started
        rows = [*self.seconds.items(), ("everything", whole)]
        return [
            (name, f"{s:.2f}", f"{100 * s / whole:.0f} %", f"{1000 * s / max(1, self.steps):.1f}")
            for name, s in rows
        ]

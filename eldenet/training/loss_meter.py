"""Sums of an epoch's losses and of the time spent waiting for data; a loss that is not finite raises."""

import math
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import torch
from torch import Tensor

from eldenet.training.checkpoint import Progress

BLANK = "batches without a known pixel"  # counted among the sums
READ_EVERY = 10  # batches between two copies of what an accelerator has computed


def timed(batches: Iterable[dict[str, Any]], progress: Progress) -> Iterator[dict[str, Any]]:
    """Yield the batches; add the time spent waiting for each to ``progress.waited``."""
    started = time.monotonic()
    for batch in batches:
        progress.waited += time.monotonic() - started
        yield batch
        started = time.monotonic()


class LossMeter:
    """Sums of named loss terms.

    The values of an accelerator are copied to the host while it computes on. They are added up when the next
    ones are copied, so neither waits for the other.

    Args:
        sums: name -> sum; part of the checkpoint.
        eager: read every step's values at once (free on a CPU; an accelerator would have to wait).
    """

    def __init__(self, sums: dict[str, float], *, eager: bool) -> None:
        self.sums, self.eager = sums, eager
        self._waiting: list[tuple[int, tuple[str, ...], Tensor]] = []
        self._sent: list[tuple[int, tuple[str, ...]]] = []
        self._copy: Tensor = torch.empty(0)  # of the values of those sent, one after the other
        self._done: torch.cuda.Event | None = None

    @property
    def unread(self) -> int:
        """Batches that are not in the sums yet."""
        return len(self._waiting) + len(self._sent)

    def add(self, step: int, terms: Mapping[str, Tensor]) -> None:
        """Add the terms of one batch of update ``step``."""
        values = torch.stack([value.float() for value in terms.values()])
        self._waiting.append((step, tuple(terms), values))
        if self.eager:
            self.read()
        elif len(self._waiting) >= READ_EVERY:
            self._take()
            self._send()

    def read(self) -> None:
        """Add up the terms that were not read yet.

        Raises:
            FloatingPointError: a term is NaN or infinite; names the term and the step.
        """
        self._take()
        self._send()
        self._take()

    def _send(self) -> None:
        """Start to copy what waits to the host."""
        if not self._waiting:
            return
        values = torch.cat([values for _, _, values in self._waiting])
        self._copy = values.to("cpu", non_blocking=True)  # into pinned memory
        if values.is_cuda:
            self._done = torch.cuda.Event()
            self._done.record()
        self._sent = [(step, names) for step, names, _ in self._waiting]
        self._waiting.clear()

    def _take(self) -> None:
        """Add up what was sent."""
        if self._done is not None:
            self._done.synchronize()
        numbers = iter(self._copy.tolist())
        for step, names in self._sent:
            for name, number in zip(names, numbers, strict=False):
                if not math.isfinite(number):
                    raise FloatingPointError(
                        f"loss term '{name}' is {number} at step {step}. Try a lower optimizer.lr, "
                        "trainer.max_grad_norm=1, or runtime.precision=fp32. The last good state, if any, is "
                        "checkpoints/last.pt in the run folder"
                    )
                self.sums[name] = self.sums.get(name, 0.0) + number
        self._sent, self._copy = [], torch.empty(0)

"""Sums of an epoch's losses and of the time spent waiting for data; a loss that is not finite raises."""

import math
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from torch import Tensor

from eldenet.training.checkpoint import Progress

BLANK = "batches without a known pixel"  # counted among the sums
READ_EVERY = 10  # steps: each read makes the host wait for an accelerator


def timed(batches: Iterable[dict[str, Any]], progress: Progress) -> Iterator[dict[str, Any]]:
    """Yield the batches; add the time spent waiting for each to ``progress.waited``."""
    started = time.monotonic()
    for batch in batches:
        progress.waited += time.monotonic() - started
        yield batch
        started = time.monotonic()


class LossMeter:
    """Sums of named loss terms.

    Args:
        sums: name -> sum; part of the checkpoint.
        eager: read every step's values at once (free on a CPU; an accelerator would have to wait).
    """

    def __init__(self, sums: dict[str, float], *, eager: bool) -> None:
        self.sums, self.eager = sums, eager
        self.waiting: list[tuple[int, Mapping[str, Tensor]]] = []

    def add(self, step: int, terms: Mapping[str, Tensor]) -> None:
        """Add the terms of one batch of update ``step``."""
        self.waiting.append((step, terms))
        if self.eager or len(self.waiting) >= READ_EVERY:
            self.read()

    def read(self) -> None:
        """Add up the terms that were not read yet.

        Raises:
            FloatingPointError: a term is NaN or infinite; names the term and the step.
        """
        for step, terms in self.waiting:
            for name, value in terms.items():
                number = float(value)
                if not math.isfinite(number):
                    raise FloatingPointError(
                        f"loss term '{name}' is {number} at step {step}. Try a lower optimizer.lr, "
                        "trainer.max_grad_norm=1, or runtime.precision=fp32. The last good state, if any, is "
                        "checkpoints/last.pt in the run folder"
                    )
                self.sums[name] = self.sums.get(name, 0.0) + number
        self.waiting.clear()

"""Adds up an epoch's losses and the time spent waiting for data; notices a loss that is not a number."""

import math
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from torch import Tensor

from eldenet.training.checkpoint import Progress

LOOK_EVERY = 10  # steps: each look makes the host wait for an accelerator


def timed(batches: Iterable[dict[str, Any]], progress: Progress) -> Iterator[dict[str, Any]]:
    """The same batches; how long each one was waited for is added to ``progress.waited``."""
    started = time.monotonic()
    for batch in batches:
        progress.waited += time.monotonic() - started
        yield batch
        started = time.monotonic()


class LossMeter:
    """Sums of named loss terms.

    Args:
        sums: where they are added up; part of the checkpoint.
        eager: look at every step (free on a CPU).
    """

    def __init__(self, sums: dict[str, float], *, eager: bool) -> None:
        self.sums, self.eager = sums, eager
        self.waiting: list[tuple[int, Mapping[str, Tensor]]] = []

    def add(self, step: int, terms: Mapping[str, Tensor]) -> None:
        """Add the terms of one batch of update ``step``."""
        self.waiting.append((step, terms))
        if self.eager or len(self.waiting) >= LOOK_EVERY:
            self.look()

    def look(self) -> None:
        """Add up what is waiting.

        Raises:
            FloatingPointError: a term is NaN or infinite; says which, and at which step.
        """
        for step, terms in self.waiting:
            for name, value in terms.items():
                number = float(value)
                if not math.isfinite(number):
                    raise FloatingPointError(
                        f"loss term '{name}' is {number} at step {step}; the last good state is in "
                        "checkpoints/last.pt of the run folder (if it got there). Try a lower optimizer.lr, "
                        "trainer.gradient_clip=1, or runtime.precision=fp32"
                    )
                self.sums[name] = self.sums.get(name, 0.0) + number
        self.waiting.clear()

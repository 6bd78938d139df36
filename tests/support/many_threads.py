"""Call one object from many threads at once."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np


def outputs_by_thread(
    function: Callable[[np.ndarray], np.ndarray], inputs: Sequence[np.ndarray], rounds: int
) -> list[list[np.ndarray]]:
    """Return what each thread got: one thread per input, all at the same time, several rounds."""
    ready = threading.Barrier(len(inputs))

    def caller(given: np.ndarray) -> list[np.ndarray]:
        ready.wait(60)
        return [function(given) for _ in range(rounds)]

    with ThreadPoolExecutor(len(inputs)) as threads:
        return list(threads.map(caller, inputs))

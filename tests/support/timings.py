"""Tests measure no times: what a run measures for its record takes a moment instead of seconds."""

from eldenet.evaluation.cost import measure_cost
from eldenet.system.timing import time_interleaved

SECONDS = 0.002


def short_timings() -> None:
    """Shorten the timings that the caller leaves to their default, in this process and its forks."""
    assert measure_cost.__kwdefaults__ is not None
    assert time_interleaved.__kwdefaults__ is not None
    measure_cost.__kwdefaults__["seconds"] = SECONDS
    time_interleaved.__kwdefaults__.update(rounds=1, seconds=SECONDS, warm_up=0)

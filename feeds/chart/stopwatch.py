"""Times calls in turns, so that a machine that slows down slows all of them alike.

What counts is the processor's time, where the system tells it finely enough: that of others who
are busy on the same machine is not in it.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence

import numpy as np

from plotfeed.models.state import Floats

Call = Callable[[], object]
MOST_CALLS = 100_000
FINE_S = 1e-6
now_ns = (
    time.thread_time_ns
    if time.get_clock_info("thread_time").resolution <= FINE_S
    else time.perf_counter_ns
)


def in_turns(calls: Sequence[Call], *, rounds: int, seconds: float) -> Floats:
    """Nanoseconds of each call, mean of a turn; (rounds, calls). A turn lasts at least `seconds`.

    Garbage is not collected meanwhile: when that happens has nothing to do with who is timed.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        counts = [_count(call, seconds) for call in calls]
        turns = [
            [_mean_ns(call, count) for call, count in zip(calls, counts, strict=True)]
            for _ in range(rounds)
        ]
    finally:
        if was_enabled:
            gc.enable()
    return np.array(turns, dtype=np.float64).reshape(rounds, len(calls))


def _count(call: Call, seconds: float) -> int:
    """How often a call goes into that time; it has then been warmed up."""
    call()
    return int(np.clip(seconds * 1e9 / max(_mean_ns(call, 1), 1.0), 1, MOST_CALLS))


def _mean_ns(call: Call, count: int) -> float:
    start_ns = now_ns()
    for _ in range(count):
        call()
    return (now_ns() - start_ns) / count

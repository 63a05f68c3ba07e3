"""How benchmarks say what they found: aims all in the same words, ratios with their spread."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterable, Sequence


def aim(what: str, limit: str, found: str, *, is_met: bool) -> str:
    """A line of the page, which `tests/test_docs.py` knows."""
    return f"- Aim: {what}, {limit}: {'met' if is_met else '**missed**'}, {found}."


def spread(values: Iterable[float], form: str = ".2f") -> str:
    """The median of runs, and the least to the most."""
    each = list(values)
    return f"{statistics.median(each):{form}} ({min(each):{form}} to {max(each):{form}})"


def ratios(ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    """How many times the other ours is, run by run: each has one of its own beside it."""
    return [a / b for a, b in zip(ours, theirs, strict=True)]


YARDSTICK = """A yardstick is a fixed piece of work, half of it Python's and half NumPy's, measured
in the same runs: what another machine may be compared by."""


def yardstick_us() -> float:
    """Processor time of the yardstick, microseconds; mean of some."""
    import numpy as np  # some who read this file run where it is not

    chance, turns = np.random.default_rng(1), 200
    start = time.process_time()
    for _ in range(turns):
        found = {f"{i}": i * 0.5 for i in range(1000)}
        total = sum(found.values()) + float(np.sort(chance.standard_normal(5000)).sum())
    assert total > 0
    return (time.process_time() - start) / turns * 1e6

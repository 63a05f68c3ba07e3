"""How benchmarks say what they found: aims all in the same words, ratios with their spread."""

from __future__ import annotations

import statistics
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

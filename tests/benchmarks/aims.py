"""How benchmarks say whether they reached what they should: all in the same words."""

from __future__ import annotations


def aim(what: str, limit: str, found: str, *, is_met: bool) -> str:
    """A line of the page, which `tests/test_docs.py` knows."""
    return f"- Aim: {what}, {limit}: {'met' if is_met else '**missed**'}, {found}."

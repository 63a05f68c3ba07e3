"""Nanoseconds of UTC, written for people."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import lru_cache

NS = 1_000_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def iso_utc(t_utc_ns: int) -> str:
    """2026-01-01T12:00:00.123456789Z."""
    seconds, ns = divmod(t_utc_ns, NS)
    return f"{_to_the_second(seconds)}.{ns:09d}Z"


@lru_cache(maxsize=16)  # a session writes the same second again and again
def _to_the_second(seconds: int) -> str:
    return f"{_EPOCH + timedelta(seconds=seconds):%Y-%m-%dT%H:%M:%S}"

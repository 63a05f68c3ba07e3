"""The time line: nanoseconds of UTC since 1970, and how they are written for people."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from functools import lru_cache

NS = 1_000_000_000  # Nanoseconds in a second; as in `models.state`, which would bring NumPy along
NS_IN_MS = 1_000_000

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

DAY_NS = 86_400 * NS


def whole_second_ns(t_ns: int) -> int:
    """The whole second that a time is, or the next one."""
    return -(-t_ns // NS) * NS


def iso_utc(t_utc_ns: int) -> str:
    """2026-01-01T12:00:00.123456789Z; empty for a time that no calendar holds."""
    seconds, ns = divmod(t_utc_ns, NS)
    try:
        return f"{_to_the_second(seconds)}.{ns:09d}Z"
    except OverflowError:
        return ""


def iso_utc_ms(t_utc_ns: int) -> str:
    """2026-01-01T12:00:00.123Z, rounded down: as many decimals as every reader takes."""
    text = iso_utc(t_utc_ns)
    return f"{text[:-7]}Z" if text else ""


@lru_cache(maxsize=16)  # a session writes the same second again and again
def _to_the_second(seconds: int) -> str:
    return f"{_EPOCH + timedelta(seconds=seconds):%Y-%m-%dT%H:%M:%S}"


def utc_ns(text: str) -> int | None:
    """A time of ISO 8601 with a zone, up to nine decimals of the second; None for anything else."""
    found = re.fullmatch(r"([^.]+)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)", text)
    if found is None:
        return None
    try:
        time = datetime.fromisoformat(found[1] + found[3].replace("Z", "+00:00"))
    except ValueError:
        return None
    if time.tzinfo is None:  # a date alone, whose zone `fromisoformat` does not take for one
        return None
    since = time - _EPOCH
    return (since.days * 86_400 + since.seconds) * NS + int((found[2] or "").ljust(9, "0"))


def nearest_utc_ns(time_of_day_ns: int, t_utc_ns: int) -> int:
    """The time with that time of day which is nearest to `t_utc_ns`."""
    half = DAY_NS // 2
    return t_utc_ns + (time_of_day_ns - t_utc_ns + half) % DAY_NS - half

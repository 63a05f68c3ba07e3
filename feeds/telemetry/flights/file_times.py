"""When the records of a file were made: times as files write them, and coarse ones made finer."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date, datetime
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from statistics import median

from plotfeed.feeds.telemetry.flights.flight import utc_ns
from plotfeed.proto.utc import DAY_NS, NS

# Times since 1970 under each are in seconds, ms, us; above the last in ns.
_EPOCH_DIGITS = ((Decimal("1e11"), 10**9), (Decimal("1e14"), 10**6), (Decimal("1e17"), 10**3))
# 1973 in seconds: a smaller number is the time of something else, such as a day.
_EARLIEST_EPOCH = Decimal("1e8")
_LATEST_NS = Decimal(2**63)
_TIME_OF_DAY = re.compile(r"(\d{1,2}):(\d{1,2}):(\d{1,2})(?:[.,](\d{1,9}))?\s*([AaPp])?\.?[Mm]?\.?")
_YEAR_FIRST = re.compile(r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})")
_YEAR_LAST = re.compile(r"(\d{1,2})[-/.](\d{1,2})[-/.](\d{4})")
COARSE_NS = NS  # Step of clocks that show whole seconds
AGREEING_SHARE = 0.9


def parse_time_ns(cell: str, utc_offset_h: float) -> int | None:
    """UTC, nanoseconds since 1970, of an ISO 8601 time or a number since 1970; None if neither.

    Numbers may be seconds, ms, us or ns: which one, their size tells.
    """
    try:
        since_1970 = Decimal(cell.strip())
    except InvalidOperation:
        pass
    else:
        if not since_1970.is_finite() or not _EARLIEST_EPOCH <= since_1970 < _LATEST_NS:
            return None
        unit_ns = next((unit for below, unit in _EPOCH_DIGITS if since_1970 < below), 1)
        return round(since_1970 * unit_ns)
    try:
        return utc_ns(datetime.fromisoformat(cell.strip()), utc_offset_h)
    except (ValueError, OverflowError):
        return None


def time_of_day_ns(cell: str) -> int | None:
    """Nanoseconds since midnight of 11:24:29.64 AM, 23:04:05 and the like; None if it is none."""
    found = _TIME_OF_DAY.fullmatch(cell.strip())
    if found is None:
        return None
    hour, minute, second = (int(found[n]) for n in (1, 2, 3))
    if found[5] is not None:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + 12 * (found[5] in "Pp")
    if hour > 23 or minute > 59 or second > 60:
        return None
    return ((hour * 60 + minute) * 60 + second) * NS + int((found[4] or "").ljust(9, "0"))


def is_day_first(cells: Sequence[str]) -> bool | None:
    """Whether days come before months in dates such as 31/12/2024; None where none tells."""
    for cell in cells:
        found = _YEAR_LAST.fullmatch(cell.strip())
        if found and int(found[1]) > 12:
            return True
        if found and int(found[2]) > 12:
            return False
    return None


def midnight_ns(cell: str, *, day_first: bool = False) -> int | None:
    """Midnight of a date such as 2024-12-31 or 12/31/2024, as if it were of UTC; None if none."""
    cell = cell.strip()
    try:
        if found := _YEAR_FIRST.fullmatch(cell):
            day = date(int(found[1]), int(found[2]), int(found[3]))
        elif found := _YEAR_LAST.fullmatch(cell):
            first, second = int(found[1]), int(found[2])
            day = date(int(found[3]), *((second, first) if day_first else (first, second)))
        else:
            return None
    except ValueError:
        return None
    return (day - date(1970, 1, 1)).days * DAY_NS


def finer_times(
    coarse_ns: Sequence[int | None], elapsed_ns: Sequence[int | None], *, start_ns: int | None
) -> list[int | None]:
    """Times of records that have a clock of whole seconds, a count since some beginning, or both.

    Where the clock ticks, its whole second is true: the median over ticks, which are late by part
    of an interval, less that part, says when the count began. Where both run differently, as in
    films that were slowed down, the clock is right, and the count parts records of one second.
    `start_ns` is when a count began beside which there is no clock.
    """
    both = [
        (c, e)
        for c, e in zip(coarse_ns, elapsed_ns, strict=True)
        if c is not None and e is not None
    ]
    if not both:
        if start_ns is None or any(c is not None for c in coarse_ns):
            return list(coarse_ns)
        return [None if e is None else start_ns + e for e in elapsed_ns]
    if all(c % COARSE_NS for c, _ in both):  # the clock is fine enough by itself
        base_ns = round(median(c - e for c, e in both))
        pairs = zip(coarse_ns, elapsed_ns, strict=True)
        return [base_ns + e if c is None and e is not None else c for c, e in pairs]
    base_ns = _base_ns(both)
    agree = sum(-COARSE_NS // 10 <= base_ns + e - c < COARSE_NS * 11 // 10 for c, e in both)
    if agree >= AGREEING_SHARE * len(both):
        return [c if e is None else base_ns + e for c, e in zip(coarse_ns, elapsed_ns, strict=True)]
    return _parted(coarse_ns, elapsed_ns, base_ns)


def _base_ns(both: Sequence[tuple[int, int]]) -> int:
    """When the count was 0 by the clock, from where the clock ticks."""
    ticks = [
        (after[0] - after[1], after[1] - before[1])
        for before, after in pairwise(both)
        if after[0] == before[0] + COARSE_NS and 0 < after[1] - before[1] <= COARSE_NS
    ]
    if not ticks:
        return both[0][0] - both[0][1]
    # A record comes up to an interval after the tick before it: the least late is nearest to it.
    return max(base for base, _ in ticks)


def _parted(
    coarse_ns: Sequence[int | None], elapsed_ns: Sequence[int | None], base_ns: int
) -> list[int | None]:
    """Clock times, records of one second apart by the count; without a clock, from the last one."""
    times: list[int | None] = []
    second: int | None = None
    began_ns = base = base_ns
    for coarse, elapsed in zip(coarse_ns, elapsed_ns, strict=True):
        if elapsed is None:
            times.append(coarse)
            continue
        if coarse is not None and coarse != second:
            second, began_ns, base = coarse, elapsed, coarse - elapsed
        since_ns = elapsed - began_ns
        late = coarse is not None and not 0 <= since_ns < COARSE_NS
        times.append(coarse if late else base + elapsed)
    return times

"""The golden flight as DJI's apps would have recorded it, in any version."""

from __future__ import annotations

from golden.dji_records import Flown, dji_record
from golden.make_flights import dji_rows


def part_of_a_flight(
    version: int, part_s: tuple[int, int] = (20, 24), *, has_clock: bool = True
) -> bytes:
    """A record of those seconds of it."""
    return dji_record(version, [Flown(*row) for row in dji_rows(part_s)], has_clock=has_clock)

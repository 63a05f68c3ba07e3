"""Times of recordings: nanoseconds of UTC that a file can hold, and days for times of day."""

from __future__ import annotations

from plotfeed.proto.utc import DAY_NS, NS

LATEST_NS = (1 << 64) - 1
"""In the year 2554; all that the native log can hold."""

BEHIND_NS = 3600 * NS
"""How much earlier than the one before it a time of day may be, on the same day."""


class DayClock:
    """Gives days to times of day that come in their order, or a little out of it.

    The first is of the day that begins at `date_utc_ns`. One that is at most an hour behind the
    one before it is out of order, across midnight too; any other is ahead of it.
    """

    def __init__(self, date_utc_ns: int) -> None:
        self._date_utc_ns = date_utc_ns
        self._last_utc_ns: int | None = None

    def utc_ns(self, time_of_day_ns: int) -> int:
        """The time, not before 1970, of the next time of day."""
        if self._last_utc_ns is None:
            self._last_utc_ns = self._date_utc_ns + time_of_day_ns
        else:
            since_midnight = self._last_utc_ns - self._date_utc_ns
            self._last_utc_ns += ahead_ns(since_midnight, time_of_day_ns)
        return max(self._last_utc_ns, 0)


def ahead_ns(one_ns: int, other_ns: int) -> int:
    """How far the second of two times of day is ahead of the first: from -1 h to 23 h."""
    ahead = (other_ns - one_ns) % DAY_NS
    return ahead - DAY_NS if ahead >= DAY_NS - BEHIND_NS else ahead

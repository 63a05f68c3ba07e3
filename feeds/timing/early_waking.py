"""Waking early: how long before a deadline to wake, and look at the clock from then on."""

from __future__ import annotations

MAX_EARLY_NS = 300_000
"""A process is not awake sooner than this before a deadline, however late it wakes."""
FIRST_EARLY_NS = 50_000
SHARE = 16
"""At most one part in so many of the time is spent looking at the clock."""
SAVED_NS = 2_000_000
"""So much of that is saved for later, where deadlines are rare."""
LATER = 1.2
SOONER = LATER ** (-1 / 19)
"""Factors of what is learned where a wake-up was later than that, and where not: one in 20 is."""
LEAST_NS = 1_000


class EarlyWaking:
    """How early to wake: as late as 19 of 20 wake-ups lately came, within a share of the time.

    What a wake-up costs from the timer's expiry to the code that waits, the kernel's part and the
    event loop's, is thus over when the time comes. A machine that stalls for milliseconds changes
    little: each wake-up moves what is learned by a factor, however late it was.
    """

    def __init__(self) -> None:
        self._learned_ns = float(FIRST_EARLY_NS)
        self._saved_ns = SAVED_NS
        self._looked_at_ns = 0

    def early_ns(self, now_ns: int) -> int:
        """How long before a deadline to wake, as of now on the monotonic clock."""
        self._saved_ns += (now_ns - self._looked_at_ns) // SHARE
        self._saved_ns = min(self._saved_ns, SAVED_NS)
        self._looked_at_ns = now_ns
        return max(0, min(int(self._learned_ns), self._saved_ns))

    def woke(self, late_ns: int) -> None:
        """Learn from a wake-up that came so long after the time set for it."""
        factor = LATER if late_ns > self._learned_ns else SOONER
        self._learned_ns = min(max(self._learned_ns * factor, LEAST_NS), MAX_EARLY_NS)

    def awake(self, for_ns: int) -> None:
        """Count what was spent looking at the clock."""
        self._saved_ns -= for_ns

"""Waiting for a deadline more exactly than a timer: woken early, and awake until it is time."""

from __future__ import annotations

from plotfeed.feeds.clock import WallClock

MARGIN_NS, MAX_EARLY_NS = 10_000, 200_000
FORGET = 64
"""A late wake-up counts less and less over so many others."""
SHARE = 4
"""At most a quarter of the time is spent awake: nearer deadlines are left to the timer."""


class Waker:
    """Waits on a wall clock; how early it has itself woken follows from how late that was."""

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._late_ns = 0

    async def wait_until(self, t_utc_ns: int) -> None:
        """Return when it is that time, or when the clock is woken; never much earlier."""
        clock, early_ns = self._clock, min(self._late_ns + MARGIN_NS, MAX_EARLY_NS)
        if t_utc_ns - clock.now_ns() < SHARE * early_ns:
            await clock.sleep_until(t_utc_ns)
            return
        wake_ns = t_utc_ns - early_ns
        await clock.sleep_until(wake_ns)
        late_ns = clock.now_ns() - wake_ns
        if late_ns < 0:  # it was woken
            return
        self._late_ns = max(late_ns, self._late_ns - self._late_ns // FORGET)
        while clock.now_ns() < t_utc_ns:
            pass

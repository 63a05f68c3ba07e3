"""The clocks that a session can run by, in nanoseconds of UTC since 1970."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Protocol

from plotfeed.feeds.timing.timers import LoopTimer, TimerFd, precise_timer

AS_LONG_AS_IT_TAKES_NS = 1 << 62  # What is left where time stands still: nothing comes too late
# A clock faster than real time waits while due work is so late, by its own time or real time.
MOST_BEHIND_NS, MOST_BEHIND_REAL_NS = 100_000_000, 10_000_000


class Clock(Protocol):
    """Tells the session's time, and waits for it. One waiter at a time."""

    @property
    def can_wait(self) -> bool:
        """Whether time waits for what is slow, where the world's time would go on."""

    def start(self) -> int:
        """The session begins: the time at which it does so."""

    def now_ns(self) -> int:
        """The session's UTC."""

    def stands_before(self, t_utc_ns: int) -> bool:
        """Whether it stands still before that time comes, until somebody lets it go on."""

    def left_ns(self, t_utc_ns: int) -> int:
        """Real nanoseconds until then, below zero if it is past: what else there is time for."""

    async def sleep_until(self, t_utc_ns: int, *, exactly: bool = True) -> None:
        """Return when it is that time, at once if it is past, or when somebody wakes it.

        `exactly` is for what is to be sent then; what else is to be done can be a little late.
        """

    def wake(self) -> None:
        """Let whoever sleeps return: there may be something to do sooner."""

    def close(self) -> None:
        """Give back what the clock holds."""


class WallClock:
    """Real time, at `speed` times its pace, from `start_utc_ns` or from now.

    It runs on the monotonic clock: a step of the system's UTC moves no deadline. A given start
    stands still until the session begins, so that all sessions begin at exactly that time. One that
    `can_be_held` shows the world's time until somebody holds or hurries it.

    At a `speed` above 1 whoever calls `sleep_until` has done all that was due before: the clock
    runs `MOST_BEHIND_NS` beyond that time at most, and waits there for the next call. So a machine
    that cannot hold the speed slows the session's time, and nothing is left out.
    """

    def __init__(
        self, start_utc_ns: int | None = None, *, speed: float = 1.0, can_be_held: bool = False
    ) -> None:
        self._zero_monotonic_ns = time.monotonic_ns()
        self._zero_utc_ns = time.time_ns() if start_utc_ns is None else start_utc_ns
        self._speed = speed
        self._stands_from_ns = None if start_utc_ns is None else start_utc_ns
        self._begun = start_utc_ns is None
        self._timer: LoopTimer | TimerFd | None = None
        # Beyond which it does not run by itself, at a speed above 1.
        self._limit_ns: int | None = None
        self._since = self._zero_monotonic_ns, self._zero_utc_ns
        # Whether it shows the world's time, which cannot be held or hurried.
        self.is_real = start_utc_ns is None and speed == 1 and not can_be_held

    @property
    def speed(self) -> float:
        """Times real time."""
        return self._speed

    @property
    def can_wait(self) -> bool:
        """Whether it runs faster than the world's time, and so can be held back."""
        return self._speed > 1

    @property
    def is_paused(self) -> bool:
        """Whether it stands still."""
        return self._stands_from_ns is not None and self.now_ns() >= self._stands_from_ns

    @property
    def reached(self) -> float:
        """Times real time at which it ran since its speed was set, or it went on after a pause."""
        monotonic_ns, utc_ns = self._since
        passed_ns = time.monotonic_ns() - monotonic_ns
        if self._speed <= 1 or self.is_paused or passed_ns <= 0:
            return self._speed
        return min((self.now_ns() - utc_ns) / passed_ns, self._speed)

    def start(self) -> int:
        """Let a given start be now."""
        if not self._begun:
            self._begun = True
            self.resume()
            return self._zero_utc_ns
        self._go_on(stands_from_ns=self._stands_from_ns)
        return self.now_ns()

    def now_ns(self) -> int:
        """The session's UTC."""
        passed_ns = time.monotonic_ns() - self._zero_monotonic_ns
        if self._speed != 1:
            passed_ns = round(passed_ns * self._speed)
        now_ns = self._zero_utc_ns + passed_ns
        if self._stands_from_ns is not None and now_ns > self._stands_from_ns:
            return self._stands_from_ns
        if self._speed > 1 and self._limit_ns is not None and now_ns > self._limit_ns:
            return self._limit_ns
        return now_ns

    def pause(self) -> None:
        """Stand still from now on."""
        self._go_on(stands_from_ns=self.now_ns())

    def resume(self) -> None:
        """Run on from where it stands."""
        self._go_on(stands_from_ns=None)

    def step(self, duration_ns: int) -> None:
        """Run on for so long, and then stand."""
        self._go_on(stands_from_ns=self.now_ns() + duration_ns)

    def set_speed(self, speed: float) -> None:
        """Run at another pace from now on."""
        self._go_on(stands_from_ns=self._stands_from_ns, speed=speed)

    def stands_before(self, t_utc_ns: int) -> bool:
        """Whether a pause, or the end of a step, comes first."""
        return self._stands_from_ns is not None and t_utc_ns > self._stands_from_ns

    def left_ns(self, t_utc_ns: int) -> int:
        """Real nanoseconds until then."""
        if self.stands_before(t_utc_ns):
            return AS_LONG_AS_IT_TAKES_NS
        if self._speed > 1:  # it may be held back
            return math.ceil((t_utc_ns - self.now_ns()) / self._speed)
        return self._monotonic_ns(t_utc_ns) - time.monotonic_ns()

    async def sleep_until(self, t_utc_ns: int, *, exactly: bool = True) -> None:
        """Return when it is that time, to some microseconds on Linux; or when woken."""
        if not self._begun:
            self.start()
        if self._timer is None:
            self._timer = precise_timer()
        self._let_run_to(t_utc_ns)
        if self.stands_before(t_utc_ns):
            await self._timer.wait_for_wake()
            return
        await self._timer.wait_until(self._monotonic_ns(t_utc_ns), exactly=exactly)

    def wake(self) -> None:
        """Let whoever sleeps return."""
        if self._timer is not None:
            self._timer.wake()

    def close(self) -> None:
        """Close the timer."""
        if self._timer is not None:
            self._timer.close()
            self._timer = None

    def _monotonic_ns(self, t_utc_ns: int) -> int:
        """The monotonic clock at that time, while nothing is changed."""
        until_ns = t_utc_ns - self._zero_utc_ns
        if self._speed != 1:
            until_ns = -round(-until_ns / self._speed // 1)
        return self._zero_monotonic_ns + until_ns

    def _let_run_to(self, t_utc_ns: int) -> None:
        """Let it run on to that time and a little longer, from where it was held back if it was."""
        now_ns = self.now_ns()
        if now_ns == self._limit_ns:
            self._zero_utc_ns, self._zero_monotonic_ns = now_ns, time.monotonic_ns()
        most_ns = min(MOST_BEHIND_NS, round(MOST_BEHIND_REAL_NS * self._speed))
        self._limit_ns = max(t_utc_ns + most_ns, now_ns)

    def _go_on(self, *, stands_from_ns: int | None, speed: float | None = None) -> None:
        now_ns, monotonic_ns = self.now_ns(), time.monotonic_ns()
        self._zero_utc_ns, self._zero_monotonic_ns = now_ns, monotonic_ns
        self._stands_from_ns = stands_from_ns
        self._speed = speed or self._speed
        self._let_run_to(now_ns)
        self._since = monotonic_ns, now_ns
        self.wake()


class InstantClock:
    """Simulated time that stands still until somebody waits, and is then there at once."""

    # Whether time is wherever it is wanted, so that nobody need wait for it step by step.
    leaps = True

    def __init__(self, start_utc_ns: int | None = None) -> None:
        self._now_ns = time.time_ns() if start_utc_ns is None else start_utc_ns

    @property
    def can_wait(self) -> bool:
        """Whether time stands still while anything is done."""
        return self.leaps

    def start(self) -> int:
        """The time at which it stands."""
        return self._now_ns

    def now_ns(self) -> int:
        """The session's UTC."""
        return self._now_ns

    def stands_before(self, _t_utc_ns: int) -> bool:
        """Always: time passes only for who waits."""
        return True

    def left_ns(self, _t_utc_ns: int) -> int:
        """No end of it: time passes only for who waits."""
        return AS_LONG_AS_IT_TAKES_NS

    async def sleep_until(self, t_utc_ns: int, *, exactly: bool = True) -> None:
        """Be there; whatever else waits in the loop has its turn first."""
        del exactly  # it always is
        await asyncio.sleep(0)
        self.jump(t_utc_ns)

    def jump(self, t_utc_ns: int) -> None:
        """Be there, before anybody else has a turn."""
        self._now_ns = max(self._now_ns, t_utc_ns)

    def wake(self) -> None:
        """Nobody ever sleeps."""

    def close(self) -> None:
        """Nothing is held."""

"""Exact timers of a running loop, on the monotonic clock, and how early they wake."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import sys
import time

from plotfeed.proto.utc import NS

# A process is not awake sooner than this before a deadline, however late it wakes.
MAX_EARLY_NS = 300_000
FIRST_EARLY_NS = 50_000
SHARE = 16  # At most one part in so many of the time is spent looking at the clock
SAVED_NS = 2_000_000  # So much of that is saved for later, where deadlines are rare
LATER = 1.2
# Factors of what is learned where a wake-up was later than that, and where not: one in 20 is.
SOONER = LATER ** (-1 / 19)
LEAST_NS = 1_000


class LoopTimer:
    """The loop's own timers, where there is no timerfd: up to a millisecond late. One waiter."""

    def __init__(self) -> None:
        self._woken = asyncio.Event()

    async def wait_until(self, monotonic_ns: int, *, exactly: bool = True) -> None:
        """Return at that time, or a little after it; never before, unless woken."""
        del exactly  # it cannot be
        self._woken.clear()
        while not self._woken.is_set() and (left_ns := monotonic_ns - time.monotonic_ns()) > 0:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(left_ns / NS):
                    await self._woken.wait()

    async def wait_for_wake(self) -> None:
        """Return when woken."""
        self._woken.clear()
        await self._woken.wait()

    def wake(self) -> None:
        """Let whoever waits return."""
        self._woken.set()

    def close(self) -> None:
        """Nothing is held."""


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


class _TimerSpec(ctypes.Structure):
    """struct itimerspec: the interval, then the first expiry, each seconds and nanoseconds."""

    _fields_ = [(name, ctypes.c_long) for name in ("every_s", "every_ns", "at_s", "at_ns")]


class TimerFd:
    """A timerfd on CLOCK_MONOTONIC, watched by the running loop. One waiter at a time.

    It is set a little early, by as much as wake-ups lately were late, and the rest is spent looking
    at the clock.
    """

    _ABSOLUTE = 1  # TFD_TIMER_ABSTIME

    def __init__(self) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self._set_time = libc.timerfd_settime
        self._spec = _TimerSpec()
        self._spec_at = ctypes.byref(self._spec)
        flags = os.O_NONBLOCK | os.O_CLOEXEC  # what TFD_NONBLOCK and TFD_CLOEXEC are on Linux
        self._fd = libc.timerfd_create(time.CLOCK_MONOTONIC, flags)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._loop = asyncio.get_running_loop()
        self._waiter: asyncio.Future[None] | None = None
        self._is_timed = False
        self._early = EarlyWaking()
        self._loop.add_reader(self._fd, self._expired)

    async def wait_until(self, monotonic_ns: int, *, exactly: bool = True) -> None:
        """Return at that time; never before, unless woken.

        Not `exactly`, it is not awake for it, and returns late by some tens of microseconds.
        """
        now_ns = time.monotonic_ns()
        if monotonic_ns <= now_ns:
            await asyncio.sleep(0)
            return
        wake_ns = monotonic_ns
        if exactly:
            wake_ns -= self._early.early_ns(now_ns)
        if wake_ns > now_ns:
            if await self._expires_at(wake_ns) and exactly:
                self._early.woke(time.monotonic_ns() - wake_ns)
                self._look_until(monotonic_ns)
        elif not await self._is_woken_at_once():
            self._look_until(monotonic_ns)

    async def wait_for_wake(self) -> None:
        """Return when woken."""
        await self._new_waiter(is_timed=False)

    async def _expires_at(self, monotonic_ns: int) -> bool:
        """Set the timer; whether it has come to that time, or somebody woke the waiter before."""
        spec = self._spec
        spec.at_s, spec.at_ns = divmod(monotonic_ns, NS)
        if self._set_time(self._fd, self._ABSOLUTE, self._spec_at, None) < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
        await self._new_waiter(is_timed=True)
        return time.monotonic_ns() >= monotonic_ns

    async def _is_woken_at_once(self) -> bool:
        """Let others run; whether one of them woke the waiter."""
        waiter = self._new_waiter(is_timed=False)
        await asyncio.sleep(0)
        return waiter.done()

    def _new_waiter(self, *, is_timed: bool) -> asyncio.Future[None]:
        """Whoever waits from now on; the timer may expire long after it was set for another."""
        self._waiter, self._is_timed = self._loop.create_future(), is_timed
        return self._waiter

    def wake(self) -> None:
        """Let whoever waits return."""
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    def close(self) -> None:
        """Take it out of the loop and close the file."""
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    def _look_until(self, monotonic_ns: int) -> None:
        """Be there the moment that it is that time."""
        from_ns = now_ns = time.monotonic_ns()
        while now_ns < monotonic_ns:
            now_ns = time.monotonic_ns()
        self._early.awake(now_ns - from_ns)

    def _expired(self) -> None:
        try:
            os.read(self._fd, 8)
        except BlockingIOError:  # it was set again
            return
        if self._is_timed:
            self.wake()


def precise_timer() -> LoopTimer | TimerFd:
    """The best timer of this system, for a running loop."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, NotImplementedError, AttributeError):
            return TimerFd()
    return LoopTimer()

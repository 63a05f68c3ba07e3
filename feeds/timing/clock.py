"""The clocks that a session can run by, in nanoseconds of UTC since 1970, and exact timers."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import sys
import time
from typing import Protocol

from plotfeed.proto.utc import NS


class Clock(Protocol):
    """Tells the session's time, and waits for it. One waiter at a time."""

    def start(self) -> int:
        """The session begins: the time at which it does so."""

    def now_ns(self) -> int:
        """The session's UTC."""

    def stands_before(self, t_utc_ns: int) -> bool:
        """Whether it stands still before that time comes, until somebody lets it go on."""

    async def sleep_until(self, t_utc_ns: int) -> None:
        """Return when it is that time, at once if it is past, or when somebody wakes it."""

    def wake(self) -> None:
        """Let whoever sleeps return: there may be something to do sooner."""

    def close(self) -> None:
        """Give back what the clock holds."""


class WallClock:
    """Real time, at `speed` times its pace, from `start_utc_ns` or from now.

    It runs on the monotonic clock: a step of the system's UTC moves no deadline. A given start
    stands still until the session begins, so that all sessions begin at exactly that time.
    """

    def __init__(self, start_utc_ns: int | None = None, *, speed: float = 1.0) -> None:
        self._zero_monotonic_ns = time.monotonic_ns()
        self._zero_utc_ns = time.time_ns() if start_utc_ns is None else start_utc_ns
        self._speed = speed
        self._stands_from_ns = None if start_utc_ns is None else start_utc_ns
        self._begun = start_utc_ns is None
        self._timer: LoopTimer | TimerFd | None = None
        self.is_real = start_utc_ns is None and speed == 1
        """Whether it shows the world's time, which cannot be held or hurried."""

    @property
    def speed(self) -> float:
        """Times real time."""
        return self._speed

    @property
    def is_paused(self) -> bool:
        """Whether it stands still."""
        return self._stands_from_ns is not None and self.now_ns() >= self._stands_from_ns

    def start(self) -> int:
        """Let a given start be now."""
        if not self._begun:
            self._begun = True
            self.resume()
            return self._zero_utc_ns
        return self.now_ns()

    def now_ns(self) -> int:
        """The session's UTC."""
        passed_ns = time.monotonic_ns() - self._zero_monotonic_ns
        if self._speed != 1:
            passed_ns = round(passed_ns * self._speed)
        now_ns = self._zero_utc_ns + passed_ns
        if self._stands_from_ns is not None and now_ns > self._stands_from_ns:
            return self._stands_from_ns
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
        self._zero_utc_ns, self._zero_monotonic_ns = self.now_ns(), time.monotonic_ns()
        self._speed = speed
        self.wake()

    def stands_before(self, t_utc_ns: int) -> bool:
        """Whether a pause, or the end of a step, comes first."""
        return self._stands_from_ns is not None and t_utc_ns > self._stands_from_ns

    async def sleep_until(self, t_utc_ns: int) -> None:
        """Return when it is that time; late by some tens of microseconds on Linux."""
        if not self._begun:
            self.start()
        if self._timer is None:
            self._timer = precise_timer()
        if self.stands_before(t_utc_ns):
            await self._timer.wait_for_wake()
            return
        until_ns = t_utc_ns - self._zero_utc_ns
        if self._speed != 1:
            until_ns = -round(-until_ns / self._speed // 1)
        await self._timer.wait_until(self._zero_monotonic_ns + until_ns)

    def wake(self) -> None:
        """Let whoever sleeps return."""
        if self._timer is not None:
            self._timer.wake()

    def close(self) -> None:
        """Close the timer."""
        if self._timer is not None:
            self._timer.close()
            self._timer = None

    def _go_on(self, *, stands_from_ns: int | None) -> None:
        self._zero_utc_ns, self._zero_monotonic_ns = self.now_ns(), time.monotonic_ns()
        self._stands_from_ns = stands_from_ns
        self.wake()


class InstantClock:
    """Simulated time that stands still until somebody waits, and is then there at once."""

    def __init__(self, start_utc_ns: int | None = None) -> None:
        self._now_ns = time.time_ns() if start_utc_ns is None else start_utc_ns

    def start(self) -> int:
        """The time at which it stands."""
        return self._now_ns

    def now_ns(self) -> int:
        """The session's UTC."""
        return self._now_ns

    def stands_before(self, _t_utc_ns: int) -> bool:
        """Always: time passes only for who waits."""
        return True

    async def sleep_until(self, t_utc_ns: int) -> None:
        """Be there; whatever else waits in the loop has its turn first."""
        await asyncio.sleep(0)
        self._now_ns = max(self._now_ns, t_utc_ns)

    def wake(self) -> None:
        """Nobody ever sleeps."""

    def close(self) -> None:
        """Nothing is held."""


class LoopTimer:
    """The loop's own timers, where there is no timerfd: up to a millisecond late. One waiter."""

    def __init__(self) -> None:
        self._woken = asyncio.Event()

    async def wait_until(self, monotonic_ns: int) -> None:
        """Return at that time, or a little after it; never before, unless woken."""
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


class _TimerSpec(ctypes.Structure):
    """struct itimerspec: the interval, then the first expiry, each seconds and nanoseconds."""

    _fields_ = [(name, ctypes.c_long) for name in ("every_s", "every_ns", "at_s", "at_ns")]


class TimerFd:
    """A timerfd on CLOCK_MONOTONIC, watched by the running loop. One waiter at a time."""

    _ABSOLUTE = 1  # TFD_TIMER_ABSTIME

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        flags = os.O_NONBLOCK | os.O_CLOEXEC  # what TFD_NONBLOCK and TFD_CLOEXEC are on Linux
        self._fd = self._libc.timerfd_create(time.CLOCK_MONOTONIC, flags)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._loop = asyncio.get_running_loop()
        self._due = asyncio.Event()
        self._loop.add_reader(self._fd, self._expired)

    async def wait_until(self, monotonic_ns: int) -> None:
        """Return at that time; late by some tens of microseconds."""
        if monotonic_ns <= time.monotonic_ns():
            await asyncio.sleep(0)
            return
        self._due.clear()
        at_s, at_ns = divmod(monotonic_ns, NS)
        spec = _TimerSpec(0, 0, at_s, at_ns)
        if self._libc.timerfd_settime(self._fd, self._ABSOLUTE, ctypes.byref(spec), None) < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
        await self._due.wait()

    async def wait_for_wake(self) -> None:
        """Return when woken."""
        self._due.clear()
        await self._due.wait()

    def wake(self) -> None:
        """Let whoever waits return."""
        self._due.set()

    def close(self) -> None:
        """Take it out of the loop and close the file."""
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    def _expired(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.read(self._fd, 8)
            self._due.set()


def precise_timer() -> LoopTimer | TimerFd:
    """The best timer of this system, for a running loop."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, NotImplementedError, AttributeError):
            return TimerFd()
    return LoopTimer()

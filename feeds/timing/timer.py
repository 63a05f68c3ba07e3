"""Waiting until an exact monotonic time inside the asyncio loop; one waiter at a time."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import sys
import time

from plotfeed.proto.utc import NS


class LoopTimer:
    """The loop's own timers, where there is no timerfd: up to a millisecond late."""

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
    """A timerfd on CLOCK_MONOTONIC, watched by the running loop."""

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

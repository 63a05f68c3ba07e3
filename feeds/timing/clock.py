"""When something is due, and waiting until then: schedules, clocks, timers; nanoseconds of UTC."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import heapq
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from enum import IntEnum
from itertools import count

from plotfeed.proto.utc import NS

Action = Callable[[], None]


class ActionKind(IntEnum):
    """What becomes of an action when the session ends before it is due."""

    BETWEEN = -1  # It is not done any more. It comes after all else that is due then.
    WORK = 0  # It is not done any more
    SENDING = 1  # What was worked out is still sent, unless the session ends at a set time
    DELIVERY = 2  # What was handed to a link is still delivered


# Of actions that are due together: who planned first is not to matter where plans differ.
ORDER = (ActionKind.WORK, ActionKind.DELIVERY, ActionKind.SENDING, ActionKind.BETWEEN)


class Schedule:
    """Actions in the order of their deadlines; of those due together, of their kinds.

    Of one kind they are done in the order they were put. `on_earlier` is called when something
    becomes the next to be done.
    """

    def __init__(self, on_earlier: Callable[[], object] | None = None) -> None:
        self._heap: list[tuple[int, int, int, Action, ActionKind]] = []
        self._order = count()
        self._on_earlier = on_earlier

    def __len__(self) -> int:
        return len(self._heap)

    def put(self, due_utc_ns: int, action: Action, kind: ActionKind = ActionKind.WORK) -> None:
        """Do this then."""
        entry = (due_utc_ns, ORDER.index(kind), next(self._order), action, kind)
        heapq.heappush(self._heap, entry)
        if self._on_earlier is not None and self._heap[0] is entry:
            self._on_earlier()

    def next_due_ns(self) -> int | None:
        """The next deadline; None if there is nothing to do."""
        return self._heap[0][0] if self._heap else None

    def next_kind(self) -> ActionKind:
        """Kind of the next action; there must be one."""
        return self._heap[0][4]

    def take(self) -> Action:
        """Take out the next action; there must be one."""
        return heapq.heappop(self._heap)[3]

    def due_by(self, t_utc_ns: int) -> Iterator[tuple[int, Action]]:
        """Take out what is due by then, and when it was, including what is put there meanwhile."""
        while (due_utc_ns := self.next_due_ns()) is not None and due_utc_ns <= t_utc_ns:
            yield due_utc_ns, self.take()

    def keep(self, least: ActionKind) -> None:
        """Forget what is of a lesser kind."""
        self._heap = [entry for entry in self._heap if entry[4] >= least]
        heapq.heapify(self._heap)


AS_LONG_AS_IT_TAKES_NS = 1 << 62  # What is left where time stands still: nothing comes too late
# A clock faster than real time waits while due work is so late, by its own time or real time.
MOST_BEHIND_NS, MOST_BEHIND_REAL_NS = 100_000_000, 10_000_000


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
        self._timer: LoopTimer | None = None
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
        """Real nanoseconds until then, below zero if it is past: what else there is time for."""
        if self.stands_before(t_utc_ns):
            return AS_LONG_AS_IT_TAKES_NS
        if self._speed > 1:  # it may be held back
            return math.ceil((t_utc_ns - self.now_ns()) / self._speed)
        return self._monotonic_ns(t_utc_ns) - time.monotonic_ns()

    async def sleep_until(self, t_utc_ns: int, *, exactly: bool = True) -> None:
        """Return when it is that time, at once if it is past, or when somebody wakes it.

        To some microseconds on Linux, where it is `exactly`: for what is to be sent then. What else
        is to be done can be a little late.
        """
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
        """Let whoever sleeps return: there may be something to do sooner."""
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


# Tells the session's time, and waits for it. One waiter at a time.
Clock = WallClock | InstantClock

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
        self._loop = asyncio.get_running_loop()
        self._waiter = self._loop.create_future()

    async def wait_until(self, monotonic_ns: int, *, exactly: bool = True) -> None:
        """Return at that time, or a little after it; never before, unless woken."""
        del exactly  # it cannot be
        waiter = self._new_waiter()
        while not waiter.done() and (left_ns := monotonic_ns - time.monotonic_ns()) > 0:
            await asyncio.wait((waiter,), timeout=left_ns / NS)

    async def wait_for_wake(self) -> None:
        """Return when woken."""
        await self._new_waiter()

    def wake(self) -> None:
        """Let whoever waits return."""
        if not self._waiter.done():
            self._waiter.set_result(None)

    def close(self) -> None:
        """Nothing is held."""

    def _new_waiter(self) -> asyncio.Future[None]:
        """Whoever waits from now on."""
        self._waiter = self._loop.create_future()
        return self._waiter


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


class TimerFd(LoopTimer):
    """A timerfd on CLOCK_MONOTONIC, watched by the running loop. One waiter at a time.

    It is set a little early, by as much as wake-ups lately were late, and the rest is spent looking
    at the clock.
    """

    _ABSOLUTE = 1  # TFD_TIMER_ABSTIME

    def __init__(self) -> None:
        super().__init__()
        libc = ctypes.CDLL(None, use_errno=True)
        self._set_time = libc.timerfd_settime
        self._spec = _TimerSpec()
        self._spec_at = ctypes.byref(self._spec)
        flags = os.O_NONBLOCK | os.O_CLOEXEC  # what TFD_NONBLOCK and TFD_CLOEXEC are on Linux
        self._fd = libc.timerfd_create(time.CLOCK_MONOTONIC, flags)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        # For whom it is set; it may expire long after, when another waits.
        self._timed = self._waiter
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
        else:
            waiter = self._new_waiter()
            await asyncio.sleep(0)  # others run, and may wake the waiter
            if not waiter.done():
                self._look_until(monotonic_ns)

    async def _expires_at(self, monotonic_ns: int) -> bool:
        """Set the timer; whether it has come to that time, or somebody woke the waiter before."""
        spec = self._spec
        spec.at_s, spec.at_ns = divmod(monotonic_ns, NS)
        if self._set_time(self._fd, self._ABSOLUTE, self._spec_at, None) < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
        self._timed = self._new_waiter()
        await self._timed
        return time.monotonic_ns() >= monotonic_ns

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
        if self._waiter is self._timed:
            self.wake()


def precise_timer() -> LoopTimer:
    """The best timer of this system, for a running loop."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, NotImplementedError, AttributeError):
            return TimerFd()
    return LoopTimer()

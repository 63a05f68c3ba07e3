"""Time that goes on by itself where nothing happens: a test that waits for a minute takes none.

What is waited for has to come from this process, by sockets or not: of another nobody knows when.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import selectors
from collections.abc import Callable, Coroutine
from typing import Any

from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS

GRACE_S = 0.002  # Real, for what is on its way between sockets
# At most at once: what a busy machine brings late has several graces before a timeout is over.
LEAP_S = 0.1


class _Selector(selectors.DefaultSelector):
    """Where nothing comes, the loop's clock goes on to what it would wait for."""

    def __init__(self, loop: LeapingLoop) -> None:
        super().__init__()
        self._loop = loop

    def select(self, timeout: float | None = None) -> Any:
        if timeout is None or timeout <= GRACE_S or self._loop.busy_threads:
            return super().select(timeout)
        found = super().select(GRACE_S)
        if not found:
            self._loop.leapt_s += min(timeout, LEAP_S) - GRACE_S
        return found


class LeapingLoop(asyncio.SelectorEventLoop):
    """Its time is real while anything is done, and leaps where all wait."""

    def __init__(self) -> None:
        self.leapt_s, self.busy_threads = 0.0, 0
        super().__init__(_Selector(self))

    def time(self) -> float:
        return super().time() + self.leapt_s

    def run_in_executor(self, *work: Any) -> asyncio.Future[Any]:
        future = super().run_in_executor(*work)
        self.busy_threads += 1
        future.add_done_callback(self._done)
        return future

    def _done(self, _: object) -> None:
        self.busy_threads -= 1


def in_own_time(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """The test in a loop whose time leaps."""

    @functools.wraps(test)
    def run(*args: Any, **kwargs: Any) -> None:
        with asyncio.Runner(loop_factory=LeapingLoop) as runner:
            runner.run(test(*args, **kwargs))

    return run


class LoopClock(InstantClock):
    """A session's clock by the time of the loop, as the wall clock is by that of the world."""

    leaps = False

    def __init__(self, start_utc_ns: int = START_NS) -> None:
        super().__init__(start_utc_ns)
        self._loop = asyncio.get_running_loop()
        self._zero_ns = start_utc_ns - round(self._loop.time() * NS)
        self._woken = asyncio.Event()

    def now_ns(self) -> int:
        return self._zero_ns + round(self._loop.time() * NS)

    def start(self) -> int:
        return self.now_ns()

    def stands_before(self, _t_utc_ns: int) -> bool:
        return False

    def left_ns(self, t_utc_ns: int) -> int:
        return t_utc_ns - self.now_ns()

    async def sleep_until(self, t_utc_ns: int, *, exactly: bool = True) -> None:
        del exactly
        self._woken.clear()
        await asyncio.sleep(0)
        while not self._woken.is_set() and (left_ns := self.left_ns(t_utc_ns)) > 0:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(left_ns / NS):
                    await self._woken.wait()

    def jump(self, t_utc_ns: int) -> None:
        raise NotImplementedError

    def wake(self) -> None:
        self._woken.set()

"""Leases of parts: who may send what, until when, and who has it next.

A worker asks at a time of its own clock; who grants it counts from when the question came. So a
lease has ended at the worker before anybody else takes it for ended, whatever their clocks say,
also where the answer reaches a worker that was frozen meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from plotfeed.feeds.console.posix import alive_s

PATIENCE_S = 60.0
"""For a worker that was just told to run a part, and has not asked for its lease yet."""


class WorkerLease:
    """A lease as a worker has it."""

    def __init__(self, duration_s: float, now_s: Callable[[], float] = alive_s) -> None:
        self.duration_s = duration_s
        self.lost = False
        """Somebody else has it, for good."""
        self._now_s = now_s
        self._asked_s: dict[int, float] = {}
        self._number = 0
        self._held_from_s, self._until_s = float("-inf"), float("-inf")
        self._news = asyncio.Event()
        self._wanted = asyncio.Event()
        self._wanted.set()  # at once, the first time

    @property
    def holds(self) -> bool:
        """Whether it is held now."""
        return not self.lost and self._now_s() < self._until_s

    async def overdue(self) -> None:
        """Return when nobody has renewed it for thrice its duration, after it was once held."""
        since_s = 0.0
        while since_s <= 2 * self.duration_s:
            await asyncio.sleep(self.duration_s)
            if self._held_from_s > float("-inf"):
                since_s = self._now_s() - self._until_s

    async def until_to_be_asked(self) -> int:
        """Return when it is time to ask for it: the number of the question."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self.duration_s / 4):
                await self._wanted.wait()
        self._wanted.clear()
        self._number += 1
        self._asked_s[self._number] = self._now_s()
        self._asked_s.pop(self._number - 2, None)
        return self._number

    def granted(self, number: int) -> None:
        """Hold it from when that was asked."""
        asked_s = self._asked_s.get(number)
        if asked_s is not None and not self.lost:
            self._held_from_s, self._until_s = asked_s, asked_s + self.duration_s
            self._news.set()

    def lose(self) -> None:
        """Never hold it again."""
        self.lost = True

    async def renewed(self) -> None:
        """Return once it is held by an answer to what was asked after this call."""
        since_s = self._now_s()
        self._wanted.set()
        while not (self.holds and self._held_from_s >= since_s):
            self._news.clear()
            await self._news.wait()


class LeaseBook:
    """Leases as whoever grants them has them: one holder of a part at a time, by epochs."""

    def __init__(self, duration_s: float, now_s: Callable[[], float] = alive_s) -> None:
        self.duration_s = duration_s
        self._now_s = now_s
        self._epoch: dict[str, int] = {}
        self._until_s: dict[str, float] = {}

    def begin(self, part: str) -> int:
        """The next holder of a part: its epoch, which no other had."""
        self._epoch[part] = self._epoch.get(part, 0) + 1
        self._until_s.pop(part, None)
        return self._epoch[part]

    def renew(self, part: str, epoch: int) -> bool:
        """Grant a part for its duration from now, if that epoch is the newest."""
        if self._epoch.get(part) != epoch:
            return False
        self._until_s[part] = self._now_s() + self.duration_s
        return True

    def left_s(self, part: str) -> float:
        """How long somebody may still hold a part, seconds; not above 0 where nobody can."""
        return self._until_s.get(part, float("-inf")) - self._now_s()

    async def ended(self, part: str) -> None:
        """Return when nobody can hold a part any more, whose next holder has just been told."""
        began_s, left_s = self._now_s(), float("-inf")
        while left_s > 0 or (left_s == float("-inf") and self._now_s() - began_s < PATIENCE_S):
            await asyncio.sleep(min(max(left_s, 0.02), 0.1))
            left_s = self.left_s(part)

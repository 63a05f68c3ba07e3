"""The loop of a session: one schedule, done by one clock, and what comes in between."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.timing.clock import ActionKind, Clock, InstantClock, Schedule
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.feeds.engine.intake import Intake
    from plotfeed.feeds.transport.mqtt.client import MqttTransport

SPARE_NS = 1_000_000  # Less than this before a deadline, nothing else is begun
# What can wait is done together, at multiples of this, after what is due just then.
LATER_EVERY_NS, LATER_EVERY_SIMULATED_NS = NS // 10, NS
NEVER_NS = 1 << 63
# Messages sent in simulated time, and entries written, before anything else has its turn.
AT_ONCE, ENTRIES_AT_ONCE = 50, 200
# Entries that may wait; with one more, the oldest are written however late the session is.
MAX_LATER = 2_000
DRAIN_EVERY_NS = 20 * NS  # A simulated clock lets the sockets catch up this often


class SessionLoop:
    """Does what the schedule says, and takes in what comes in between."""

    def __init__(
        self,
        clock: Clock,
        schedule: Schedule,
        *,
        inputs: Intake,
        on_input: Callable[[], object],
        drain: Callable[[], Awaitable[None]],
        write_later: Callable[[Sequence[Any]], object],
        before_due: Sequence[Callable[[int], object]] = (),
        waits_for: Sequence[MqttTransport] = (),
    ) -> None:
        """`on_input` is called when something has come in, after nothing waited.

        `before_due` is told of a deadline before what is due then is done; `write_later` is given
        what could wait, some at a time. Whenever one of `waits_for` is full, all wait for it.
        """
        self.schedule = schedule
        self.slept_ns = 0  # For how long nothing was due
        self._clock, self._is_simulated = clock, isinstance(clock, InstantClock)
        self._inputs, self._on_input = inputs, on_input
        self._drain, self._write_later = drain, write_later
        self._before_due, self._waits_for = before_due, waits_for
        self._later: deque[Any] = deque()
        # When the turn of what waits comes; it has come at the end.
        self._later_ns: int | None = None
        self._is_turn_of_later = False

    def later(self, items: Sequence[Any]) -> None:
        """Write them with others, soon, when nothing is due; or when too much waits for that."""
        waiting = self._later
        begins = not waiting
        for item in items:
            if len(waiting) >= MAX_LATER:
                self._do_later(MAX_LATER if self._is_simulated else ENTRIES_AT_ONCE)
            waiting.append(item)
        if self._later_ns is None:
            every_ns = LATER_EVERY_SIMULATED_NS if self._is_simulated else LATER_EVERY_NS
            self._later_ns = (self._clock.now_ns() // every_ns + 1) * every_ns
            self.schedule.put(self._later_ns, self._begin_later, ActionKind.BETWEEN)
        if begins and self._stands_still():
            self._clock.wake()

    def queue_input(self, topic: str, payload: bytes, content_type: str | None) -> None:
        """Let wait what has come in, for the next tick or, where time stands still, for now."""
        self._inputs.queue(topic, payload, content_type)
        if len(self._inputs) == 1:
            self._on_input()
            if self._stands_still():
                self._clock.wake()

    async def work(self, end_ns: int | None) -> None:
        """Do everything that is due until then, each thing at its time."""
        drain_ns = self._clock.now_ns()
        while True:
            due_ns = self.schedule.next_due_ns()
            if due_ns is None or (end_ns is not None and due_ns > end_ns):
                if end_ns is None:
                    return
                await self._wait_until(end_ns)
                if self._clock.now_ns() >= end_ns:
                    return
                continue
            await self._wait_until(due_ns)
            await self._do_what_is_due(NEVER_NS if end_ns is None else end_ns)
            if self._clock.can_wait and due_ns >= drain_ns:
                await self._drain()
                drain_ns = due_ns + DRAIN_EVERY_NS

    async def finish(self, least: ActionKind) -> None:
        """Do what is of that kind and still ahead, and nothing else."""
        self.schedule.keep(least)
        self._later_ns, self._is_turn_of_later = NEVER_NS, True
        while (due_ns := self.schedule.next_due_ns()) is not None:
            await self._wait_until(due_ns)
            await self._do_what_is_due()

    def do_all_later(self) -> None:
        """Do all that could wait."""
        self._do_later(len(self._later))

    def _begin_later(self) -> None:
        """Let it be the turn of what waits; simulated time has all the time for that."""
        self._later_ns, self._is_turn_of_later = None, True
        if self._is_simulated:
            self.do_all_later()

    def _do_later(self, most: int) -> None:
        some = [self._later.popleft() for _ in range(min(most, len(self._later)))]
        if some:
            self._write_later(some)
        if not self._later and self._later_ns != NEVER_NS:
            self._is_turn_of_later = False

    async def _do_what_is_due(self, end_ns: int = NEVER_NS) -> None:
        """What is due by now, but nothing that is due after the end, however late it is."""
        clock, transports = self._clock, self._waits_for
        for transport in transports:
            if transport.is_full:
                await transport.room()
        by_ns, done = min(clock.now_ns(), end_ns), 0
        while (due_ns := self.schedule.next_due_ns()) is not None and due_ns <= by_ns:
            for tell in self._before_due:
                tell(due_ns)
            self.schedule.take()()
            done += 1
            if any(transport.is_full for transport in transports):
                break  # however much more is overdue
            if done >= AT_ONCE or not isinstance(clock, InstantClock) or not clock.leaps:
                continue
            next_ns = self.schedule.next_due_ns()
            if next_ns is None or next_ns > end_ns:
                continue
            if self.schedule.next_kind() >= ActionKind.SENDING:  # to which simulated time goes on
                clock.jump(next_ns)
                by_ns = max(by_ns, next_ns)

    async def _wait_until(self, due_ns: int) -> None:
        """Do what could wait, until then; what comes while time stands still is taken in now."""
        clock = self._clock
        while clock.stands_before(due_ns) or due_ns - clock.now_ns() > SPARE_NS:
            stands_still = self._stands_still()
            takes_in = stands_still and len(self._inputs) > 0
            if takes_in:
                self._inputs.take_in(clock.now_ns(), lambda: False)
            if self._later and (self._is_turn_of_later or stands_still):
                self._do_later(ENTRIES_AT_ONCE)
            elif not takes_in:
                break
            await asyncio.sleep(0)
        exactly = len(self.schedule) > 0 and self.schedule.next_kind() >= ActionKind.SENDING
        asleep_ns = clock.now_ns()
        await clock.sleep_until(due_ns, exactly=exactly)
        self.slept_ns += max(0, min(due_ns, clock.now_ns()) - asleep_ns)

    def _stands_still(self) -> bool:
        """Whether the next deadline waits for somebody who lets time go on."""
        due_ns, clock = self.schedule.next_due_ns(), self._clock
        return not self._is_simulated and due_ns is not None and clock.stands_before(due_ns)


async def first_of(*works: Coroutine[Any, Any, object], within_s: float | None = None) -> None:
    """Do all of that until any of it ends, or for so long; raises what it died of."""
    tasks = [asyncio.create_task(work) for work in works]
    try:
        await asyncio.wait(tasks, timeout=within_s, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        for ended in await asyncio.gather(*tasks, return_exceptions=True):
            if isinstance(ended, Exception):
                raise ended


def cause_of(group: ExceptionGroup[Exception]) -> Exception:
    """What went wrong first, of what went wrong in tasks together."""
    first = group.exceptions[0]
    return cause_of(first) if isinstance(first, ExceptionGroup) else first

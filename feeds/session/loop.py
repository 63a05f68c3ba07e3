"""The loop of a session: one schedule, done by one clock, and what comes in between."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from plotfeed.feeds.timing.clock import Clock, InstantClock
from plotfeed.feeds.timing.schedule import Action, ActionKind, Schedule
from plotfeed.proto.utc import NS

MAX_WAITING = 20_000
"""Telemetry of a second from a few thousand drones; more is refused."""

Take = Callable[[str, bytes, str | None, int], None]
"""Called with topic, payload, content type, and the time at which it is taken."""


class InputQueue:
    """A bounded queue in front of whoever takes messages."""

    def __init__(self, take: Take, most: int = MAX_WAITING) -> None:
        self.overflowed = 0
        """Messages that found no room."""
        self._take = take
        self._waiting: deque[tuple[str, bytes, str | None]] = deque()
        self._most = most

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, topic: str, payload: bytes, content_type: str | None) -> bool:
        """Let it wait; False if there is no room."""
        if len(self._waiting) >= self._most:
            self.overflowed += 1
            return False
        self._waiting.append((topic, payload, content_type))
        return True

    def take(self, most: int, t_utc_ns: int) -> int:
        """Take that many at most, as of that time; how many there were."""
        taken = min(most, len(self._waiting))
        for _ in range(taken):
            self._take(*self._waiting.popleft(), t_utc_ns)
        return taken


SPARE_NS = 1_000_000
"""Less than this before a deadline, nothing else is begun."""
AT_ONCE = 50
"""Messages taken in, or entries written, before the clock is looked at again."""
BUSY_AT_ONCE = 5
"""The same where the next deadline is near: nothing waits for ever."""
MAX_LATER = 2_000
"""Entries that may wait; with one more, the oldest is written however late the session is."""
DRAIN_EVERY_NS = 20 * NS
"""A simulated clock lets the sockets catch up this often."""


class Patient(Protocol):
    """A way out that would rather have the session wait than lose a message."""

    @property
    def is_full(self) -> bool:
        """Whether it can take no more at the moment."""

    async def room(self) -> None:
        """Return when it can."""


class RecordedInputs(Protocol):
    """Telemetry of a recording, to be taken in again at the times at which it was."""

    def take_before(self, t_utc_ns: int) -> None:
        """Take in all that was taken in before that time."""


class SessionLoop:
    """Does what the agenda says."""

    def __init__(
        self,
        clock: Clock,
        *,
        inbox: InputQueue,
        drain: Callable[[], object],
        after_later: Callable[[], object] = lambda: None,
        recorded: RecordedInputs | None = None,
    ) -> None:
        self.agenda = Schedule(clock.wake)
        self.waited = 0
        """How often the session waited for a way out to have room."""
        self._clock = clock
        self._inbox = inbox
        self._drain = drain
        self._after_later = after_later
        self._patients: Sequence[Patient] = ()
        self._recorded = recorded
        self._later: deque[Action] = deque()
        self._done_ns = 0

    def be_patient(self, patients: Sequence[Patient]) -> None:
        """Wait for these whenever they are full, and with them all sensors."""
        self._patients = patients

    def later(self, action: Action) -> None:
        """Do this when nothing is due, or when too much waits for that."""
        self._later.append(action)
        if len(self._later) > MAX_LATER:
            self._do_later(1)
        due_ns = self.agenda.next_due_ns()
        if due_ns is not None and self._clock.stands_before(due_ns):
            self._clock.wake()  # nothing else would

    def heard(self, topic: str, payload: bytes, content_type: str | None) -> bool:
        """Something has come in; False if there is no room for it to wait."""
        there_was_room = self._inbox.put(topic, payload, content_type)
        due_ns = self.agenda.next_due_ns()
        if due_ns is None or self._has_time_before(due_ns):
            self._take_in(AT_ONCE)
        return there_was_room

    def as_of_ns(self) -> int:
        """The time of what comes in now: no later than it is, and before all that is not done."""
        now_ns, next_ns = self._clock.now_ns(), self.agenda.next_due_ns()
        return now_ns if next_ns is None or now_ns < next_ns else next_ns - 1

    async def work(self, end_ns: int | None) -> None:
        """Do everything that is due until then, each thing at its time."""
        drain_ns = self._clock.now_ns()
        while True:
            due_ns = self.agenda.next_due_ns()
            if due_ns is None or (end_ns is not None and due_ns > end_ns):
                if end_ns is None:
                    return
                await self._wait_until(end_ns)
                if self._clock.now_ns() >= end_ns:
                    return
                continue
            await self._wait_until(due_ns)
            await self._do_what_is_due(end_ns)
            if isinstance(self._clock, InstantClock) and due_ns >= drain_ns:
                await self._drained()
                drain_ns = due_ns + DRAIN_EVERY_NS

    async def finish(self, least: ActionKind) -> None:
        """Do what is of that kind and still ahead, and nothing else."""
        self.agenda.keep(least)
        while (due_ns := self.agenda.next_due_ns()) is not None:
            await self._wait_until(due_ns)
            await self._do_what_is_due()

    def do_all_later(self) -> None:
        """Do all that could wait."""
        self._do_later(len(self._later))

    def _do_later(self, most: int) -> None:
        some = min(most, len(self._later))
        for _ in range(some):
            self._later.popleft()()
        if some:
            self._after_later()

    async def _do_what_is_due(self, end_ns: int | None = None) -> None:
        """What is due by now, but nothing that is due after the end, however late it is."""
        for patient in self._patients:
            if patient.is_full:
                self.waited += 1
                await patient.room()
        now_ns = self._clock.now_ns()
        for due_ns, action in self.agenda.due_by(now_ns if end_ns is None else min(now_ns, end_ns)):
            if self._recorded is not None:
                self._recorded.take_before(due_ns)
            self._done_ns = due_ns
            action()
            if any(patient.is_full for patient in self._patients):
                break  # however much more is overdue
        next_ns = self.agenda.next_due_ns()
        has_time = next_ns is None or self._has_time_before(next_ns)
        self._do_later(AT_ONCE if has_time else BUSY_AT_ONCE)

    async def _wait_until(self, due_ns: int) -> None:
        """Until then, take in what has come, and do what could wait."""
        while (self._inbox or self._later) and self._has_time_before(due_ns):
            self._take_in(AT_ONCE)
            self._do_later(AT_ONCE)
            await asyncio.sleep(0)
        if len(self._inbox):
            self._take_in(BUSY_AT_ONCE)
        await self._clock.sleep_until(due_ns)

    def _has_time_before(self, due_ns: int) -> bool:
        clock = self._clock
        return clock.stands_before(due_ns) or due_ns - clock.now_ns() > SPARE_NS

    def _take_in(self, most: int) -> bool:
        """Take in what came, as of a time after all that is done and before all that is not.

        False if there is no such time before more is done.
        """
        as_of_ns = self.as_of_ns()
        if as_of_ns < self._done_ns:
            return False
        self._inbox.take(most, as_of_ns)
        return True

    async def _drained(self) -> None:
        result = self._drain()
        if asyncio.iscoroutine(result):
            await result

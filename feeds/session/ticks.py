"""Tick by tick: what has come in is taken in, and what all sensors will send is worked out.

Ticks are at multiples of `TICK_NS` on the time line, whenever a session began. Tick k takes in what
came before it, and works out all sectors that end in the stretch from k + 1 to k + 2: at a deadline
octets are ready, and only sent. So bytes depend on which telemetry came before which tick, and on
nothing else. Where simulated time runs as fast as it can and nothing comes in, one tick works out
what many would; what comes in waits for the next.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import itemgetter

from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS, MissedScans
from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.link.outbox import Departure, Outbox, prepare_all, send_all
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.outgoing import Outgoing
from plotfeed.feeds.session.inputs import SessionInputs
from plotfeed.feeds.session.observer import SessionContext, cares
from plotfeed.feeds.session.sensor_task import SensorTask
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.feeds.timing.schedule import ActionKind
from plotfeed.proto.utc import NS

TICK_NS = AHEAD_NS
LONGEST_NS = NS
"""No tick comes later than this after another, so that what comes in is taken in."""
CAUGHT_UP_NS = NS // 4
"""Further behind, a session that joins others is not ready."""
STAND_BY_S = 0.02
INTAKE_NS = TICK_NS // 2
"""Real time that a tick spends on what has come in; the rest waits for the next."""
MOST_SECTORS, MOST_TICKS = 512, 1000
"""Worked out by one tick where time is simulated: beyond, a sector hardly costs less any more."""
TICKS_BEHIND = 5
"""Of real time, 50 ms: at most so much is worked out by one tick where the clock is held back."""


class Ticks:
    """Plans itself in the schedule of a session."""

    def __init__(
        self,
        context: SessionContext,
        engine: Engine,
        tasks: Mapping[str, SensorTask],
        inputs: SessionInputs,
        cooperative: Outbox | None,
    ) -> None:
        self._context = context
        self._clock, self._schedule = context.clock, context.schedule
        self._engine, self._sensors = engine, engine.sensors
        self._tasks = tasks
        self._of_index = list(tasks.values())
        self._outboxes = [task.outbox for task in self._of_index]
        """By the index that batches have for whose sectors they hold."""
        if cooperative is not None:
            self._outboxes.append(cooperative)
        self._inputs = inputs
        self._shares = False
        """Whether others may have these sensors next: then what they remember is what it would be
        had this machine never been late."""
        self._reported = [o.report for o in context.observers if cares(o, "report")]
        self._hand_in = [o.next_input_ns for o in context.observers if cares(o, "next_input_ns")]
        self._due_ns: int | None = None
        """When the next one is planned."""
        self._earliest_ns = 0
        """When it may be at the earliest: what is worked out already was for those before."""
        self._at_once = 1
        """Ticks in one, where time is simulated or held back."""
        clock = self._clock
        self._most_at_once = MOST_TICKS if isinstance(clock, InstantClock) and clock.leaps else 1
        self.joined_ns = 0
        """What ends by then is not this session's to send: when it begins, if it has no others."""

    @property
    def sent_until_ns(self) -> int:
        """All that was due by then has left, or will not, UTC."""
        dues = [task.outbox.oldest_due_ns for task in self._of_index]
        due = [each for each in (*dues, self._schedule.next_due_ns()) if each is not None]
        return min([self._clock.now_ns(), *due]) - 1

    def take_not_sent(self) -> dict[str, tuple[int, int]]:
        """Tell once from when until when some of what was due did not leave, by sensor; UTC."""
        taken = {name: task.outbox.counters.take_not_sent() for name, task in self._tasks.items()}
        return {name: stretch for name, stretch in taken.items() if stretch is not None}

    async def stand_by(self, began_utc_ns: int, is_over: Callable[[], bool]) -> None:
        """Work out what others send, or have sent since the scene began, until that is over."""
        self._shares, done_ns = True, began_utc_ns
        while not is_over() or self._clock.now_ns() - done_ns > CAUGHT_UP_NS:
            if self._clock.now_ns() - done_ns < CAUGHT_UP_NS:
                await asyncio.sleep(STAND_BY_S)
                continue
            done_ns = self._clock.now_ns()
            self._inputs.take_in(done_ns, lambda: False)
            await self._catch_up(done_ns)

    async def join(self, t_utc_ns: int) -> None:
        """Send what ends after that time; what ends before is worked out."""
        self.joined_ns = t_utc_ns
        await self._catch_up(t_utc_ns)

    async def _catch_up(self, t_utc_ns: int) -> None:
        for _ in self._sensors.caught_up(t_utc_ns):
            await asyncio.sleep(0)  # another session of this process may have something to send

    def start(self, start_utc_ns: int) -> None:
        """Work out what ends until the second tick from now, and plan the next tick."""
        from_ns = start_utc_ns
        if self.joined_ns != start_utc_ns:
            from_ns = self._clock.now_ns()
            self._engine.skip_claims(self.joined_ns)
        self._work_out(from_ns // TICK_NS)

    def input_waits(self) -> None:
        """Something has come in: see to it that there is a tick soon."""
        now_ns = self._clock.now_ns()
        self._plan(max((now_ns // TICK_NS + 1) * TICK_NS, self._earliest_ns))

    def as_of_ns(self) -> int:
        """The time of what is asked for at once: by now, and before all that is not done.

        Where a tick has done the work of many, it counts for what is worked out next.
        """
        now_ns, next_ns = self._clock.now_ns(), self._schedule.next_due_ns()
        as_of_ns = now_ns if next_ns is None or now_ns < next_ns else next_ns - 1
        return max(as_of_ns, self._earliest_ns - TICK_NS)

    def _plan(self, due_ns: int) -> None:
        if self._due_ns is None or due_ns < self._due_ns:
            self._due_ns = due_ns
            self._schedule.put(due_ns, partial(self._tick, due_ns), ActionKind.BETWEEN)

    def _tick(self, due_ns: int) -> None:
        if due_ns != self._due_ns:
            return  # an earlier one was planned instead
        self._due_ns = None
        if isinstance(self._clock, WallClock):
            totals, speed = self._context.totals, self._clock.speed
            totals.speed, totals.speed_reached = speed, self._clock.reached
            is_behind = speed > 1 and self._clock.now_ns() - due_ns > TICK_NS
            self._most_at_once = min(int(TICKS_BEHIND * speed), MOST_TICKS) if is_behind else 1
            self._at_once = min(self._at_once, self._most_at_once)
        self._inputs.keep_up(due_ns - 1)
        if self._inputs:
            self._at_once = 1
            began_ns = self._clock.left_ns(due_ns)
            self._inputs.take_in(
                due_ns - 1, lambda: began_ns - self._clock.left_ns(due_ns) > INTAKE_NS
            )
        self._work_out(due_ns // TICK_NS)

    def _work_out(self, k: int) -> None:
        """What ends from tick k + 1 on, and plan when to send it."""
        now_ns = self._clock.now_ns()
        too_late_ns = self._leave_out(now_ns)
        ticks = self._ticks_from(k)
        if too_late_ns:  # by steps as long as when it joins: else it would be late for ever
            ticks = max(ticks, min(now_ns // TICK_NS - k, LONGEST_NS // TICK_NS))
        before_ns, sectors = (k + 1 + ticks) * TICK_NS, 0
        due: dict[int, list[tuple[int, Batch, int]]] = defaultdict(list)
        ready: list[tuple[Outbox, Sequence[Outgoing]]] = []
        if self._engine.cooperative is not None and not self._clock.can_wait:
            self._engine.skip_claims(now_ns - self._engine.cooperative.period_ns)
        for batch in self._engine.until(before_ns - 1):
            self.let_go()
            self._let_sendings_pass((k + 1) * TICK_NS)
            sectors += len(batch)
            of = batch.sectors.sensor.tolist()
            for row, due_ns in enumerate(batch.sectors.end_ns.tolist()):
                i = of[row]
                if too_late_ns and not self._in_time(batch, row, due_ns, too_late_ns):
                    continue
                due[due_ns].append((i, batch, row))
                ready.append((self._outboxes[i], batch.messages[row]))
        for together in due.values():
            together.sort(key=itemgetter(0))
        prepare_all(ready)
        self.let_go()
        for due_ns, together in due.items():
            self._schedule.put(due_ns, partial(self._send, together), ActionKind.SENDING)
        if sectors < MOST_SECTORS:
            self._at_once = min(2 * ticks, self._most_at_once)
        self._earliest_ns = (k + ticks) * TICK_NS
        self._plan(max(self._next_work_ns(k + ticks - 1), self._earliest_ns))
        if self._inputs:
            self.input_waits()

    def _leave_out(self, now_ns: int) -> dict[int, int]:
        """Leave out what is late by more than a period, or have it worked out and not sent.

        Of the latter sensors, by index, up to when what is due is not sent.
        """
        too_late_ns = {}
        for i in () if self._clock.can_wait else self._sensors.late(now_ns):
            if self._shares and self._sensors.remembers(i):
                too_late_ns[i] = now_ns - self._sensors.sensors[i].scan.period_ns
            else:
                self._missed(self._of_index[i], self._sensors.skip(i, now_ns))
        return too_late_ns

    def _missed(self, task: SensorTask, missed: MissedScans) -> None:
        task.missed(missed)
        self._context.totals.missed_scans += missed.scans

    def _in_time(self, batch: Batch, row: int, due_ns: int, too_late_ns: Mapping[int, int]) -> bool:
        """Whether a sector is still to be sent; else it is missed."""
        i = int(batch.sectors.sensor[row])
        if due_ns >= too_late_ns.get(i, due_ns):
            return True
        task = self._of_index[i]
        is_last = int(batch.sectors.index[row]) + 1 == task.sensor.scan.sectors
        self._missed(task, MissedScans(int(is_last), due_ns, due_ns))
        return False

    def _let_sendings_pass(self, before_ns: int) -> None:
        """Send what is due by now: no deadline waits for the sensors that are still to be done.

        What is due from then on waits for what this tick has yet to plan: a late machine changes
        neither the order of messages nor what a link's queue holds.
        """
        schedule, clock = self._schedule, self._clock
        while (due_ns := schedule.next_due_ns()) is not None and clock.left_ns(due_ns) <= 0:
            if due_ns >= before_ns or schedule.next_kind() < ActionKind.SENDING:
                break
            schedule.take()()

    def _next_work_ns(self, k: int) -> int:
        """The tick at which there is something to work out, or after tick k at the latest."""
        ends_ns = [k * TICK_NS + LONGEST_NS + TICK_NS]
        if (end_ns := self._engine.next_end_ns) is not None:
            ends_ns.append(end_ns)
        return (min(ends_ns) // TICK_NS - 1) * TICK_NS

    def _ticks_from(self, k: int) -> int:
        """How many are done at once: up to the next one before which something is handed in."""
        ticks = self._at_once
        for next_input_ns in self._hand_in:
            if (comes_ns := next_input_ns()) is not None:
                ticks = min(ticks, max(comes_ns // TICK_NS - k + 1, 1))
        return ticks

    def let_go(self) -> None:
        """Send what links held while they were down, when they are up again."""
        for i, at_utc_ns, one in self._engine.take_let_go():
            self._outboxes[i].let_go(one, at_utc_ns)

    def _send(self, sectors: Sequence[tuple[int, Batch, int]]) -> None:
        """Hand over what is due now."""
        keep, departures = self._context.keep_ledger, list[Departure]()
        for i, batch, row in sectors:
            on_complete = None if keep is None else partial(keep, batch, row)
            departures.append((self._outboxes[i], batch.messages[row], on_complete))
        send_all(departures)
        reported = [(i, batch, row) for i, batch, row in sectors if batch.claims is None]
        totals = self._context.totals
        for i, batch, row in reported:
            scan, looks, plots, false_alarms = batch.counts[row]
            totals.add(scan, looks, plots, false_alarms)
            self._of_index[i].reported(scan, plots)
        for tell in self._reported:
            for _, batch, row in reported:
                tell(batch.one(row))

"""A scene at work, told from top to bottom: connect, give an engine time, send what is due, end.

What has come in is taken in, and what all sensors will send is worked out, tick by tick. Ticks are
at multiples of `TICK_NS` on the time line, whenever a session began. Tick k takes in what came
before it, and works out all sectors that end in the stretch from k + 1 to k + 2: at a deadline
octets are ready, and only sent. So bytes depend on which telemetry came before which tick, and on
nothing else. Where simulated time runs as fast as it can and nothing comes in, one tick works out
what many would; what comes in waits for the next.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS, MissedScans
from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.intake import Intake
from plotfeed.feeds.engine.shedding import Shedding
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.ledger_messages import Kept, ledger_messages
from plotfeed.feeds.link.outbox import Departure, prepare_all, send_all
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message, records
from plotfeed.feeds.scene.changes import ClockCommand, Command, ControlError, command_of
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.loop import SessionLoop, cause_of, first_of
from plotfeed.feeds.session.observer import Observer, Tap, who_care
from plotfeed.feeds.session.outputs import Outputs
from plotfeed.feeds.session.part import PartHold, SessionPart
from plotfeed.feeds.session.presence import SessionPresence
from plotfeed.feeds.session.running_sensor import RunningSensor
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.timing.clock import ActionKind, Clock, InstantClock, Schedule, WallClock
from plotfeed.feeds.transport.brokers import Brokers, brokers_of
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.content_types import JSON, PROTOBUF
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.feeds.telemetry.live.mapped_reports import MappedReports
    from plotfeed.feeds.transport.live_source import LiveSource

FIRST_CONNECTION_S = 5.0
# A session that is told to stop waits so long for what its links still hold,
FLUSH_S = 0.5
# and so long for sockets to take the last messages.
FAREWELL_S = 0.8
TICK_NS = AHEAD_NS
# No tick comes later than this after another, so that what comes in is taken in.
LONGEST_NS = NS
# Further behind, a session that joins others is not ready.
CAUGHT_UP_NS = NS // 4
STAND_BY_S = 0.02
# Real time that a tick spends on what has come in; the rest waits for the next.
INTAKE_NS = TICK_NS // 2
# Worked out by one tick where time is simulated: beyond, a sector hardly costs less any more.
MOST_SECTORS, MOST_TICKS = 512, 1000
# Of real time, 50 ms: at most so much is worked out by one tick where the clock is held back.
TICKS_BEHIND = 5


async def run(
    scene: Scene,
    *,
    clock: Clock | None = None,
    broker: str | None = None,
    duration_s: float | None = None,
    stop: asyncio.Event | None = None,
    observers: Sequence[Observer] = (),
    tap: Callable[[Message, int], object] | None = None,
    on_ready: Callable[[dict[str, str], SessionCounters], None] | None = None,
) -> SessionCounters:
    """Run a scene until its duration is over or `stop` is set; raises `PlotfeedError`.

    `broker` is an mqtt:// address, "none" for no MQTT at all, and None for what the scene says.
    `observers` follow it from within; `tap`, as the simplest of them, is called with every message
    and the time at which it leaves. `on_ready` is told where to connect once everything stands,
    and is given the totals that grow from then on.
    """
    async with brokers_of(scene, broker) as brokers:
        return await run_over(
            brokers,
            scene,
            clock=clock or WallClock(scene.scene.start_utc_ns),
            duration_s=duration_s,
            stop=stop,
            observers=observers if tap is None else [Tap(tap), *observers],
            on_ready=on_ready,
        )


async def run_over(
    brokers: Brokers,
    scene: Scene,
    *,
    clock: Clock,
    duration_s: float | None = None,
    stop: asyncio.Event | None = None,
    observers: Sequence[Observer] = (),
    on_ready: Callable[[dict[str, str], SessionCounters], None] | None = None,
    part: SessionPart | None = None,
    hold: PartHold | None = None,
) -> SessionCounters:
    """Run a scene over brokers that outlast the session; closes the clock.

    `part` is for one of several sessions that share the sensors of the scene, and `hold` says when
    this process is the one that sends it.
    """
    totals, (addresses, urls) = SessionCounters(), brokers
    try:
        hold = hold or PartHold()
        session = Session(scene, clock, addresses, totals, observers, part=part, hold=hold)
        try:
            await session.run(
                scene.scene.duration_s if duration_s is None else duration_s,
                stop or asyncio.Event(),
                lambda: on_ready and on_ready(urls, totals),
            )
        finally:
            for observer in reversed(observers):
                observer.ended()
    except ExceptionGroup as group:  # of the task group: whoever called wants what went wrong
        raise cause_of(group) from None
    finally:
        clock.close()
    return totals


class Session:
    """An engine that is given time: what comes in, what goes out, and who follows that."""

    def __init__(
        self,
        scene: Scene,
        clock: Clock,
        addresses: Sequence[BrokerAddress],
        totals: SessionCounters,
        observers: Sequence[Observer],
        *,
        part: SessionPart | None = None,
        hold: PartHold,
    ) -> None:
        own = scene if part is None else part.scene_of(scene)
        # With the sensors of its part alone; drones and surroundings are those of the whole.
        self.scene = own
        self.clock, self.totals = clock, totals
        self.part, self._hold, self._observers = part, hold, observers
        self._others = frozenset() if part is None else part.others(scene)
        leads = part is None or part.leads
        self.start_ns = clock.now_ns() if part is None else part.began_utc_ns
        # What ends by then is not this session's to send: when it begins, if it has no others.
        self.joined_ns = 0
        engine = self.engine = Engine(
            scene, self.start_ns, sensors=None if part is None else part.sensors, claims=leads
        )
        engine.control_clock = self._control_clock
        engine.answer = lambda sensor, payload, t_ns: self.sensors[sensor].asked(payload, t_ns)
        self.trajectories, self.changes = engine.trajectories, engine.changes

        # What comes in.
        self._received = who_care(observers, "received")
        self._mapped: MappedReports | None = None
        if scene.telemetry.mapping:
            from plotfeed.feeds.telemetry.live.mapped_reports import MappedReports

            self._mapped = MappedReports(scene.telemetry.mapping)
        self.intake = Intake(
            engine,
            totals,
            self._publish,
            received=self._received,
            obeyed=self._obeyed,
            mapped=self._mapped,
            others=self._others,
            leads=leads,
        )
        self._root = f"{scene.mqtt.prefix}/telemetry/"
        self._sources = self._live_sources()
        # Of the tracker under test, a sensor's or a foreign one, where somebody follows it.
        topic = own.page.tracks_topic
        self._tracker_topics = [topic] if topic and who_care(observers, "tracked") else []

        # What is due when.
        self._schedule = Schedule(clock.wake)
        self._hand_in = who_care(observers, "next_input_ns")
        # When the next tick is planned, and when it may be at the earliest: what is worked out
        # already was for those before.
        self._tick_ns: int | None = None
        self._earliest_ns = 0
        # Ticks in one, where time is simulated or held back.
        self._at_once = 1
        self._most_at_once = MOST_TICKS if isinstance(clock, InstantClock) and clock.leaps else 1
        # Whether others may have these sensors next: then what they remember is what it would be
        # had this machine never been late.
        self._shares = False

        # What goes out.
        self._reported = who_care(observers, "report")
        self._presence = SessionPresence(own, clock, totals, self._publish, part=part, hold=hold)
        topics = [*engine.topics, self._presence.topic, *self._tracker_topics]
        topics += self._mapped.topics if self._mapped else []
        self._outputs = Outputs(
            own,
            addresses,
            clock=clock,
            schedule=self._schedule,
            totals=totals,
            before_link=who_care(observers, "before_link"),
            after_link=who_care(observers, "after_link"),
            hold=hold,
            topics=topics,
            on_message=self._hear,
            will=self._presence.will(self.start_ns),
        )
        self._outbox = self._outputs.of_session
        sea_level = own.sea_level()
        self._of_index = [
            RunningSensor(
                engine,
                i,
                self._outputs,
                sea_level=sea_level,
                changed=who_care(observers, "settings"),
                start_ns=self.start_ns,
            )
            for i in range(len(own.sensor))
        ]
        self.sensors: Mapping[str, RunningSensor] = {
            sensor.sensor.id: sensor for sensor in self._of_index
        }
        self._shedding = Shedding(engine.sensors, self._missed)
        self._cooperative = self._outputs.of_cooperative_drones()
        # By the index that batches have for whose sectors they hold.
        self._outboxes = [sensor.outbox for sensor in self._of_index]
        if self._cooperative is not None:
            self._outboxes.append(self._cooperative)
        waits = scene.mqtt.queue.policy == "wait"
        self._loop = SessionLoop(
            clock,
            self._schedule,
            inputs=self.intake,
            on_input=self._input_waits,
            drain=self._drain,
            write_later=self._write_ledger,
            before_due=who_care(observers, "before_due"),
            waits_for=self._outputs.brokers if waits else (),
        )
        self._settled, self._ledger = (who_care(observers, of) for of in ("settled", "ledger"))
        keeps_ledger = scene.mqtt.truth or self._settled or self._ledger
        self._keep = self._loop.later if keeps_ledger else lambda _: None

    # From the first connection to the last message.

    async def run(
        self, duration_s: float | None, stop: asyncio.Event, on_ready: Callable[[], object]
    ) -> None:
        """Connect, work until the end, say goodbye."""
        hold = self._hold
        with contextlib.ExitStack() as sockets:
            for udp in self._outputs.udp:
                sockets.callback(udp.close)
                udp.open()
            for source in self._sources:
                sockets.callback(source.close)
                await source.open()
            async with asyncio.TaskGroup() as tasks:
                running: list[asyncio.Task[None]] = []
                try:
                    async with hold.kept(self, tasks):
                        end_ns = self._end_ns(duration_s)
                        await first_of(hold.wait_for_turn(self, end_ns), stop.wait())
                        if hold.is_claimed:  # else another process has the part
                            await self._run(duration_s, stop, on_ready, tasks, running)
                finally:
                    if hold.is_taken:
                        self._outputs.forget_wills()
                    for task in running:
                        task.cancel()

    async def _run(
        self,
        duration_s: float | None,
        stop: asyncio.Event,
        on_ready: Callable[[], object],
        tasks: asyncio.TaskGroup,
        running: list[asyncio.Task[None]],
    ) -> None:
        """Connect, and work until the end; what runs meanwhile is noted in `running`."""
        for kind, kept_up in (("link", self._outputs.connected), ("source", self._sources)):
            running += [
                tasks.create_task(each.run(), name=f"{kind}[{each.name}]") for each in kept_up
            ]
        await first_of(self._connected(), stop.wait())
        if stop.is_set():
            self._outputs.forget_wills()
            return  # nothing has begun
        if self.part is None:
            self.totals.unseen, self.totals.doubts = self.engine.foreseen(duration_s)
        on_ready()
        start_ns = self.clock.start()
        if self.part is None:
            self.start_ns = self.joined_ns = start_ns
            self.engine.start(start_ns)
        else:
            await self._join(self.part)
        await first_of(self._work(duration_s), stop.wait())
        await self._flush(stop)
        await self._farewell(running[len(self._outbox.transports) :])

    async def _connected(self) -> None:
        for transport in self._outputs.connected:
            await transport.wait_until_up(FIRST_CONNECTION_S)

    def _end_ns(self, duration_s: float | None) -> int | None:
        return None if duration_s is None else self.start_ns + round(duration_s * NS)

    async def stand_by(self, is_over: Callable[[], bool]) -> None:
        """Work out what others send, or have sent since the scene began, until that is over."""
        self._shares, done_ns = True, self.start_ns
        sensors = self.engine.sensors
        self._shedding.spare([i for i in range(len(sensors.sensors)) if sensors.remembers(i)])
        while not is_over() or self.clock.now_ns() - done_ns > CAUGHT_UP_NS:
            if self.clock.now_ns() - done_ns < CAUGHT_UP_NS:
                await asyncio.sleep(STAND_BY_S)
                continue
            done_ns = self.clock.now_ns()
            self.intake.take_in(done_ns, lambda: False)
            await self._catch_up(done_ns)

    async def _join(self, part: SessionPart) -> None:
        """Go on at once with what nobody has sent yet, or begin when the scene does."""
        self.joined_ns = max(self.clock.now_ns() + self._hold.margin_ns, part.began_utc_ns)
        await self._catch_up(self.joined_ns)
        self._hold.begin()

    async def _catch_up(self, t_utc_ns: int) -> None:
        for _ in self.engine.sensors.caught_up(t_utc_ns):
            await asyncio.sleep(0)  # another session of this process may have something to send

    async def _work(self, duration_s: float | None) -> None:
        """Start everything, and do what is due until the end."""
        self.totals.drones = len(self.trajectories)
        for observer in self._observers:
            observer.begun(self)
        self._presence.begin(self.start_ns)
        from_ns = self.start_ns
        if self.joined_ns != from_ns:
            from_ns = self.clock.now_ns()
            self.engine.skip_claims(self.joined_ns)
        self._work_out(from_ns // TICK_NS)
        for sensor in self._of_index:
            sensor.start(self.start_ns, self.joined_ns)
        await self._loop.work(self._end_ns(duration_s))

    async def _flush(self, stop: asyncio.Event) -> None:
        """Deliver what links hold: all of it after a set time, what is near when told to stop."""
        if not stop.is_set():
            await first_of(self._loop.finish(ActionKind.DELIVERY), stop.wait())
        if stop.is_set():
            self.clock.wake()
            if isinstance(self.clock, WallClock):
                self.clock.resume()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(FLUSH_S):
                    await self._loop.finish(ActionKind.SENDING)

    async def _farewell(self, kept_up: Sequence[asyncio.Task[None]]) -> None:
        """Mark every sensor offline, let the sockets empty, and write what became of the rest."""
        for sensor in self._of_index:
            sensor.end()
        if self._cooperative is not None:
            self._cooperative.end()
        self._presence.end()
        await self._drain()
        self._outputs.forget_wills()
        for task in kept_up:
            task.cancel()
        await asyncio.gather(*kept_up, return_exceptions=True)
        self._outputs.give_up()
        self._loop.do_all_later()
        await self._outbox.drain(FAREWELL_S / 2)

    async def _drain(self) -> None:
        self._presence.tell_speed()
        await self._outputs.drain(FAREWELL_S)

    # What comes in.

    def _live_sources(self) -> list[LiveSource]:
        """The sources of the scene, not open yet; raises `PlotfeedError` where one cannot be."""
        sources = self.scene.outgoing.sources
        if not sources:
            return []
        if not (isinstance(self.clock, WallClock) and self.clock.is_real):
            raise PlotfeedError(
                "telemetry.source: live sources need real time: "
                "neither start_utc nor another --speed"
            )
        from plotfeed.feeds.transport.live_source import LiveSource

        def refuse(kind: str, drone: str, refused: Refused) -> None:
            self.intake.refuse_later(self._root + (drone or kind), refused)

        return [
            LiveSource(
                source,
                now_utc_ns=self.clock.now_ns,
                take=self._take_report,
                refuse=partial(refuse, source.address.kind),
            )
            for source in sources
        ]

    def _take_report(self, drone: str, report: PositionReport) -> None:
        """Treat what a live source or a mapped topic tells as if its drone had published it."""
        self._loop.queue_input(self._root + drone, report.to_protobuf(), PROTOBUF)

    def _hear(self, topic: str, payload: bytes, content_type: str | None) -> None:
        if topic == self._presence.topic:
            self._presence.hear(payload)
            return
        if topic in self._tracker_topics:
            now_ns = self.clock.now_ns()
            for each in self._observers:
                each.tracked(topic, payload, content_type, now_ns)
            return
        if self._mapped is not None and self._mapped.maps(topic):
            content_type = f"{self.clock.now_ns()}"  # a mapping asks for no type
        self._loop.queue_input(topic, payload, content_type)

    def command(self, command: dict[str, Any]) -> dict[str, Any]:
        """Do now what might have come in as a command, and say what is in force.

        To whoever records the session it is a command like those that come in. Raises
        `PlotfeedError`.
        """
        # By now, and before all that is not done; where a tick has done the work of many, it counts
        # for what is worked out next.
        now_ns, next_ns = self.clock.now_ns(), self._schedule.next_due_ns()
        t_utc_ns = now_ns if next_ns is None or now_ns < next_ns else next_ns - 1
        t_utc_ns = max(t_utc_ns, self._earliest_ns - 1)
        payload = json.dumps(command).encode()
        for received in self._received:
            received(self.engine.control_topic, payload, JSON, t_utc_ns)
        asked = command_of(command)
        in_force = self.engine.obey(asked, t_utc_ns)
        self._obeyed(asked, t_utc_ns)
        self.totals.controls += 1
        return in_force

    def _obeyed(self, command: Command, at_utc_ns: int) -> None:
        """Tell what a command has changed."""
        for name in self.changes.take_changed():
            self.sensors[name].follow(at_utc_ns)
        self._let_go()
        for observer in self._observers:
            observer.obeyed(command, at_utc_ns)

    def _control_clock(self, command: ClockCommand) -> dict[str, Any]:
        clock = self.clock
        if not isinstance(clock, WallClock) or clock.is_real or self._others:
            raise ControlError("clock: real time cannot be held or hurried; run a simulated clock")
        if command.speed is not None:
            clock.set_speed(command.speed)
        if command.paused is not None:
            (clock.pause if command.paused else clock.resume)()
        if command.step_s is not None:
            clock.step(round(command.step_s * NS))
        return {"paused": clock.is_paused, "speed": clock.speed}

    # Tick by tick.

    def _input_waits(self) -> None:
        """Something has come in: see to it that there is a tick soon."""
        now_ns = self.clock.now_ns()
        self._plan_tick(max((now_ns // TICK_NS + 1) * TICK_NS, self._earliest_ns))

    def _plan_tick(self, due_ns: int) -> None:
        if self._tick_ns is None or due_ns < self._tick_ns:
            self._tick_ns = due_ns
            self._schedule.put(due_ns, partial(self._tick, due_ns), ActionKind.BETWEEN)

    def _tick(self, due_ns: int) -> None:
        if due_ns != self._tick_ns:
            return  # an earlier one was planned instead
        self._tick_ns = None
        clock = self.clock
        if isinstance(clock, WallClock):
            speed = self.totals.speed = clock.speed
            self.totals.speed_reached = clock.reached
            is_behind = speed > 1 and clock.now_ns() - due_ns > TICK_NS
            self._most_at_once = min(int(TICKS_BEHIND * speed), MOST_TICKS) if is_behind else 1
            self._at_once = min(self._at_once, self._most_at_once)
        self.intake.keep_up(due_ns - 1)
        if self.intake:
            self._at_once = 1
            began_ns = clock.left_ns(due_ns)
            self.intake.take_in(due_ns - 1, lambda: began_ns - clock.left_ns(due_ns) > INTAKE_NS)
        self._work_out(due_ns // TICK_NS)

    def _work_out(self, k: int) -> None:
        """What ends from tick k + 1 on, and plan when to send it."""
        now_ns = self.clock.now_ns()
        too_late_ns = self._leave_out(now_ns)
        ticks = self._at_once
        for next_input_ns in self._hand_in:  # before which something is handed in
            if (comes_ns := next_input_ns()) is not None:
                ticks = min(ticks, max(comes_ns // TICK_NS - k + 1, 1))
        if not self.clock.can_wait:
            before_ns, slept_ns = (k + 1 + ticks) * TICK_NS, self._loop.slept_ns
            self._shedding.look(now_ns, k * TICK_NS, before_ns, slept_ns)
        if too_late_ns:  # by steps as long as when it joins: else it would be late for ever
            ticks = max(ticks, min(now_ns // TICK_NS - k, LONGEST_NS // TICK_NS))
        before_ns, sectors = (k + 1 + ticks) * TICK_NS, 0
        due: dict[int, list[tuple[int, Departure[Kept]]]] = defaultdict(list)
        engine = self.engine
        if engine.cooperative is not None and not self.clock.can_wait:
            engine.skip_claims(now_ns - engine.cooperative.period_ns)
        for batch in engine.until(before_ns - 1):
            self._let_go()
            self._let_sendings_pass((k + 1) * TICK_NS)
            sectors += len(batch)
            of, ends_ns = batch.sectors.sensor.tolist(), batch.sectors.end_ns.tolist()
            for row, (i, due_ns) in enumerate(zip(of, ends_ns, strict=True)):
                if not too_late_ns or self._in_time(batch, row, due_ns, too_late_ns):
                    departure = self._outboxes[i], batch.messages[row], (batch, row)
                    due[due_ns].append((i, departure))
        for due_ns, together in due.items():
            together.sort(key=itemgetter(0))
            departures = [departure for _, departure in together]
            prepare_all(departures)
            self._schedule.put(due_ns, partial(self._send, departures), ActionKind.SENDING)
        self._let_go()
        self._shedding.took(self.clock.now_ns() - now_ns, sectors)
        if sectors < MOST_SECTORS:
            self._at_once = min(2 * ticks, self._most_at_once)
        self._earliest_ns = (k + ticks) * TICK_NS
        # Next where there is something to work out, or soon enough for what comes in.
        ends_ns = [(k + ticks) * TICK_NS + LONGEST_NS]
        if (end_ns := engine.next_end_ns) is not None:
            ends_ns.append(end_ns)
        self._plan_tick(max((min(ends_ns) // TICK_NS - 1) * TICK_NS, self._earliest_ns))
        if self.intake:
            self._input_waits()

    def _leave_out(self, now_ns: int) -> dict[int, int]:
        """Leave out what is late by more than a period, or have it worked out and not sent.

        Of the latter sensors, by index, up to when what is due is not sent.
        """
        too_late_ns, sensors = {}, self.engine.sensors
        for i in () if self.clock.can_wait else sensors.late(now_ns):
            if self._shares and sensors.remembers(i):
                too_late_ns[i] = now_ns - sensors.sensors[i].scan.period_ns
            else:
                self._missed(i, sensors.skip(i, now_ns))
        return too_late_ns

    def _missed(self, i: int, missed: MissedScans) -> None:
        self._of_index[i].missed(missed)
        self.totals.missed_scans += missed.scans

    def _in_time(self, batch: Batch, row: int, due_ns: int, too_late_ns: Mapping[int, int]) -> bool:
        """Whether a sector is still to be sent; else it is missed."""
        i = int(batch.sectors.sensor[row])
        if due_ns >= too_late_ns.get(i, due_ns):
            return True
        is_last = int(batch.sectors.index[row]) + 1 == self._of_index[i].sensor.scan.sectors
        self._missed(i, MissedScans(int(is_last), due_ns, due_ns))
        return False

    # What goes out.

    def _publish(self, message: Message) -> None:
        self._outbox.send_past_link(message)

    def _let_sendings_pass(self, before_ns: int) -> None:
        """Send what is due by now: no deadline waits for the sensors that are still to be done.

        What is due from then on waits for what this tick has yet to plan: a late machine changes
        neither the order of messages nor what a link's queue holds.
        """
        schedule, clock = self._schedule, self.clock
        while (due_ns := schedule.next_due_ns()) is not None and clock.left_ns(due_ns) <= 0:
            if due_ns >= before_ns or schedule.next_kind() < ActionKind.SENDING:
                break
            schedule.take()()

    def _let_go(self) -> None:
        """Send what links held while they were down, when they are up again."""
        for i, at_utc_ns, one in self.engine.take_let_go():
            self._outboxes[i].let_go(one, at_utc_ns)

    def _send(self, departures: Sequence[Departure[Kept]]) -> None:
        """Hand over what is due now; the ledger has it when its fate is known."""
        began_ns = self.clock.now_ns()
        send_all(departures, self._keep)
        reported = [kept for _, _, kept in departures if kept[0].claims is None]
        if reported:
            self.totals.add([batch.counts[row] for batch, row in reported])
        for batch, row in reported:
            scan, _, plots, _ = batch.counts[row]
            self._of_index[batch.sectors.sensor[row]].reported(scan, plots)
        for tell in self._reported:
            for batch, row in reported:
                tell(batch.one(row))
        self._shedding.took(self.clock.now_ns() - began_ns)

    def _write_ledger(self, kept: Sequence[Kept]) -> None:
        """Make entries of all sectors whose turn has come, which leave together."""
        for tell in self._settled:
            for batch, row in kept:
                tell(batch.one(row), records(batch.messages[row]))
        messages = ledger_messages(self.scene.mqtt.prefix, kept)
        for tell in self._ledger:
            for message in messages:
                tell(message)
        if self.scene.mqtt.truth:
            self._outbox.send_past_link(*messages)

    # What a part says of itself.

    @property
    def sent_until_ns(self) -> int:
        """All that was due by then has left, or will not, UTC."""
        dues = [sensor.outbox.oldest_due_ns for sensor in self._of_index]
        due = [each for each in (*dues, self._schedule.next_due_ns()) if each is not None]
        return min([self.clock.now_ns(), *due]) - 1

    def take_not_sent(self) -> dict[str, tuple[int, int]]:
        """Tell once from when until when some of what was due did not leave, by sensor; UTC."""
        taken = {name: s.outbox.counters.take_not_sent() for name, s in self.sensors.items()}
        return {name: stretch for name, stretch in taken.items() if stretch is not None}

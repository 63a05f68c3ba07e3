"""Puts a scene together and runs it: the one place that knows everybody."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.ledger_writer import Kept, LedgerWriter
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.bounded_queue import QueueStatistics
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import records
from plotfeed.feeds.scene.changes import Command
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.inputs import SessionInputs
from plotfeed.feeds.session.listening import sources_of, taker_of_mapped
from plotfeed.feeds.session.loop import SessionLoop, cause_of, first_of
from plotfeed.feeds.session.observer import Input, Observer, SessionContext, Tap, cares
from plotfeed.feeds.session.outputs import Brokers, Outputs, brokers_of
from plotfeed.feeds.session.presence import SessionPresence
from plotfeed.feeds.session.sensor_description import SensorDescriber
from plotfeed.feeds.session.sensor_task import SensorTask
from plotfeed.feeds.session.ticks import Ticks
from plotfeed.feeds.timing.clock import Clock, WallClock
from plotfeed.feeds.timing.schedule import ActionKind, Schedule
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.feeds.session.session_part import PartHold, SessionPart

FIRST_CONNECTION_S = 5.0
FLUSH_S = 0.5
"""A session that is told to stop waits so long for what its links still hold."""
FAREWELL_S = 0.8
"""And so long for sockets to take the last messages."""


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


async def run_part(
    part: SessionPart, *, scene: Scene, broker: str | None, **session: Any
) -> SessionCounters:
    """Run some of a scene's sensors, as `run_over` does; raises `PlotfeedError`."""
    async with brokers_of(scene, broker) as brokers:
        return await run_over(brokers, scene, part=part, **session)


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
) -> SessionCounters:
    """Run a scene over brokers that outlast the session; closes the clock.

    `part` is for one of several sessions that share the sensors of the scene.
    """
    totals, (addresses, urls) = SessionCounters(), brokers
    try:
        session = Session(scene, clock, addresses, totals, observers, part=part)
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
    """A scene at work: a task for each sensor, what comes in, what goes out, and one loop."""

    def __init__(
        self,
        scene: Scene,
        clock: Clock,
        addresses: Sequence[BrokerAddress],
        totals: SessionCounters,
        observers: Sequence[Observer],
        *,
        part: SessionPart | None = None,
    ) -> None:
        own = scene if part is None else part.scene_of(scene)
        self.scene = own
        """With the sensors of its part alone; drones and surroundings are those of the whole."""
        self._part = part
        self.clock = clock
        self.totals = totals
        self.start_ns = clock.now_ns() if part is None else part.began_utc_ns
        self.engine = Engine(
            scene,
            self.start_ns,
            sensors=None if part is None else part.sensors,
            claims=part is None or part.leads,
        )
        self.trajectories = self.engine.trajectories
        self.changes = self.engine.changes
        self.sensor_tasks: dict[str, SensorTask] = {}
        self._observers = observers
        ledger_is_wanted = scene.mqtt.truth or any(o.wants_ledger for o in observers)
        self._ledger = LedgerWriter(scene.mqtt.prefix)
        context = SessionContext(
            scene=own,
            clock=clock,
            schedule=Schedule(clock.wake),
            totals=totals,
            observers=observers,
            describer=SensorDescriber(own),
            keep_ledger=self._keep_ledger if ledger_is_wanted else None,
        )
        self._inputs = SessionInputs(
            context,
            self.engine,
            self.sensor_tasks,
            self._publish,
            self._obey,
            others=frozenset() if part is None else part.others(scene),
            leads=part is None or part.leads,
        )
        self._loop = SessionLoop[Kept](
            clock,
            context.schedule,
            inputs=self._inputs,
            drain=self._drain,
            write_later=self._write_ledger,
            before_due=[o.before_due for o in observers if cares(o, "before_due")],
        )
        self._hold: PartHold | None = None
        """Whether this process has its part, where others may take it over at a broker."""
        if part is not None and addresses:
            from plotfeed.feeds.session.session_part import PartHold

            self._hold = PartHold(part, context, addresses[0])
        self._outputs = Outputs(context, addresses, self._hold)
        process = None if self._hold is None else self._hold.process
        self._presence = SessionPresence(
            own, clock, totals, self._publish, part=part, process=process
        )
        mapped = None
        if scene.telemetry.mapping:
            from plotfeed.feeds.telemetry.live.mapped_reports import MappedReports

            mapped = MappedReports(scene.telemetry.mapping)
        self._tracker_topics = context.tracker_topics
        topics = [*self._inputs.topics, self._presence.topic, *self._tracker_topics]
        topics += mapped.topics if mapped else []
        will = self._presence.will(self.start_ns)
        self._outbox = self._outputs.of_session(topics, self._hear, will)
        engine = self.engine
        for i, sensor in enumerate(own.sensor):
            outbox, announcer = self._outputs.of_sensor(sensor, self.start_ns)
            self.sensor_tasks[sensor.id] = SensorTask(engine, i, outbox, context, announcer)
        self._cooperative = self._outputs.of_cooperative_drones()
        self.ticks = Ticks(context, engine, self.sensor_tasks, self._inputs, self._cooperative)
        self._loop.on_input = self.ticks.input_waits
        self._take_mapped = taker_of_mapped(
            mapped, scene, clock, self._loop.queue_input, self._inputs.refuse_later
        )
        self._sources = sources_of(scene, clock, self._loop.queue_input, self._inputs.refuse_later)
        if scene.mqtt.queue.policy == "wait":
            self._loop.wait_for(self._outputs.brokers)

    def receive(self, inputs: Sequence[Input], t_utc_ns: int) -> None:
        """Take in telemetry and commands together, as of that time."""
        self._inputs.receive(inputs, t_utc_ns)

    def command(self, command: dict[str, Any]) -> dict[str, Any]:
        """Do now what might have come in as a command, and say what is in force.

        Raises `PlotfeedError`.
        """
        return self._inputs.command(command, self.ticks.as_of_ns())

    @property
    def input_queue(self) -> QueueStatistics:
        """What has come in, and waits to be taken in."""
        return self._inputs.statistics()

    async def run(
        self, duration_s: float | None, stop: asyncio.Event, on_ready: Callable[[], object]
    ) -> None:
        """Connect, work until the end, say goodbye."""
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
                    if self._hold is None:
                        await self._run(duration_s, stop, on_ready, tasks, running)
                    else:
                        async with self._hold.kept(tasks):
                            await first_of(self._stand_by(self._hold, duration_s), stop)
                            if self._hold.is_claimed:  # else another process has the part
                                await self._run(duration_s, stop, on_ready, tasks, running)
                finally:
                    if self._hold is not None and self._hold.is_taken:
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
        running += [
            tasks.create_task(each.run(), name=f"link[{each.name}]")
            for each in self._outputs.connected
        ]
        running += [
            tasks.create_task(each.run(), name=f"source[{each.name}]") for each in self._sources
        ]
        await first_of(self._connected(), stop)
        if stop.is_set():
            self._outputs.forget_wills()
            return  # nothing has begun
        if self._part is None:
            self.totals.unseen, self.totals.doubts = self.engine.foreseen(duration_s)
        on_ready()
        start_ns = self.clock.start()
        if self._part is None:
            self.start_ns = self.ticks.joined_ns = start_ns
            self.engine.start(start_ns)
        else:
            await self._join(self._part)
        await first_of(self._work(duration_s), stop)
        await self._flush(stop)
        await self._farewell(running[len(self._outbox.transports) :])

    async def _stand_by(self, hold: PartHold, duration_s: float | None) -> None:
        """Work out what another process of the part sends, until this one has the part."""
        end_ns = None if duration_s is None else self.start_ns + round(duration_s * NS)

        def has_ended() -> bool:
            return end_ns is not None and self.clock.now_ns() >= end_ns

        await hold.watch.wait_until_up(FIRST_CONNECTION_S)
        await self.ticks.stand_by(self.start_ns, lambda: hold.is_free or has_ended())
        if not has_ended():
            hold.claim()

    async def _join(self, part: SessionPart) -> None:
        """Go on at once with what nobody has sent yet, or begin when the scene does."""
        if self._hold is None:
            await self.ticks.stand_by(part.began_utc_ns, lambda: True)
        from plotfeed.feeds.session.session_part import MARGIN_NS

        margin_ns = 0 if self._hold is None else MARGIN_NS
        await self.ticks.join(max(self.clock.now_ns() + margin_ns, part.began_utc_ns))
        if self._hold is not None:
            self._hold.begin(self.ticks)

    async def _connected(self) -> None:
        for transport in self._outputs.connected:
            await transport.wait_until_up(FIRST_CONNECTION_S)

    def _hear(self, topic: str, payload: bytes, content_type: str | None) -> None:
        if topic == self._presence.topic:
            self._presence.hear(payload)
        elif topic in self._tracker_topics:
            for each in self._observers:
                each.tracked(topic, payload, content_type, self.clock.now_ns())
        elif self._take_mapped is None or not self._take_mapped(topic, payload):
            self._loop.queue_input(topic, payload, content_type)

    def _obey(self, command: Command, at_utc_ns: int) -> dict[str, Any]:
        """Do what a command asks of sensors, drones or stories, and tell what changed."""
        in_force = self.changes.obey(command, at_utc_ns)
        for name in self.changes.take_changed():
            self.sensor_tasks[name].follow(at_utc_ns)
        self.ticks.let_go()
        return in_force

    def _publish(self, message: Message) -> None:
        self._outbox.send_past_link(message)

    def _keep_ledger(self, batch: Batch, row: int) -> None:
        """Put what is true on the truth topic when there is time."""
        self._loop.later((batch, row))

    def _write_ledger(self, kept: Sequence[Kept]) -> None:
        """Make entries of all sectors whose turn has come, which leave together."""
        for observer in self._observers:
            if cares(observer, "settled"):
                for batch, row in kept:
                    observer.settled(batch.one(row), records(batch.messages[row]))
        messages = self._ledger.messages(kept)
        for observer in self._observers:
            for message in messages:
                observer.ledger(message)
        if self.scene.mqtt.truth:
            self._outbox.send_past_link(*messages)

    async def _work(self, duration_s: float | None) -> None:
        """Start everything, and do what is due until the end."""
        end_ns = None if duration_s is None else self.start_ns + round(duration_s * NS)
        self.totals.drones = len(self.trajectories)
        for observer in self._observers:
            observer.begun(self)
        self._presence.begin(self.start_ns)
        self.ticks.start(self.start_ns)
        for task in self.sensor_tasks.values():
            task.start(self.start_ns, self.ticks.joined_ns)
        await self._loop.work(end_ns)

    async def _flush(self, stop: asyncio.Event) -> None:
        """Deliver what links hold: all of it after a set time, what is near when told to stop."""
        if not stop.is_set():
            await first_of(self._loop.finish(ActionKind.DELIVERY), stop)
        if stop.is_set():
            self.clock.wake()
            if isinstance(self.clock, WallClock):
                self.clock.resume()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(FLUSH_S):
                    await self._loop.finish(ActionKind.SENDING)

    async def _farewell(self, sensors: Sequence[asyncio.Task[None]]) -> None:
        """Mark every sensor offline, let the sockets empty, and write what became of the rest."""
        for sensor_task in self.sensor_tasks.values():
            sensor_task.end()
        if self._cooperative is not None:
            self._cooperative.end()
        self._presence.end()
        await self._drain()
        self._outputs.forget_wills()
        for task in sensors:
            task.cancel()
        await asyncio.gather(*sensors, return_exceptions=True)
        self._outputs.give_up()
        self._loop.do_all_later()
        await self._outbox.drain(FAREWELL_S / 2)

    async def _drain(self) -> None:
        self._presence.tell_speed()
        await self._outputs.drain(FAREWELL_S)

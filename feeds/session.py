"""Puts a scene together and runs it: the one place that knows everybody."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Sequence
from functools import partial

from plotfeed.feeds.agenda import Agenda
from plotfeed.feeds.broker_address import BrokerAddress
from plotfeed.feeds.clock import Clock, InstantClock, WallClock
from plotfeed.feeds.cloud_events import attributes
from plotfeed.feeds.cooperation import COOPERATIVE
from plotfeed.feeds.cooperative_drones import CooperativeDesk, CooperativeDrones
from plotfeed.feeds.desk import Desk, Herald, Totals, status_message
from plotfeed.feeds.fleet import launch
from plotfeed.feeds.intake import Intake
from plotfeed.feeds.message import PROTOBUF, Message
from plotfeed.feeds.mqtt import MqttLink
from plotfeed.feeds.outbox import Connection, Link, Outbox, Tap
from plotfeed.feeds.sapient import extra as sapient_extra
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import Sensor
from plotfeed.feeds.session_brokers import brokers_of
from plotfeed.feeds.station import SectorReport, Station
from plotfeed.feeds.udp import UdpLink
from plotfeed.models.truth import NS, Trajectories
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.batch import ledger

FIRST_CONNECTION_S = 5.0
FAREWELL_S = 1.0
DRAIN_EVERY_NS = 20 * NS
"""A simulated clock lets the sockets catch up this often."""


async def run(
    scene: Scene,
    *,
    clock: Clock | None = None,
    broker: str | None = None,
    duration_s: float | None = None,
    stop: asyncio.Event | None = None,
    tap: Tap | None = None,
    on_ready: Callable[[dict[str, str], Totals], None] | None = None,
) -> Totals:
    """Run a scene until its duration is over or `stop` is set; raises `PlotfeedError`.

    `broker` is an mqtt:// address, "none" for no MQTT at all, and None for what the scene says.
    `tap` sees every message as it leaves; `on_ready` is told where to connect once everything
    stands, and is given the totals that grow from then on.
    """
    clock = clock or WallClock(scene.scene.start_utc_ns)
    totals = Totals()
    try:
        async with brokers_of(scene, broker) as (addresses, urls):
            session = Session(scene, clock, addresses, totals, tap)
            await session.run(
                scene.scene.duration_s if duration_s is None else duration_s,
                stop,
                lambda: on_ready and on_ready(urls, totals),
            )
    except ExceptionGroup as group:  # of the task group: whoever called wants what went wrong
        raise _cause(group) from None
    finally:
        clock.close()
    return totals


def _cause(group: ExceptionGroup[Exception]) -> Exception:
    first = group.exceptions[0]
    return _cause(first) if isinstance(first, ExceptionGroup) else first


class Session:
    """A scene at work: a desk for each sensor, an office for telemetry and truth, one agenda."""

    def __init__(
        self,
        scene: Scene,
        clock: Clock,
        addresses: Sequence[BrokerAddress],
        totals: Totals,
        tap: Tap | None,
    ) -> None:
        self._scene = scene
        self._clock = clock
        self._totals = totals
        self._agenda = Agenda()
        self._start_ns = clock.now_ns()
        self._trajectories = Trajectories(stale_after_s=scene.telemetry.stale_after_s)
        self._intake = Intake(scene, self._trajectories)
        launch(scene, self._trajectories, self._start_ns)
        self._links: list[Connection] = []
        self._udp = [UdpLink(to, f"udp[{i}]") for i, to in enumerate(scene.udp)]
        office_links = self._office_links(addresses)
        self._office = Outbox(clock, office_links, tap)
        self._desks = [self._desk(sensor, addresses, tap) for sensor in scene.sensor]
        self._cooperative = self._cooperative_desk(office_links, tap)

    async def run(
        self, duration_s: float | None, stop: asyncio.Event | None, on_ready: Callable[[], object]
    ) -> None:
        """Connect, work until the end, say goodbye."""
        with contextlib.ExitStack() as sockets:
            for udp_link in self._udp:
                sockets.callback(udp_link.close)
                udp_link.open()
            await self._run(duration_s, stop, on_ready)

    async def _run(
        self, duration_s: float | None, stop: asyncio.Event | None, on_ready: Callable[[], object]
    ) -> None:
        async with asyncio.TaskGroup() as tasks:
            running = [tasks.create_task(x.run(), name=f"link[{x.name}]") for x in self._links]
            try:
                for link in self._links:
                    await link.wait_until_up(FIRST_CONNECTION_S)
                on_ready()
                self._start_ns = self._clock.start()
                await _first_of(self._work(duration_s), stop)
                await self._farewell()
            finally:
                for task in running:
                    task.cancel()

    def _office_links(self, addresses: Sequence[BrokerAddress]) -> list[MqttLink]:
        links = [
            MqttLink(
                address,
                "plotfeed-session",
                subscribe=[self._intake.topic],
                on_message=self._telemetry_came,
            )
            for address in addresses
        ]
        self._links.extend(links)
        return links

    def _desk(self, sensor: Sensor, addresses: Sequence[BrokerAddress], tap: Tap | None) -> Desk:
        """A sensor is a client of its own: its last will is that it is offline."""
        prefix = self._scene.mqtt.prefix
        offline = pb.SensorStatus(sensor=sensor.id, state=pb.SensorStatus.OFFLINE)
        will = status_message(prefix, offline, self._start_ns)
        herald = sapient_extra.herald(self._scene, sensor)
        greet = None if herald is None else partial(self._greet_again, herald)
        links: list[Connection] = [
            MqttLink(address, f"plotfeed-{sensor.id}", will=will, on_connect=greet)
            for address in addresses
        ]
        links += sapient_extra.middleware_links(self._scene, herald, self._clock)
        self._links.extend(links)
        udp_links = [link for link in self._udp if link.settings.takes(sensor.id)]
        return Desk(
            Station(self._scene, sensor, self._trajectories),
            Outbox(self._clock, [*links, *udp_links], tap),
            prefix=prefix,
            clock=self._clock,
            agenda=self._agenda,
            totals=self._totals,
            keep_ledger=self._keep_ledger,
            herald=herald,
        )

    def _cooperative_desk(
        self, office_links: Sequence[Link], tap: Tap | None
    ) -> CooperativeDesk | None:
        """Drones of the scene that report themselves, if it has any."""
        settings = self._scene.cooperative
        if settings is None:
            return None
        udp_links = [link for link in self._udp if link.settings.takes(COOPERATIVE)]
        return CooperativeDesk(
            CooperativeDrones(self._scene, settings, self._trajectories),
            Outbox(self._clock, [*office_links, *udp_links], tap),
            clock=self._clock,
            agenda=self._agenda,
            totals=self._totals,
        )

    def _greet_again(self, herald: Herald, link: MqttLink) -> None:
        """A connection that was lost hears anew who the sensor is; the first one is told anyway."""
        if link.connections > 1:
            for message in herald.opening(self._clock.now_ns()):
                link.publish(message)

    def _telemetry_came(self, topic: str, payload: bytes, content_type: str | None) -> None:
        refusal = self._intake.take(topic, payload, content_type, self._clock.now_ns())
        self._totals.telemetry = self._intake.taken
        self._totals.refused = self._intake.refused
        self._totals.last_refusal = self._intake.last_refusal
        self._totals.drones = len(self._trajectories.names)
        if refusal is not None:
            self._office.send(refusal)

    def _keep_ledger(self, report: SectorReport, sent: Sequence[pb.Sent]) -> None:
        """Put what is true on the truth topic, unless the scene keeps it back."""
        if not self._scene.mqtt.truth:
            return
        sector, prefix = report.sector, self._scene.mqtt.prefix
        entry = ledger(
            report.sensor,
            sector.scan,
            sector.index,
            looks=report.looks,
            plots=report.plots,
            drones=self._trajectories.names,
            sent=sent,
        )
        self._office.send(
            Message(
                topic=f"{prefix}/truth",
                payload=entry,
                content_type=f"{PROTOBUF}; messageType=plotfeed.v1.Ledger",
                due_utc_ns=sector.end_ns,
                properties=attributes(
                    f"{prefix}/{report.sensor}",
                    "truth",
                    f"{sector.scan}-{sector.index}",
                    sector.end_ns,
                    sensor=report.sensor,
                    scan=sector.scan,
                    sector=sector.index,
                ),
            )
        )

    async def _work(self, duration_s: float | None) -> None:
        """Do everything on the agenda, each thing at its time."""
        end_ns = None if duration_s is None else self._start_ns + round(duration_s * NS)
        self._totals.drones = len(self._trajectories.names)
        for desk in self._desks:
            desk.open(self._start_ns)
        if self._cooperative is not None:
            self._cooperative.open(self._start_ns)
        drain_ns = self._start_ns
        while (due_ns := self._agenda.next_due_ns()) is not None:
            if end_ns is not None and due_ns > end_ns:
                await self._clock.sleep_until(end_ns)
                return
            await self._clock.sleep_until(due_ns)
            for action in self._agenda.due_by(self._clock.now_ns()):
                action()
            if isinstance(self._clock, InstantClock) and due_ns >= drain_ns:
                await self._drain()
                drain_ns = due_ns + DRAIN_EVERY_NS

    async def _farewell(self) -> None:
        """Mark every sensor offline and let the sockets empty."""
        for desk in self._desks:
            desk.close()
        await self._drain()

    async def _drain(self) -> None:
        for outbox in (self._office, *(desk.outbox for desk in self._desks)):
            await outbox.drain(FAREWELL_S)


async def _first_of(work: Coroutine[None, None, None], stop: asyncio.Event | None) -> None:
    """Wait for the end of the work, or end it when asked to stop."""
    working = asyncio.create_task(work, name="work")
    stopping = asyncio.create_task((stop or asyncio.Event()).wait(), name="stop")
    try:
        await asyncio.wait({working, stopping}, return_when=asyncio.FIRST_COMPLETED)
        if working.done():
            working.result()
    finally:
        for task in (working, stopping):
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

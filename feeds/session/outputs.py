"""Which brokers and connections a session has, and what is sent over which of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from plotfeed.feeds.engine.sensor_description import status_message
from plotfeed.feeds.formats.sapient import announcer_of
from plotfeed.feeds.link.counters import SapientCounters, SessionCounters
from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import KeptUp, Transport
from plotfeed.feeds.scene.claim_keys import COOPERATIVE
from plotfeed.feeds.scene.report_formats import LoadedOnUse
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.part import PartHold
from plotfeed.feeds.timing.clock import Clock, Schedule
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto import plotfeed_pb2 as pb

if TYPE_CHECKING:
    from plotfeed.feeds.formats.sapient.sapient_announcer import SapientAnnouncer
    from plotfeed.feeds.transport.http import HttpTransport
    from plotfeed.feeds.transport.listening import RemoteIdTransport, WebSocketTransport
    from plotfeed.feeds.transport.tak import TakTransport
    from plotfeed.feeds.transport.udp import UdpTransport

    TrackTransport = TakTransport | HttpTransport | WebSocketTransport | RemoteIdTransport
    from plotfeed.feeds.transport.mqtt.client import LastWills, MqttTransport
    from plotfeed.feeds.transport.mqtt.connection import OnMessage
    from plotfeed.feeds.transport.sapient import SapientIntake, SapientNews, SapientTcpTransport

SESSION = "session"  # Whose will is that of the session itself; no sensor has that name

# What carries tracks to servers, maps and who asks, by the scene's names for it.
TRACK_TRANSPORTS: LoadedOnUse[Callable[..., TrackTransport]] = LoadedOnUse(
    {
        "tak": "plotfeed.feeds.transport.tak:TakTransport",
        "http": "plotfeed.feeds.transport.http:HttpTransport",
        "websocket": "plotfeed.feeds.transport.listening:WebSocketTransport",
        "remote_id_service": "plotfeed.feeds.transport.listening:RemoteIdTransport",
    }
)


class Outputs:
    """A link to each broker for all that a session sends, last wills beside it, and UDP sockets."""

    def __init__(
        self,
        scene: Scene,
        addresses: Sequence[BrokerAddress],
        *,
        clock: Clock,
        schedule: Schedule,
        totals: SessionCounters,
        before_link: Sequence[Callable[[Message], object]],
        after_link: Sequence[Callable[[Message, int], object]],
        hold: PartHold,
        topics: Sequence[str],
        on_message: OnMessage,
        will: Message,
    ) -> None:
        """What comes on `topics`, or for a node of SAPIENT, is told by `on_message`.

        `will` is what a broker is to say should the session die.
        """
        self.udp: list[UdpTransport] = []
        if to := scene.outgoing.udp:
            from plotfeed.feeds.transport.udp import UdpTransport

            self.udp = [UdpTransport(udp, f"udp[{i}]") for i, udp in enumerate(to)]
        self._of_tracks: list[TrackTransport] = []
        for kind in TRACK_TRANSPORTS:
            asks_when = (clock.now_ns,) if kind == "remote_id_service" else ()
            for i, keys in enumerate(getattr(scene.outgoing, kind)):
                self._of_tracks.append(TRACK_TRANSPORTS[kind](keys, *asks_when, f"{kind}[{i}]"))
        # All that have to be kept up, the links to brokers first, then those that others share.
        self.connected: list[KeptUp] = []
        self.brokers: list[MqttTransport] = []  # The links that a broker may hold up
        self._sapient: list[Transport] = []
        self._middleware: tuple[SapientIntake, SapientNews] | None = None
        self._on_message = on_message
        self._scene, self._clock, self.schedule, self.totals = scene, clock, schedule, totals
        self._before_link, self._after_link = before_link, after_link
        self._of_sensor: dict[str, Outbox] = {}
        self._announcers: list[SapientAnnouncer] = []
        self._wills: dict[str, Message] = {}  # By whose they are, first that of the session
        self._last_wills: list[LastWills] = []
        self._hold = hold
        # By the identity of what they guard: what one transport takes leaves in one write.
        self._held: dict[int, Transport] = {}
        for address in addresses:
            link = hold.link(
                address,
                topics,
                on_message,
                on_connect=self._announce_again,
                queue=scene.mqtt.queue,
                on_echo=None if address.ends_with_us else totals.echoed,
            )
            self.brokers.append(link)
        self.connected.extend(self.brokers)
        for link in self.brokers:
            if not link.address.ends_with_us:
                self._wills[SESSION] = will
                from plotfeed.feeds.transport.mqtt.client import LastWills

                is_back, stem = partial(self._is_back, link), hold.client_id
                wills = LastWills(link, self._wills, is_back, stem=stem, prompt=SESSION)
                self._last_wills.append(wills)
                self.connected.append(wills)
        self.connected.extend(self._of_tracks)
        # The session's own.
        self.of_session = Outbox(
            clock, [self._guarded(link) for link in self.brokers], after_link=self._after_link
        )

    def _guarded(self, transport: Transport) -> Transport:
        """What takes nothing while another process may have the part that is run."""
        return self._held.setdefault(id(transport), self._hold.guarded(transport))

    def of_sensor(
        self, sensor: Sensor, status: pb.SensorStatus, start_ns: int
    ) -> tuple[Outbox, SapientAnnouncer | None]:
        """A sensor goes over the session's links; that it is offline is a last will of its own.

        With whoever announces it on them, if it reports in a format that wants that.
        Raises `PlotfeedError`.
        """
        announcer = announcer_of(self._scene, sensor)
        if any(not link.address.ends_with_us for link in self.brokers):
            status.state = pb.SensorStatus.OFFLINE
            self._wills[sensor.id] = status_message(self._scene.mqtt.prefix, status, start_ns)
        transports: list[Transport] = [*self.brokers]
        node: SapientCounters | None = None
        if announcer is not None:
            self._announcers.append(announcer)
            node = SapientCounters(self.totals)
            if (middleware := self._scene.outgoing.middleware) is not None:
                of_its_own = self._to_middleware(middleware, sensor, announcer, node)
                transports.append(of_its_own)
                self._sapient.append(of_its_own)
                self.connected.append(of_its_own)
        outbox = self._of_sensor[sensor.id] = self._outbox(sensor.id, transports)
        outbox.counters.sapient = node
        return outbox, announcer

    def _to_middleware(
        self, middleware: str, sensor: Sensor, announcer: SapientAnnouncer, node: SapientCounters
    ) -> SapientTcpTransport:
        """A sensor's own connection; all of them share a limit of what is heard, and who tells."""
        from plotfeed.feeds.transport.sapient import (  # needs an extra
            SapientIntake,
            SapientNews,
            SapientTcpTransport,
        )

        settings = self._scene.sapient
        if self._middleware is None:
            limits = settings.max_messages_per_s, settings.max_octets_per_s
            self._middleware = SapientIntake(*limits), SapientNews()
        intake, news = self._middleware
        return SapientTcpTransport(
            sensor.id,
            middleware,
            settings,
            announcer,
            clock=self._clock,
            intake=intake,
            news=news,
            counters=node,
            on_task=partial(self._on_message, announcer.inbox),
        )

    def of_cooperative_drones(self) -> Outbox | None:
        """Drones that report themselves go over the session's own connections; None without any."""
        if self._scene.cooperative is None:
            return None
        return self._outbox(COOPERATIVE, self.brokers)

    async def drain(self, timeout_s: float) -> None:
        """Wait until the sockets have taken everything, or the time is up."""
        transports = [*self.brokers, *self._sapient, *self.udp, *self._of_tracks]
        await asyncio.gather(*(transport.drain(timeout_s) for transport in transports))

    def forget_wills(self) -> None:
        """All that there is to say at the end is said: no broker shall say that all have died."""
        for wills in self._last_wills:
            wills.forget()

    def give_up(self) -> None:
        """Settle what brokers have not taken by now, which the session's end leaves undelivered."""
        for link in self.brokers:
            link.give_up()

    def _outbox(self, name: str, transports: Sequence[Transport]) -> Outbox:
        return Outbox(
            self._clock,
            [
                self._guarded(each)
                for each in (
                    *transports,
                    *(each for each in (*self.udp, *self._of_tracks) if each.settings.takes(name)),
                )
            ],
            schedule=self.schedule,
            totals=self.totals,
            before_link=self._before_link,
            after_link=self._after_link,
        )

    def _announce_again(self, link: MqttTransport) -> None:
        """Tell on a new connection what a broker that was started anew does not know any more.

        The first connection is told anyway.
        """
        if link.connections <= 1:
            return
        now_ns = self._clock.now_ns()
        anew = [message for each in self._announcers for message in each.opening(now_ns)]
        said_anew = {message.topic for message in anew}
        for outbox in (self.of_session, *self._of_sensor.values()):
            for topic, message in outbox.retained.items():
                if topic not in said_anew:
                    link.publish([message.again(outbox, 1)])
        for message in anew:
            link.publish([message.again(self.of_session, 1)])

    def _is_back(self, link: MqttTransport, whose: str) -> None:
        """Say again how a sensor, or the session, is: the broker has published its last will."""
        outbox = self.of_session if whose == SESSION else self._of_sensor[whose]
        topic = self._wills[whose].topic
        if topic in outbox.retained:
            link.publish([outbox.retained[topic].again(outbox, 1)])

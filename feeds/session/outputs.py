"""Which brokers and connections a session has, and what is sent over which of them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.formats import Announcer, announcer_of
from plotfeed.feeds.link.counters import SapientCounters
from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import KeptUp, Outgoing, Transport
from plotfeed.feeds.scene.claim_keys import COOPERATIVE
from plotfeed.feeds.scene.loaded_on_use import LoadedOnUse
from plotfeed.feeds.scene.output_keys import USUAL_PORT, TrackDestination, WaysOut
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import SessionContext, cares
from plotfeed.feeds.session.sensor_description import status_of
from plotfeed.feeds.session.sensor_task import status_message
from plotfeed.feeds.transport.mqtt.address import VERSIONS, BrokerAccess, BrokerAddress
from plotfeed.proto import plotfeed_pb2 as pb

if TYPE_CHECKING:
    from plotfeed.feeds.session.session_part import HeldTransport, PartHold
    from plotfeed.feeds.transport.http import HttpTransport
    from plotfeed.feeds.transport.remote_id_service import RemoteIdTransport
    from plotfeed.feeds.transport.tak import TakTransport
    from plotfeed.feeds.transport.udp import UdpTransport
    from plotfeed.feeds.transport.websocket_server import WebSocketTransport

    TrackTransport = TakTransport | HttpTransport | WebSocketTransport | RemoteIdTransport
    from plotfeed.feeds.transport.mqtt.client import MqttTransport
    from plotfeed.feeds.transport.mqtt.connection import OnMessage
    from plotfeed.feeds.transport.mqtt.last_wills import LastWills
    from plotfeed.feeds.transport.sapient import SapientIntake, SapientNews, SapientTcpTransport

NO_BROKER = "none"
SESSION = "session"
"""Whose will is that of the session itself; no sensor has that name."""
LINGER_S = 0.3
"""The embedded broker stays on for so long, to pass on the last messages."""


Brokers = tuple[list[BrokerAddress], dict[str, str]]
"""Where to publish, and what to call it."""


@contextlib.asynccontextmanager
async def brokers_of(scene: Scene, broker: str | None) -> AsyncIterator[Brokers]:
    """The brokers to publish to, and what to call them; the embedded one lives meanwhile."""
    to = scene.outgoing
    url = broker or to.broker
    if url == NO_BROKER:
        yield [], {}
        return
    if url is not None:
        address = broker_address(scene, url)
        yield [address], {"MQTT": str(address)}
        return
    from plotfeed.feeds.transport.embedded_broker import EmbeddedBroker

    embedded = await EmbeddedBroker.start(
        to.port or USUAL_PORT, to.embedded, may_be_others=to.port is None
    )
    keeping_up = asyncio.create_task(embedded.keep_up(), name="embedded broker")
    try:
        from plotfeed.feeds.transport.local_hosts import LOOPBACK

        mqtt3 = BrokerAddress(LOOPBACK, embedded.ports.mqtt3, (4,), ends_with_us=True)
        mqtt5 = BrokerAddress(LOOPBACK, embedded.ports.mqtt5, (5,), ends_with_us=True)
        yield [mqtt5, mqtt3], embedded.ports.urls()
        await asyncio.sleep(LINGER_S)
    finally:
        keeping_up.cancel()
        embedded.stop()


def broker_address(scene: Scene, url: str) -> BrokerAddress:
    """A broker of the user's own, with the keys to it that the scene names."""
    to = scene.outgoing
    access = BrokerAccess(
        ca_file=to.ca_file, certificate_file=to.certificate_file, key_file=to.key_file
    ).with_credentials(to.credentials_file)
    versions = VERSIONS[scene.mqtt.version]
    return BrokerAddress.parse(url, versions=versions, access=access, waits=to.waits)


# What carries tracks to servers, maps and who asks, by the scene's names for it.
TRACK_TRANSPORTS: LoadedOnUse[Callable[..., TrackTransport]] = LoadedOnUse(
    {
        "tak": "plotfeed.feeds.transport.tak:TakTransport",
        "http": "plotfeed.feeds.transport.http:HttpTransport",
        "websocket": "plotfeed.feeds.transport.websocket_server:WebSocketTransport",
        "remote_id_service": "plotfeed.feeds.transport.remote_id_service:RemoteIdTransport",
    }
)


def of_tracks(
    to: WaysOut, now_utc_ns: Callable[[], int]
) -> list[tuple[TrackDestination, TrackTransport]]:
    """What carries tracks to servers, maps and who asks, with its keys; raises `PlotfeedError`."""
    asks_when = {"remote_id_service": (now_utc_ns,)}
    return [
        (keys, carrier(keys, *asks_when.get(kind, ()), f"{kind}[{i}]"))
        for kind in TRACK_TRANSPORTS
        for i, keys in enumerate(getattr(to, kind))
        for carrier in (TRACK_TRANSPORTS[kind],)
    ]


class Outputs:
    """A link to each broker for all that a session sends, last wills beside it, and UDP sockets."""

    def __init__(
        self,
        context: SessionContext,
        addresses: Sequence[BrokerAddress],
        hold: PartHold | None = None,
    ) -> None:
        observers = context.observers
        self.udp: list[UdpTransport] = []
        if to := context.scene.outgoing.udp:
            from plotfeed.feeds.transport.udp import UdpTransport

            self.udp = [UdpTransport(udp, f"udp[{i}]") for i, udp in enumerate(to)]
        self._of_tracks = of_tracks(context.scene.outgoing, context.clock.now_ns)
        self.connected: list[KeptUp] = []
        """All that have to be kept up, the links to brokers first, then those that others share."""
        self.brokers: list[MqttTransport] = []
        """The links that a broker may hold up."""
        self._sapient: list[Transport] = []
        self._middleware: tuple[SapientIntake, SapientNews] | None = None
        self._on_message: OnMessage | None = None
        """Told of what comes in, over whatever connection."""
        self._addresses = addresses
        self._context = context
        self._scene, self._clock = context.scene, context.clock
        self._before_link = [o.before_link for o in observers if cares(o, "before_link")]
        self._after_link = [o.after_link for o in observers if cares(o, "after_link")]
        self._of_session: Outbox
        """There is one as soon as it is asked for."""
        self._of_sensor: dict[str, Outbox] = {}
        self._announcers: list[Announcer] = []
        self._wills: dict[str, Message] = {}
        """By whose they are, first that of the session."""
        self._last_wills: list[LastWills] = []
        self._hold = hold
        self._held: dict[int, HeldTransport] = {}
        """By the identity of what they guard: what one transport takes leaves in one write."""

    def of_session(self, topics: Sequence[str], on_message: OnMessage, will: Message) -> Outbox:
        """The session's own: it receives what comes on those topics. Asked for before any other.

        `will` is what a broker is to say should the session die.
        """
        self._on_message = on_message
        self.brokers = [self._link(to, topics, on_message) for to in self._addresses]
        self.connected.extend(self.brokers)
        for link in self.brokers:
            if not link.address.ends_with_us:
                self._wills[SESSION] = will
                stem = None if self._hold is None else self._hold.client_id
                is_back = partial(self._is_back, link)
                from plotfeed.feeds.transport.mqtt.last_wills import LastWills

                wills = LastWills(link, self._wills, is_back, stem=stem, prompt=SESSION)
                self._last_wills.append(wills)
                self.connected.append(wills)
        self.connected.extend(transport for _, transport in self._of_tracks)
        self._of_session = Outbox(
            self._clock, [self._guarded(link) for link in self.brokers], after_link=self._after_link
        )
        return self._of_session

    def _link(
        self, to: BrokerAddress, topics: Sequence[str], on_message: OnMessage
    ) -> MqttTransport:
        how: dict[str, Any] = {
            "on_connect": self._announce_again,
            "queue": self._scene.mqtt.queue,
            "on_echo": None if to.ends_with_us else self._context.totals.echoed,
        }
        if self._hold is not None:
            self._hold.listen(topics, on_message)
            from plotfeed.feeds.session.session_part import PartLink

            return PartLink(to, self._hold, **how)
        from plotfeed.feeds.transport.mqtt.client import MqttTransport

        return MqttTransport(
            to, "plotfeed-session", subscribe=list(topics), on_message=on_message, **how
        )

    def _guarded(self, transport: Transport) -> Transport:
        """What takes nothing while another process may have the part that is run."""
        if self._hold is None:
            return transport
        from plotfeed.feeds.session.session_part import HeldTransport

        return self._held.setdefault(id(transport), HeldTransport(transport, self._hold))

    def of_sensor(self, sensor: Sensor, start_ns: int) -> tuple[Outbox, Announcer | None]:
        """A sensor goes over the session's links; that it is offline is a last will of its own.

        With whoever announces it on them, if it reports in a format that wants that.
        Raises `PlotfeedError`.
        """
        announcer = announcer_of(self._scene, sensor)
        if any(not link.address.ends_with_us for link in self.brokers):
            offline = status_of(self._context.describer.description(sensor))
            offline.state = pb.SensorStatus.OFFLINE
            self._wills[sensor.id] = status_message(self._scene.mqtt.prefix, offline, start_ns)
        transports: list[Transport] = [*self.brokers]
        middleware = self._scene.outgoing.middleware
        node: SapientCounters | None = None
        if announcer is not None:
            self._announcers.append(announcer)
            node = SapientCounters(self._context.totals)
        if announcer is not None and node is not None and middleware is not None:
            of_its_own = self._to_middleware(middleware, sensor, announcer, node)
            transports.append(of_its_own)
            self._sapient.append(of_its_own)
            self.connected.append(of_its_own)
        outbox = self._of_sensor[sensor.id] = self._outbox(sensor.id, transports)
        outbox.counters.sapient = node
        return outbox, announcer

    def _to_middleware(
        self, middleware: str, sensor: Sensor, announcer: Announcer, node: SapientCounters
    ) -> SapientTcpTransport:
        """A sensor's own connection; all of them share a limit of what is heard, and who tells."""
        from plotfeed.feeds.transport.sapient import SapientTcpTransport  # needs an extra

        settings = self._scene.sapient.model_copy(update={"middleware": middleware})
        if self._middleware is None:
            limits = settings.max_messages_per_s, settings.max_octets_per_s
            from plotfeed.feeds.transport.sapient import SapientIntake, SapientNews

            self._middleware = SapientIntake(*limits), SapientNews()
        intake, news = self._middleware
        return SapientTcpTransport(
            sensor.id,
            settings,
            announcer,
            clock=self._clock,
            intake=intake,
            news=news,
            counters=node,
            on_task=self._on_message and partial(self._on_message, announcer.inbox),
        )

    def of_cooperative_drones(self) -> Outbox | None:
        """Drones that report themselves go over the session's own connections; None without any."""
        if self._scene.cooperative is None:
            return None
        return self._outbox(COOPERATIVE, self.brokers)

    async def drain(self, timeout_s: float) -> None:
        """Wait until the sockets have taken everything, or the time is up."""
        of_tracks = [transport for _, transport in self._of_tracks]
        transports = [*self.brokers, *self._sapient, *self.udp, *of_tracks]
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
                    *(udp for udp in self.udp if udp.settings.takes(name)),
                    *(transport for keys, transport in self._of_tracks if keys.takes(name)),
                )
            ],
            schedule=self._context.schedule,
            totals=self._context.totals,
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
        for outbox in (self._of_session, *self._of_sensor.values()):
            for topic, message in outbox.retained.items():
                if topic not in said_anew:
                    link.publish([Outgoing(message, client=outbox, transports=1)])
        for message in anew:
            link.publish([Outgoing(message, client=self._of_session, transports=1)])

    def _is_back(self, link: MqttTransport, whose: str) -> None:
        """Say again how a sensor, or the session, is: the broker has published its last will."""
        outbox = self._of_session if whose == SESSION else self._of_sensor[whose]
        topic = self._wills[whose].topic
        if topic in outbox.retained:
            link.publish([Outgoing(outbox.retained[topic], client=outbox, transports=1)])

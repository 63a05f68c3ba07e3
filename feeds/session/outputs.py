"""Which connections a session has, and what is sent over which of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from plotfeed.feeds.delivery.delivery import ConnectedTransport, Delivery, Transport
from plotfeed.feeds.delivery.outbox import Outbox
from plotfeed.feeds.formats import Announcer, announcer_of, in_time
from plotfeed.feeds.impairment.link import Impairment
from plotfeed.feeds.scene.drones import COOPERATIVE
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.context import SessionContext
from plotfeed.feeds.session.observer import cares
from plotfeed.feeds.session.status import status_message
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttLink
from plotfeed.feeds.transport.mqtt.connection import OnMessage
from plotfeed.feeds.transport.udp import UdpLink
from plotfeed.proto import plotfeed_pb2 as pb


class Outputs:
    """A client for each sensor and broker, one for the session itself, and the UDP sockets."""

    def __init__(self, context: SessionContext, addresses: Sequence[BrokerAddress]) -> None:
        scene, observers = context.scene, context.observers
        self.udp = [UdpLink(to, f"udp[{i}]") for i, to in enumerate(scene.udp)]
        self.links: list[ConnectedTransport] = []
        """All that have to be kept up, the session's own first."""
        self._session_links: list[MqttLink] = []
        self._scene = scene
        self._addresses = addresses
        self._context = context
        self._clock = context.clock
        self._before_link = [o.before_link for o in observers if cares(o, "before_link")]
        self._after_link = [o.after_link for o in observers if cares(o, "after_link")]

    @property
    def brokers(self) -> list[MqttLink]:
        """The connections among them that a broker may hold up."""
        return [link for link in self.links if isinstance(link, MqttLink)]

    def of_session(self, topics: Sequence[str], on_message: OnMessage) -> Outbox:
        """The session's own: it receives what comes on those topics. Asked for before any other."""
        self._session_links = [
            MqttLink(
                address,
                "plotfeed-session",
                subscribe=list(topics),
                on_message=on_message,
                queue=self._scene.mqtt.queue,
            )
            for address in self._addresses
        ]
        self.links.extend(self._session_links)
        return Outbox(self._clock, self._session_links, after_link=self._after_link)

    def of_sensor(self, sensor: Sensor, start_ns: int) -> tuple[Outbox, Announcer | None]:
        """A sensor is a client of its own, whose last will is that it is offline.

        With whoever announces it on its connections, if it reports in a format that wants that.
        Raises `PlotfeedError`.
        """
        scene = self._scene
        announcer = announcer_of(scene, sensor)
        offline = pb.SensorStatus(sensor=sensor.id, state=pb.SensorStatus.OFFLINE)
        will = status_message(scene.mqtt.prefix, offline, start_ns)
        links: list[ConnectedTransport] = [
            MqttLink(
                address,
                f"plotfeed-{sensor.id}",
                will=will,
                on_connect=None if announcer is None else partial(self._announce_again, announcer),
                queue=scene.mqtt.queue,
            )
            for address in self._addresses
        ]
        if announcer is not None and scene.sapient.middleware is not None:
            from plotfeed.feeds.transport.sapient_tcp import SapientTcpLink  # needs an extra

            links.append(
                SapientTcpLink(scene.sapient.middleware, sensor.id, announcer, self._clock)
            )
        self.links.extend(links)
        return self._outbox(sensor.id, links, sensor.link), announcer

    def of_cooperative_drones(self, link: LinkSettings | None) -> Outbox:
        """Drones that report themselves go over the session's own connections."""
        return self._outbox(COOPERATIVE, self._session_links, link)

    def _outbox(self, name: str, links: Sequence[Transport], link: LinkSettings | None) -> Outbox:
        udp_links = [udp for udp in self.udp if udp.settings.takes(name)]
        return Outbox(
            self._clock,
            [*links, *udp_links],
            schedule=self._context.schedule,
            totals=self._context.totals,
            before_link=self._before_link,
            after_link=self._after_link,
            in_time=in_time(self._scene),
            link=link,
            impair=partial(_impairment, self._scene.scene.seed, name),
        )

    def _announce_again(self, announcer: Announcer, link: MqttLink) -> None:
        """A new connection is told who the sensor is; the first one is told anyway."""
        if link.connections > 1:
            for message in announcer.opening(self._clock.now_ns()):
                link.publish(Delivery(message, self._clock, 1))


def _impairment(seed: int, name: str, link: LinkSettings) -> Impairment:
    return Impairment(link, seed, name)

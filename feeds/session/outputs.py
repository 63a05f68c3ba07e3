"""Which brokers and connections a session has, and what is sent over which of them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from plotfeed.feeds.delivery.delivery import ConnectedTransport, Delivery, Transport
from plotfeed.feeds.delivery.outbox import Outbox
from plotfeed.feeds.formats import Announcer, announcer_of, in_time
from plotfeed.feeds.impairment.link import Impairment
from plotfeed.feeds.scene.drones import COOPERATIVE
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import SessionContext, cares
from plotfeed.feeds.session.sensor_task import status_message
from plotfeed.feeds.transport.embedded_broker import LOOPBACK, EmbeddedBroker
from plotfeed.feeds.transport.mqtt.address import VERSIONS, BrokerAccess, BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.connection import OnMessage
from plotfeed.feeds.transport.udp import UdpTransport
from plotfeed.proto import plotfeed_pb2 as pb

NO_BROKER = "none"
LINGER_S = 0.3
"""The embedded broker stays on for so long, to pass on the last messages."""


Brokers = tuple[list[BrokerAddress], dict[str, str]]
"""Where to publish, and what to call it."""


@contextlib.asynccontextmanager
async def brokers_of(scene: Scene, broker: str | None) -> AsyncIterator[Brokers]:
    """The brokers to publish to, and what to call them; the embedded one lives meanwhile."""
    url = broker or scene.mqtt.broker
    if url == NO_BROKER:
        yield [], {}
        return
    if url is not None:
        address = broker_address(scene, url)
        yield [address], {"MQTT": str(address)}
        return
    embedded = await EmbeddedBroker.start(scene.mqtt.port)
    try:
        mqtt3 = BrokerAddress(LOOPBACK, embedded.ports.mqtt3, (4,))
        mqtt5 = BrokerAddress(LOOPBACK, embedded.ports.mqtt5, (5,))
        yield [mqtt5, mqtt3], embedded.ports.urls()
        await asyncio.sleep(LINGER_S)
    finally:
        embedded.stop()


def broker_address(scene: Scene, url: str) -> BrokerAddress:
    """A broker of the user's own, with the keys to it that the scene names."""
    mqtt, folder = scene.mqtt, scene.folder

    def beside_scene(name: str | None) -> Path | None:
        return None if name is None else folder / name

    access = BrokerAccess(
        ca_file=beside_scene(mqtt.ca_file),
        certificate_file=beside_scene(mqtt.client_certificate_file),
        key_file=beside_scene(mqtt.client_key_file),
    ).with_credentials(beside_scene(mqtt.credentials_file))
    return BrokerAddress.parse(url, versions=VERSIONS[mqtt.version], access=access)


class Outputs:
    """A client for each sensor and broker, one for the session itself, and the UDP sockets."""

    def __init__(self, context: SessionContext, addresses: Sequence[BrokerAddress]) -> None:
        observers = context.observers
        self.udp = [UdpTransport(to, f"udp[{i}]") for i, to in enumerate(context.scene.udp)]
        self.connected: list[ConnectedTransport] = []
        """All that have to be kept up, the session's own first."""
        self._of_session: list[MqttTransport] = []
        self._addresses = addresses
        self._context = context
        self._scene, self._clock = context.scene, context.clock
        self._before_link = [o.before_link for o in observers if cares(o, "before_link")]
        self._after_link = [o.after_link for o in observers if cares(o, "after_link")]

    @property
    def brokers(self) -> list[MqttTransport]:
        """The connections that a broker may hold up."""
        return [each for each in self.connected if isinstance(each, MqttTransport)]

    def of_session(self, topics: Sequence[str], on_message: OnMessage) -> Outbox:
        """The session's own: it receives what comes on those topics. Asked for before any other."""
        self._of_session = self._mqtt("session", subscribe=list(topics), on_message=on_message)
        self.connected.extend(self._of_session)
        return Outbox(self._clock, self._of_session, after_link=self._after_link)

    def of_sensor(self, sensor: Sensor, start_ns: int) -> tuple[Outbox, Announcer | None]:
        """A sensor is a client of its own, whose last will is that it is offline.

        With whoever announces it on its connections, if it reports in a format that wants that.
        Raises `PlotfeedError`.
        """
        announcer = announcer_of(self._scene, sensor)
        offline = pb.SensorStatus(sensor=sensor.id, state=pb.SensorStatus.OFFLINE)
        transports: list[ConnectedTransport] = [
            *self._mqtt(
                sensor.id,
                will=status_message(self._scene.mqtt.prefix, offline, start_ns),
                on_connect=None if announcer is None else partial(self._announce_again, announcer),
            )
        ]
        middleware = self._scene.sapient.middleware
        if announcer is not None and middleware is not None:
            from plotfeed.feeds.transport.sapient_tcp import SapientTcpTransport  # needs an extra

            transports.append(SapientTcpTransport(middleware, sensor.id, announcer, self._clock))
        self.connected.extend(transports)
        return self._outbox(sensor.id, transports, sensor.link), announcer

    def of_cooperative_drones(self, link: LinkSettings | None) -> Outbox:
        """Drones that report themselves go over the session's own connections."""
        return self._outbox(COOPERATIVE, self._of_session, link)

    def _mqtt(self, name: str, **more: Any) -> list[MqttTransport]:
        queue = self._scene.mqtt.queue
        return [
            MqttTransport(to, f"plotfeed-{name}", queue=queue, **more) for to in self._addresses
        ]

    def _outbox(
        self, name: str, transports: Sequence[Transport], link: LinkSettings | None
    ) -> Outbox:
        return Outbox(
            self._clock,
            [*transports, *(udp for udp in self.udp if udp.settings.takes(name))],
            schedule=self._context.schedule,
            totals=self._context.totals,
            before_link=self._before_link,
            after_link=self._after_link,
            in_time=in_time(self._scene),
            link=link,
            impair=partial(Impairment, seed=self._scene.scene.seed, name=name),
        )

    def _announce_again(self, announcer: Announcer, transport: MqttTransport) -> None:
        """A new connection is told who the sensor is; the first one is told anyway."""
        if transport.connections > 1:
            for message in announcer.opening(self._clock.now_ns()):
                transport.publish(Delivery(message, self._clock, 1))

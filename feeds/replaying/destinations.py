"""Destinations of a replay: brokers, UDP addresses, and where each datagram once went."""

from __future__ import annotations

import contextlib
import logging
import select
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from ipaddress import ip_address

from plotfeed.feeds.console.printed import bracketed
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import ImmediateTransport, Transport
from plotfeed.feeds.scene.output_keys import MqttQueueKeys, UdpDestination
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.udp import UdpTransport
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto.content_types import ASTERIX
from plotfeed.proto.message_kinds import kind_of
from plotfeed.replay.recorded import UDP_TOPIC

log = logging.getLogger(__name__)

MAX_DESTINATIONS = 256
FULL_S = 1.0  # So long a socket that is full is waited for, where nothing else waits for its time
WAITING = 4096  # Messages that may wait for a broker while whoever has no deadlines waits for room
CONNECT_S = 5.0


def is_datagram(message: Message) -> bool:
    """Whether it is ASTERIX, or was a datagram when it was recorded."""
    if message.topic.startswith(UDP_TOPIC):
        return True
    return kind_of(message.topic, message.content_type, message.payload) == ASTERIX


class ReplayUdp(UdpTransport):
    """One UDP destination, for every datagram of a recording."""

    def __init__(
        self, settings: UdpDestination, key: str = "--udp", *, waits: bool = False
    ) -> None:
        """`waits` says that a full socket is waited for, rather than that a datagram is lost."""
        super().__init__(settings, key)
        self.refused = 0  # How often the system said that nobody listens
        self._waits = waits

    def open(self) -> None:
        """Make the socket; raises `TransportError`."""
        super().open()
        assert self._socket is not None  # noqa: S101 - else it has raised  # nosec B101
        try:
            self._socket.connect(self._target)
        except OSError as error:
            self.close()
            raise TransportError(
                f"{self.settings.destination}: {error.strerror or error}"
            ) from None

    def carries(self, message: Message) -> bool:
        """Whether it is a datagram."""
        return is_datagram(message)

    def send(self, datagram: bytes) -> bool:
        """Send a datagram, again if an earlier one was refused; False if the system will not."""
        opened = self._socket
        if opened is None:
            return False
        for _ in range(3):
            try:
                opened.send(datagram)
            except ConnectionRefusedError:  # of an earlier one; this one has not been sent
                self.refused += 1
            except BlockingIOError:
                if not self._waits or not select.select([], [opened], [], FULL_S)[1]:
                    return False
            except OSError:
                return False
            else:
                return True
        return False


class RecordedUdp(ImmediateTransport):
    """The destinations that datagrams once had, by their topics udp/ADDRESS/PORT."""

    def __init__(self, keys: UdpDestination, *, waits: bool = False) -> None:
        """`keys` are those of all destinations, but for the address; `interface` is of groups."""
        self._keys, self._waits = keys, waits
        self._links: dict[str, ReplayUdp | None] = {}

    @property
    def refused(self) -> int:
        """How often the system said that nobody listens."""
        return sum(link.refused for link in self._links.values() if link is not None)

    def carries(self, message: Message) -> bool:
        """Whether its topic is a destination that can be sent to."""
        topic = message.topic
        if not topic.startswith(UDP_TOPIC):
            return False
        if topic not in self._links and len(self._links) < MAX_DESTINATIONS:
            self._links[topic] = self._opened(topic)
        return self._links.get(topic) is not None

    def publish(self, messages: Sequence[Message]) -> bool:
        """Send each to where its topic says."""
        for one in messages:
            link = self._links.get(one.topic)
            if link is None:
                one.settle(delivered=None)
            else:
                link.publish([one])
        return False

    def close(self) -> None:
        """Close all sockets."""
        for link in self._links.values():
            if link is not None:
                link.close()

    def _opened(self, topic: str) -> ReplayUdp | None:
        _, _, place = topic.partition("/")
        host, _, port = place.rpartition("/")
        try:
            address = ip_address(host)
            text = f"{bracketed(str(address))}:{port}"
            own: dict[str, str | None] = {"destination": text}
            if not address.is_multicast:
                own["interface"] = None
            settings = UdpDestination(**{**dict(self._keys), **own})
            link = ReplayUdp(settings, topic, waits=self._waits)
            link.open()
        except (ValueError, TransportError) as error:  # pydantic's errors are ValueErrors
            log.warning("%s: %s", topic, str(error).splitlines()[0])
            return None
        return link


class ReplayMqtt(MqttTransport):
    """A broker, which is given everything."""

    def __init__(self, address: BrokerAddress, *, waits: bool = False) -> None:
        """`waits` says that nothing is dropped as long as the broker is away or slow."""
        queue = MqttQueueKeys(policy="wait", messages=WAITING) if waits else None
        super().__init__(address, "plotfeed-replay", queue=queue)

    def carries(self, message: Message) -> bool:
        """Whether it has a topic: any message goes there."""
        return bool(message.topic)


@dataclass(frozen=True, slots=True, kw_only=True)
class Destinations:
    """The places that a replay goes to."""

    brokers: tuple[BrokerAddress, ...] = ()
    udp: tuple[UdpDestination, ...] = ()
    # If datagrams go where they once went, the keys of all those destinations but the address.
    recorded: UdpDestination | None = None


@contextlib.asynccontextmanager
async def open_transports(to: Destinations, *, waits: bool) -> AsyncIterator[list[Transport]]:
    """Sockets that are open and brokers that are there; raises `PlotfeedError`."""
    transports: list[Transport] = []
    async with contextlib.AsyncExitStack() as stack:
        for settings in to.udp:
            link = ReplayUdp(settings, waits=waits)
            stack.callback(link.close)
            link.open()
            transports.append(link)
        if to.recorded is not None:
            recorded = RecordedUdp(to.recorded, waits=waits)
            stack.callback(recorded.close)
            transports.append(recorded)
        for broker in to.brokers:
            mqtt = ReplayMqtt(broker, waits=waits)
            transports.append(await stack.enter_async_context(mqtt.connected(CONNECT_S)))
        yield transports

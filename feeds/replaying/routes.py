"""Where a replay's messages go: brokers, UDP addresses, and the route of each topic to them."""

from __future__ import annotations

import contextlib
import logging
import re
import select
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import NamedTuple

from plotfeed.feeds.console.printed import bracketed
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.link.uplink import Uplink
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import ImmediateTransport, Transport, publish
from plotfeed.feeds.replaying.replay_settings import ReplayError, ReplaySettings, is_topic
from plotfeed.feeds.scene.output_keys import MqttQueueKeys, UdpDestination
from plotfeed.feeds.timing.clock import Clock, Schedule
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.udp import UdpTransport
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import ASTERIX
from plotfeed.proto.message_kinds import kind_of
from plotfeed.replay.recorded import UDP_TOPIC, Recorded

log = logging.getLogger(__name__)

MAX_DESTINATIONS = 256
FULL_S = 1.0  # So long a socket that is full is waited for, where nothing else waits for its time
WAITING = 4096  # Messages that may wait for a broker while whoever has no deadlines waits for room
CONNECT_S = 5.0


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
        """Whether it is ASTERIX, or was a datagram when it was recorded."""
        if message.topic.startswith(UDP_TOPIC):
            return True
        return kind_of(message.topic, message.content_type, message.payload) == ASTERIX

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


# Messages that leave in one go where there are no deadlines: a system call costs more than one.
TOGETHER = 64
MAX_LINKS = 1000  # Sources with a link of their own
# Last levels of what a session says beside what its sensors report.
NOT_OVER_LINKS = frozenset({"status", "settings", "description", "session", "errors", "truth"})
_FORMAT = re.compile(r"(.+)/(?:asterix/\d{1,3}|plots|sapient)")


@dataclass(slots=True)
class ReplayCounters(SessionCounters):
    """What a replay has done so far."""

    worst_ns: int = 0  # The greatest lateness
    octets: int = 0  # Of payloads that were sent, each copy counted
    laps: int = 0  # Begun
    # Messages that were not sent, by the reason.
    skipped: Counter[str] = field(default_factory=Counter)
    # Times that were left alone although they should have been moved, by what they are in.
    left: Counter[str] = field(default_factory=Counter)

    def settle(self, fate: pb.Fate, copy: int, lateness_ns: int, octets: int) -> None:
        """Count what became of a copy of a message, with so many octets of payload."""
        SessionCounters.settle(self, fate, copy, lateness_ns, octets)
        if fate == pb.SENT:
            self.octets += octets
            self.worst_ns = max(self.worst_ns, lateness_ns)


def source_of(topic: str) -> str:
    """The sensor that a topic is of: what stands before the format, else two levels at most."""
    found = _FORMAT.fullmatch(topic)
    if found is not None:
        return found[1]
    return topic if topic.startswith("udp/") else "/".join(topic.split("/")[:2])


class Route(NamedTuple):
    """What becomes of the messages on a topic."""

    topic: str
    # The link that they go through, and then their way out; None if they go through none.
    over: tuple[Uplink, Outbox] | None
    obstacle: str = ""  # Why they are not sent; empty if they are
    # Sends a payload, where that is all that has to be done.
    datagram: Callable[[bytes], bool] | None = None


class Routes:
    """The routes of all topics, each found once, and what leaves by them."""

    def __init__(
        self,
        transports: Sequence[Transport],
        settings: ReplaySettings,
        *,
        clock: Clock,
        schedule: Schedule,
        totals: ReplayCounters,
    ) -> None:
        # How far the replay's time is ahead of the recorded one, at its beginning.
        self.later_ns = 0
        self._transports = transports
        self._settings = settings
        self._clock = clock
        self._schedule = schedule
        self._totals = totals
        self._together = TOGETHER if settings.fastest else 1
        self._gathered: list[Message] = []
        self._routes: dict[tuple[str, str], Route] = {}
        self._over: dict[str, tuple[Uplink, Outbox]] = {}

    def of(self, recorded: Recorded) -> Route:
        """The route of a recorded message."""
        key = (recorded.topic, recorded.content_type)
        route = self._routes.get(key)
        if route is None:
            route = self._routes[key] = self._found(recorded)
        return route

    def send(self, message: Message, over: tuple[Uplink, Outbox] | None) -> None:
        """Send it now, through its link if it has one."""
        if over is not None:
            self.flush()
            uplink, outbox = over
            outbox.send(uplink.passed([message]))
            return
        self._gathered.append(message)
        if len(self._gathered) >= self._together:
            self.flush()

    def send_datagram(self, send: Callable[[bytes], bool], payload: bytes, due_ns: int) -> None:
        """Send a datagram that is its payload and nothing else."""
        fate = pb.SENT if send(payload) else pb.UNDELIVERED
        self._totals.settle(fate, 0, self._clock.now_ns() - due_ns, len(payload))

    def flush(self) -> None:
        """Send what was gathered to leave together."""
        if self._gathered:
            together, self._gathered = self._gathered, []
            publish(self._transports, together, self)

    def now_ns(self) -> int:
        """The time by which it sends, UTC."""
        return self._clock.now_ns()

    def settled(self, one: Message) -> None:
        """The fate of a message that goes through no link is known."""
        late_ns = 0
        if not self._settings.fastest:  # else there are no deadlines
            late_ns = (one.sent_utc_ns or self._clock.now_ns()) - one.due_utc_ns
        self._totals.settle(one.fate, 0, late_ns, len(one.payload))

    def end(self) -> None:
        """What links still hold does not arrive."""
        for _, outbox in self._over.values():
            outbox.end()

    def _found(self, recorded: Recorded) -> Route:
        found = (rule.apply(recorded.topic) for rule in self._settings.topics)
        topic = next((new for new in found if new is not None), recorded.topic)
        message = Message(
            topic=topic, payload=b"", content_type=recorded.content_type, due_utc_ns=0
        )
        if not is_topic(topic):
            return Route(topic, None, "their topic is none that a broker takes")
        if not any(transport.carries(message) for transport in self._transports):
            return Route(topic, None, "they are no datagrams, or of no destination")
        over, first = self._link_of(recorded.topic), self._transports[0]
        if over is None and len(self._transports) == 1 and isinstance(first, ReplayUdp):
            return Route(topic, None, datagram=first.send)
        return Route(topic, over)

    def _link_of(self, topic: str) -> tuple[Uplink, Outbox] | None:
        rules = (rule for rule in self._settings.links if rule.holds_for(topic))
        rule = next(rules, None)
        if rule is None or topic.rpartition("/")[2] in NOT_OVER_LINKS:
            return None
        source = source_of(topic)
        if source not in self._over:
            if len(self._over) >= MAX_LINKS:
                raise ReplayError(f"more than {MAX_LINKS} sources of messages: give fewer a link")
            # Named as in a session, so that the same seed loses alike.
            name, seed = source.rpartition("/")[2], self._settings.seed
            uplink = Uplink(rule.link, seed, name, later_ns=self.later_ns)
            outbox = Outbox(
                self._clock, self._transports, schedule=self._schedule, totals=self._totals
            )
            self._over[source] = uplink, outbox
        return self._over[source]

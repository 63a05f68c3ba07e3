"""`Message`: what goes out, and what became of it; what came in; filters of topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from plotfeed.proto.content_types import JSON
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc

if TYPE_CHECKING:
    from plotfeed.proto import plotfeed_pb2 as pb

# Numbers of `plotfeed.v1.Fate`: every message needs them, and protobuf takes long to load.
UNSPECIFIED: pb.Fate = 0  # type: ignore[assignment]
SENT: pb.Fate = 1  # type: ignore[assignment]
UNDELIVERED: pb.Fate = 5  # type: ignore[assignment]

USER_PROPERTY = b"\x26"  # What announces one in a packet; MQTT 5.0, section 2.2.2

Pair = tuple[str, str]
Pieces = tuple[int, Sequence[bytes]]  # How many octets there are, and these, in pieces


def dashed(kind: str) -> str:
    """A kind of messages, such as `asterix/048`, as ids begin."""
    return kind.replace("/", "-")


def type_of(kind: str) -> str:
    """A kind of messages as the type of their events."""
    return f"plotfeed.{kind.replace('/', '.')}"


@lru_cache(maxsize=1 << 14)
def packed_pair(name: str, value: str) -> bytes:
    """One user property as packets have it."""
    return USER_PROPERTY + packed_text(name) + packed_text(value)


@lru_cache(maxsize=1 << 14)
def packed_text(text: str) -> bytes:
    """A text as packets have it, behind the number of its octets."""
    return _octets_of(text)


def _octets_of(text: str) -> bytes:
    octets = text.encode()
    return len(octets).to_bytes(2, "big") + octets


class Countdown:
    """Calls a function once as many have settled as it was made for."""

    __slots__ = ("_call", "left")

    def __init__(self, left: int, call: Callable[[], object]) -> None:
        self.left, self._call = left, call

    def one_less(self) -> None:
        """Another has settled."""
        self.left -= 1
        if not self.left:
            self._call()


class SectorStamp:
    """A sector as its messages tell of it: the numbers of scan and sector, and its end.

    That is by the sensor's clock; messages are due when it truly is.
    """

    __slots__ = ("_ids", "_octets", "due_ns", "end_ns", "index", "scan")

    def __init__(self, scan: int, index: int, end_ns: int, clock_ahead_ns: int = 0) -> None:
        self.scan, self.index, self.end_ns = scan, index, end_ns
        self.due_ns = end_ns - clock_ahead_ns
        self._ids: dict[tuple[str, int], bytes] = {}
        self._octets: tuple[bytes, bytes, int] | None = None

    def octets(self, address: Address, number: int) -> Pieces:
        """The properties of a message as packets have them; what many have alike is made once."""
        before, behind, length = self._octets or self._packed()
        kind, event, sensor, more = address.octets
        own = self._ids.get((kind, number))
        if own is None:
            own = _ID + _octets_of(f"{kind}-{self.scan}-{self.index}-{number}")
            self._ids[kind, number] = own
        return len(own) + length + more, (own, event, before, sensor, behind)

    def _packed(self) -> tuple[bytes, bytes, int]:
        """The properties before and behind the sensor's, and how long these are."""
        before = _TIME + _octets_of(iso_utc(self.end_ns))
        behind = packed_pair("scan", str(self.scan)) + packed_pair("sector", str(self.index))
        self._octets = before, behind, len(before) + len(behind)
        return self._octets


_TIME, _ID = (USER_PROPERTY + packed_text(name) for name in ("time", "id"))


class Address:
    """Where messages of one sensor and kind go, and what all of them say of themselves."""

    __slots__ = ("content_type", "event", "kind", "octets", "qos", "sensor", "topic")

    def __init__(self, source: str, sensor: str, kind: str, content_type: str, qos: int) -> None:
        """`source` is what comes before the kind in the topic."""
        self.topic = f"{source}/{kind}"
        self.content_type = content_type
        self.qos = qos
        self.kind = dashed(kind)
        self.sensor = ("sensor", sensor)
        self.event = (("type", type_of(kind)), ("specversion", "1.0"), ("source", source))
        event, whose = (
            b"".join(packed_pair(*pair) for pair in self.event),
            packed_pair(*self.sensor),
        )
        self.octets = self.kind, event, whose, len(event) + len(whose)  # as packets have them


def packed(properties: Sequence[Pair]) -> Pieces:
    """Properties as packets have them: their octets, in pieces that are to be joined."""
    pieces = [packed_pair(name, value) for name, value in properties]
    return sum(map(len, pieces)), pieces


MESSAGE_EXPIRY_S = 60  # So long a broker keeps a message that it cannot pass on
HELD_NS = 2**63 - 1  # Leaves when its link is up again: nobody knows yet when that is
# Number of a message that passes no link, such as a status: nobody asks what becomes of it.
NOT_COUNTED = -1
NO_PACKETS: Mapping[int, bytes] = MappingProxyType({})


class Message:
    """A payload, where it goes, when it is due there, and what became of it on its way.

    `properties` become MQTT 5 user properties; whoever cannot read those finds the same in the
    payload. Its link says when it leaves, or that it does not. Each transport says once, by
    `settle` or `taken`, whether it has delivered it.
    """

    __slots__ = (
        "_handed_payload",
        "_properties",
        "client",
        "content_type",
        "copy",
        "countdown",
        "delivered",
        "due_utc_ns",
        "fate",
        "flipped_bit",
        "leaves_utc_ns",
        "not_to",
        "number",
        "over_link",
        "packets",
        "payload",
        "qos",
        "retain",
        "sent_utc_ns",
        "since_s",
        "topic",
        "unsettled",
    )

    def __init__(  # noqa: PLR0917 - by their names it would take some times as long
        self,
        topic: str,
        payload: bytes,
        content_type: str,
        due_utc_ns: int,
        properties: Sequence[Pair] = (),
        retain: bool = False,
        qos: int = 0,
    ) -> None:
        """`due_utc_ns` is when it is handed to its link, if there is one."""
        self.topic, self.payload, self.content_type = topic, payload, content_type
        self._properties, self.retain, self.qos = properties, retain, qos
        self.due_utc_ns = due_utc_ns
        # When it leaves its link; `HELD_NS` while that holds it.
        self.leaves_utc_ns = due_utc_ns
        # Of all that its client hands to its link, in that order.
        self.number = NOT_COUNTED
        self.copy = 0  # 0 for the message itself, 1 for the duplicate that its link made
        self.over_link = False  # Whether there is a link that may do anything to it
        self.flipped_bit: int | None = None  # Of the payload, where the link has corrupted it
        self._handed_payload: bytes | None = None  # Where its link has changed that
        self.fate: pb.Fate = UNSPECIFIED
        self.delivered = False  # Whether a transport has delivered it
        self.not_to: tuple[str, ...] = ()  # Destinations that did not get it
        self.sent_utc_ns = 0  # When the last transport began to send it; 0 before any has
        # Monotonic time at which it first had to wait for a transport, or was first sent.
        self.since_s = 0.0
        self.client: Any = None  # Whose it is: a `Client`, for which every use would have to ask
        # Transports of which it is not known yet whether they deliver it.
        self.unsettled = 0
        self.countdown: Countdown | None = None
        # The message as MQTT packets, by version, where they were made ahead of time.
        self.packets: Mapping[int, bytes] = NO_PACKETS

    def __eq__(self, other: object) -> bool:
        """Whether the other says the same, whatever becomes of it."""
        if not isinstance(other, Message):
            return NotImplemented
        return self._said == other._said

    # In sets, each is who it is: a duplicate that says the same has a fate of its own.
    __hash__ = object.__hash__

    @property
    def _said(self) -> tuple[object, ...]:
        said = self.topic, self.payload, self.content_type, self.due_utc_ns
        return *said, tuple(self.properties), self.retain, self.qos

    def __repr__(self) -> str:
        return f"<{self.topic}, due {self.due_utc_ns}, {len(self.payload)} octets>"

    @property
    def properties(self) -> Sequence[Pair]:
        """User properties, in their order."""
        return self._properties

    def packed_properties(self) -> Pieces:
        """User properties as packets have them."""
        return packed(self._properties)

    @property
    def handed(self) -> Message:
        """The message as it was handed to the link."""
        return self if self._handed_payload is None else self.again()

    def again(self, client: Any = None, transports: int = 0) -> Message:
        """A message as this one was handed to the link, of which nothing has become yet.

        So many transports will tell that client, if there is one, what becomes of it.
        """
        payload = self.payload if self._handed_payload is None else self._handed_payload
        other = Message(
            self.topic,
            payload,
            self.content_type,
            self.due_utc_ns,
            self.properties,
            self.retain,
            self.qos,
        )
        other.client, other.unsettled = client, transports
        return other

    def become(self, payload: bytes) -> None:
        """Leave the link with another payload."""
        if self._handed_payload is None:
            self._handed_payload = self.payload
        self.payload = payload

    def duplicate(self) -> Message:
        """Another copy of it, on its way as far as this one is."""
        other = self.again(self.client, self.unsettled)
        other.number, other.copy, other.over_link = self.number, self.copy + 1, self.over_link
        other.countdown = self.countdown
        if self.countdown is not None:
            self.countdown.left += 1
        return other

    def leave(self) -> None:
        """A transport hands it to its socket now."""
        self.sent_utc_ns = self.client.now_ns()

    def taken(self, sent_utc_ns: int) -> None:
        """A transport handed it to its socket then, which took all of it."""
        self.sent_utc_ns = max(self.sent_utc_ns, sent_utc_ns)
        self.settle(delivered=True)

    def settle(self, *, delivered: bool | None, to: str = "") -> None:
        """A transport is done with it: delivered as far as it can know, or given up.

        `to` is what the transport calls its destination; None where that is for others.
        It is sent if a destination got it, or if none was to.
        """
        if delivered:
            self.delivered = True
        elif delivered is not None:
            self.not_to += (to,)
        self.unsettled -= 1
        if not self.unsettled:
            self.end(SENT if self.delivered or not self.not_to else UNDELIVERED)

    def end(self, fate: pb.Fate) -> None:
        """Note its fate, which is known now."""
        if fate == SENT and not self.sent_utc_ns:
            self.leave()
        self.fate = fate
        self.client.settled(self)
        countdown, self.countdown = self.countdown, None  # what it calls may hold this one
        if countdown is not None:
            countdown.one_less()

    def record(self) -> pb.Sent:
        """What the ledger says of it."""
        from plotfeed.proto import plotfeed_pb2 as pb

        leaves_ns = self.due_utc_ns if self.leaves_utc_ns == HELD_NS else self.leaves_utc_ns
        return pb.Sent(
            topic=self.topic,
            due_utc_ns=self.due_utc_ns,
            sent_utc_ns=self.sent_utc_ns,
            octets=len(self.payload),
            delivered=self.fate == SENT,
            fate=self.fate,
            link_due_utc_ns=leaves_ns,
            number=self.number,
            copy=self.copy,
            flipped_bit=self.flipped_bit,
            not_to=self.not_to,
        )


class SectorMessage(Message):
    """A message of a sector; its properties are CloudEvents attributes, in their order."""

    __slots__ = ("_of",)

    def __init__(
        self, address: Address, payload: bytes, stamp: SectorStamp, index: int = 0
    ) -> None:
        """`index` tells those of one kind and sector apart."""
        content_type, due_utc_ns = address.content_type, stamp.due_ns
        super().__init__(address.topic, payload, content_type, due_utc_ns, (), False, address.qos)
        self._of = address, stamp, index

    @property
    def properties(self) -> Sequence[Pair]:
        """All of them; the same tuple again."""
        if not self._properties:
            address, stamp, index = self._of
            self._properties = (
                ("id", f"{address.kind}-{stamp.scan}-{stamp.index}-{index}"),
                *address.event,
                ("time", iso_utc(stamp.end_ns)),
                address.sensor,
                ("scan", str(stamp.scan)),
                ("sector", str(stamp.index)),
            )
        return self._properties

    def packed_properties(self) -> Pieces:
        """User properties as packets have them; what many have alike is made once."""
        address, stamp, index = self._of
        return stamp.octets(address, index)


def numbered(address: Address, payloads: Sequence[bytes], stamp: SectorStamp) -> list[Message]:
    """Messages of a sector that go there, numbered in their order."""
    return [SectorMessage(address, payload, stamp, n) for n, payload in enumerate(payloads)]


def records(messages: Sequence[Message]) -> list[pb.Sent]:
    """What the ledger says of them, in the order in which they were handed to the link."""
    return [one.record() for one in sorted(messages, key=lambda one: (one.number, one.copy))]


def attributes(
    source: str, kind: str, number: str, t_utc_ns: int, **more: object
) -> tuple[Pair, ...]:
    """Properties of a message about that time; `number` tells those of a source and kind apart."""
    return (
        ("specversion", "1.0"),
        ("id", f"{dashed(kind)}-{number}"),
        ("source", source),
        ("type", type_of(kind)),
        ("time", iso_utc(t_utc_ns)),
        *[(name, str(value)) for name, value in more.items()],
    )


def retained_message(
    source: str, kind: str, payload: bytes, now_utc_ns: int, **more: str
) -> Message:
    """A message in JSON for whoever comes later, of QoS 1, on the topic {source}/{kind}."""
    return Message(
        topic=f"{source}/{kind}",
        payload=payload,
        content_type=JSON,
        due_utc_ns=now_utc_ns,
        properties=attributes(source, kind, str(now_utc_ns), now_utc_ns, **more),
        retain=True,
        qos=1,
    )


def checked_topic_filter(topic_filter: str) -> str:
    """A text that is a topic filter, + a level and # the rest; raises `PlotfeedError` if not."""
    levels = topic_filter.split("/")
    for place, level in enumerate(levels):
        alone = len(level) == 1 and (level == "+" or place == len(levels) - 1)
        if ("+" in level or "#" in level) and not alone:
            raise PlotfeedError(f"{topic_filter!r}: + is a whole level, # is the last one")
    return topic_filter


def topic_matches(topic_filter: str, topic: str) -> bool:
    """Whether a topic is one of those that the filter is for."""
    wanted, levels = topic_filter.split("/"), topic.split("/")
    for place, level in enumerate(wanted):
        if level == "#":
            return True
        if place >= len(levels) or level not in ("+", levels[place]):
            return False
    return len(wanted) == len(levels)


def is_chosen(topic: str, filters: Sequence[str]) -> bool:
    """Whether a topic is one of those that one of the filters is for; without any, all are."""
    return not filters or any(topic_matches(each, topic) for each in filters)

"""A message with its user properties: what goes out, what came in, and filters of topics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import overload

from plotfeed.proto.content_types import JSON
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc

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


class SectorProperties(Sequence[Pair]):
    """The properties of a message of a sector, as CloudEvents attributes, in their order.

    `number` tells those of one kind and sector apart.
    """

    __slots__ = ("_pairs", "address", "number", "stamp")

    def __init__(self, address: Address, stamp: SectorStamp, number: int) -> None:
        self.address, self.stamp, self.number = address, stamp, number
        self._pairs: tuple[Pair, ...] = ()

    def pairs(self) -> tuple[Pair, ...]:
        """All of them; the same tuple again."""
        if not self._pairs:
            address, stamp = self.address, self.stamp
            self._pairs = (
                ("id", f"{address.kind}-{stamp.scan}-{stamp.index}-{self.number}"),
                *address.event,
                ("time", iso_utc(stamp.end_ns)),
                address.sensor,
                ("scan", str(stamp.scan)),
                ("sector", str(stamp.index)),
            )
        return self._pairs

    def __len__(self) -> int:
        """How many there are."""
        return 8

    @overload
    def __getitem__(self, place: int) -> Pair: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[Pair, ...]: ...

    def __getitem__(self, place: int | slice) -> Pair | tuple[Pair, ...]:
        """Pairs at a place."""
        return self.pairs()[place]

    def __iter__(self) -> Iterator[Pair]:
        """One after the other."""
        return iter(self.pairs())

    def __eq__(self, other: object) -> bool:
        """Whether the other has the same pairs, whatever holds them."""
        if isinstance(other, SectorProperties | tuple):
            return self.pairs() == tuple(other)
        return NotImplemented

    def __hash__(self) -> int:
        return hash(self.pairs())

    def __repr__(self) -> str:
        return repr(self.pairs())


def packed(properties: Sequence[Pair]) -> bytes:
    """Properties as packets have them."""
    return b"".join(pieces_of(properties)[1])


def pieces_of(properties: Sequence[Pair]) -> Pieces:
    """Properties as packets have them: their octets, in pieces that are to be joined."""
    if isinstance(properties, SectorProperties):
        return properties.stamp.octets(properties.address, properties.number)
    pieces = [packed_pair(name, value) for name, value in properties]
    return sum(map(len, pieces)), pieces


MESSAGE_EXPIRY_S = 60  # So long a broker keeps a message that it cannot pass on


@dataclass(slots=True)  # frozen or by keywords, it would take some times as long to make
class Message:
    """A payload, where it goes, and when it is due there; it stays as it was made.

    `properties` become MQTT 5 user properties; whoever cannot read those finds the same in the
    payload.
    """

    topic: str
    payload: bytes
    content_type: str
    due_utc_ns: int
    properties: Sequence[Pair] = ()
    retain: bool = False
    qos: int = 0
    # The message as MQTT packets, by version, where they were made ahead of time.
    packets: dict[int, bytes] = field(init=False, default_factory=dict, compare=False, repr=False)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceivedMessage:
    """A message as it came, over MQTT 5 or, without content type and properties, 3.1.1."""

    topic: str
    payload: bytes
    content_type: str | None
    properties: tuple[tuple[str, str], ...]  # User properties
    # Whether it was published so; over MQTT 3.1.1, whether it was there before we were.
    retain: bool
    qos: int  # The lower one of what it was published with and 1


OnReceived = Callable[[ReceivedMessage], None]


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

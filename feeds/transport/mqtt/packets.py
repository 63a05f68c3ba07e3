"""Packets of MQTT 3.1.1 and 5.0 from values, and events from octets; nothing waits or sends here.

What a client writes is made by a function for each packet. What a broker writes is read by a
`BrokerReader`, however it was cut on its way. Section numbers are those of MQTT 5.0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from plotfeed.feeds.messages.message import MESSAGE_EXPIRY_S, Message, packed_text
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.varint import varint

CONNECT, CONNACK, PUBLISH, PUBACK = 0x10, 0x20, 0x30, 0x40
SUBSCRIBE, SUBACK, UNSUBSCRIBE, UNSUBACK = 0x82, 0x90, 0xA2, 0xB0
PINGREQ, PINGRESP, DISCONNECT = b"\xc0\x00", 0xD0, 0xE0
GOODBYE = b"\xe0\x00"
CLEAN, WILL, RETAIN, PASSWORD, USERNAME = 0x02, 0x04, 0x20, 0x40, 0x80
REFUSED = 128  # Reason codes from here on are refusals, in 3.1.1 of a subscription
EXPIRY, CONTENT_TYPE = b"\x02" + MESSAGE_EXPIRY_S.to_bytes(4, "big"), b"\x03"
OF_CONTENT_TYPE, SERVER_KEEP_ALIVE, RECEIVE_MAXIMUM, MAXIMUM_PACKET_SIZE = 0x03, 0x13, 0x21, 0x27
OF_USER, OF_SUBSCRIPTION, TOPIC_ALIAS = 0x26, 0x0B, 0x23
# Octets of properties that are numbers, by their identifiers (2.2.2.2).
NUMBERS = {
    **dict.fromkeys((0x01, 0x17, 0x19, 0x24, 0x25, 0x28, 0x29, 0x2A), 1),
    **dict.fromkeys((0x13, 0x21, 0x22, 0x23), 2),
    **dict.fromkeys((0x02, 0x11, 0x18, 0x27), 4),
}
# Identifiers of properties that are texts or octets behind their length.
TEXTS = frozenset({0x03, 0x08, 0x09, 0x12, 0x15, 0x16, 0x1A, 0x1C, 0x1F})
MOST_KNOWN = 256
# Those from 0x80 on are of 5.0 (2.4), those before of a CONNACK of 3.1.1.
REASONS = {
    1: "unacceptable protocol version",
    2: "identifier rejected",
    3: "broker unavailable",
    4: "bad user name or password",
    5: "not authorised",
    0x80: "unspecified error",
    0x81: "malformed packet",
    0x82: "protocol error",
    0x83: "implementation specific error",
    0x84: "unsupported protocol version",
    0x85: "client identifier not valid",
    0x86: "bad user name or password",
    0x87: "not authorized",
    0x88: "server unavailable",
    0x89: "server busy",
    0x8A: "banned",
    0x8B: "server shutting down",
    0x8C: "bad authentication method",
    0x8D: "keep alive timeout",
    0x8E: "session taken over",
    0x8F: "topic filter invalid",
    0x90: "topic name invalid",
    0x93: "receive maximum exceeded",
    0x94: "topic alias invalid",
    0x95: "packet too large",
    0x96: "message rate too high",
    0x97: "quota exceeded",
    0x98: "administrative action",
    0x99: "payload format invalid",
    0x9A: "retain not supported",
    0x9B: "qos not supported",
    0x9C: "use another server",
    0x9D: "server moved",
    0x9E: "shared subscriptions not supported",
    0x9F: "connection rate exceeded",
    0xA0: "maximum connect time",
    0xA1: "subscription identifiers not supported",
    0xA2: "wildcard subscriptions not supported",
}


class BrokenPacketError(PlotfeedError):
    """Octets of a broker that are not what MQTT lets it send to such a client."""


def reason_name(code: int) -> str:
    """A reason code of CONNACK, SUBACK, PUBACK or DISCONNECT in words."""
    return REASONS.get(code, f"reason {code:#04x}")


def connect_packet(
    client_id: str,
    version: int,
    username: str | None = None,
    password: str | None = None,
    *,
    will: Message | None = None,
    keep_alive_s: int,
) -> bytes:
    """A CONNECT that begins a clean session, with that last will if there is one (3.1)."""
    flags, of_will = CLEAN, b""
    if will is not None:
        flags |= WILL | will.qos << 3 | (RETAIN if will.retain else 0)
        if version >= 5:
            octets, pieces = will.packed_properties()
            own = CONTENT_TYPE + packed_text(will.content_type)
            of_will = b"".join([varint(len(own) + octets), own, *pieces])
        of_will += packed_text(will.topic) + len(will.payload).to_bytes(2, "big") + will.payload
    flags |= (USERNAME if username is not None else 0) | (PASSWORD if password is not None else 0)
    return packet(
        CONNECT,
        packed_text("MQTT"),
        bytes((version, flags)),
        keep_alive_s.to_bytes(2, "big"),
        varint(0) if version >= 5 else b"",  # its own properties
        packed_text(client_id),
        of_will,
        *(packed_text(text) for text in (username, password) if text is not None),
    )


def subscribe_packet(
    number: int, topic_filter: str, version: int, *, as_published: bool = False
) -> bytes:
    """A SUBSCRIBE with QoS 1; `as_published` has retained messages marked, in 5.0 (3.8)."""
    options = 1 | (8 if as_published and version >= 5 else 0)
    return packet(
        SUBSCRIBE, _numbered(number, version), packed_text(topic_filter), bytes((options,))
    )


def unsubscribe_packet(number: int, topic_filter: str, version: int) -> bytes:
    """An UNSUBSCRIBE (3.10)."""
    return packet(UNSUBSCRIBE, _numbered(number, version), packed_text(topic_filter))


def acknowledgements(numbers: Iterable[int]) -> bytes:
    """A PUBACK for each of those packets, all of which are taken (3.4)."""
    return b"".join(b"\x40\x02" + number.to_bytes(2, "big") for number in numbers)


def publish_packet(message: Message, version: int, *, number: int | None = None) -> bytes:
    """The PUBLISH of a message (3.3); what is retained does not expire.

    With `number` as its id it is of QoS 1, without of QoS 0.
    """
    payload, first = message.payload, PUBLISH | message.retain
    octets, expiry = 0, b""
    properties: Sequence[bytes] = ()
    if version >= 5:
        octets, properties = message.packed_properties()
        if not message.retain:
            expiry = EXPIRY
            octets += len(expiry)
    front = _front(message.topic, message.content_type, octets, version)
    if number is not None:
        first |= 2
        end = 2 + (front[0] << 8 | front[1])  # of the topic, which it stands behind
        front = front[:end] + number.to_bytes(2, "big") + front[end:]
    head = _head(first, len(front) + octets + len(payload))
    return b"".join([head, front, *properties, expiry, payload])


@lru_cache(maxsize=1 << 14)  # what all messages of a sensor and kind have alike
def _front(topic: str, content_type: str, octets: int, version: int) -> bytes:
    """The topic and, of 5.0, the first of its properties, before so many octets of others."""
    if version < 5:
        return packed_text(topic)
    own = CONTENT_TYPE + packed_text(content_type)
    return packed_text(topic) + varint(len(own) + octets) + own


@lru_cache(maxsize=4096)
def _head(first: int, rest: int) -> bytes:
    return bytes((first,)) + varint(rest)


def packet(first: int, *parts: bytes) -> bytes:
    """A packet of those parts behind its first octet and their length."""
    rest = b"".join(parts)
    return bytes((first,)) + varint(len(rest)) + rest


def _numbered(number: int, version: int) -> bytes:
    return number.to_bytes(2, "big") + (varint(0) if version >= 5 else b"")


@dataclass(frozen=True, slots=True)
class PacketProperties:
    """Properties of a packet of MQTT 5.0; none of one of 3.1.1."""

    content_type: str | None = None
    pairs: tuple[tuple[str, str], ...] = ()  # User properties
    # Those that are numbers, by their identifiers.
    numbers: dict[int, int] = field(default_factory=dict)


NO_PROPERTIES = PacketProperties()


@dataclass(slots=True)
class Publication:
    """A PUBLISH; over MQTT 3.1.1 it has no properties."""

    topic: str
    payload: bytes
    # Whether it was published so; over MQTT 3.1.1, whether it was there before we were.
    retain: bool
    number: int | None  # Of the PUBACK that it wants; None of QoS 0
    properties: PacketProperties


@dataclass(frozen=True, slots=True)
class BrokerAnswer:
    """Any other packet of a broker: CONNACK, PUBACK, SUBACK, UNSUBACK, PINGRESP or DISCONNECT."""

    kind: int
    number: int = 0  # Of the packet that is answered
    codes: bytes = b"\0"  # Reason codes, one for each filter of a SUBSCRIBE
    properties: PacketProperties = NO_PROPERTIES


class PacketSplitter:
    """Cuts what comes over a connection into packets, however it was cut on its way."""

    def __init__(self, check: Callable[[int, int], object] = lambda _first, _length: None) -> None:
        """`check` is given the first octet and the length of a packet before it is there."""
        self._check = check
        self._rest = bytearray()
        self._needs = 2

    def split(self, octets: bytes | memoryview) -> Iterator[tuple[int, bytes]]:
        """First octet and body of each packet that is complete with these octets.

        All of it must be taken before the next call; raises `BrokenPacketError`.
        """
        self._rest += octets
        if len(self._rest) < self._needs:
            return
        data, at = bytes(self._rest), 0
        self._rest.clear()
        while True:
            try:
                length, begin = read_length(data, at + 1)
                self._check(data[at], length)
                end = begin + length
            except IndexError:
                end = len(data) + 1
            if end > len(data):
                self._rest += data[at:]
                self._needs = end - at
                return
            yield data[at], data[begin:end]
            at = end


class BrokerReader:
    """Reads what a broker sends to a client that asks for no more than QoS 1, and no aliases."""

    def __init__(self, version: int) -> None:
        self._has_properties = version >= 5
        self._splitter = PacketSplitter()
        # Properties by their octets: those of most messages are those of one before.
        self._known: dict[bytes, PacketProperties] = {}

    def receive(self, octets: bytes | memoryview) -> Iterator[Publication | BrokerAnswer]:
        """What is complete with these octets; raises `BrokenPacketError` behind the last good one.

        All of it must be taken before the next call.
        """
        for first, body in self._splitter.split(octets):
            try:
                event = self._publication(first, body) or self._answer(first, body)
            except IndexError:
                event = None
            if event is None:
                raise BrokenPacketError(f"a packet of kind {first:#04x} that no such client gets")
            yield event

    def _publication(self, first: int, body: bytes) -> Publication | None:
        """The PUBLISH; None, or IndexError, where it is none."""
        qos, topic_end = first >> 1 & 3, 2 + (body[0] << 8 | body[1]) if len(body) > 1 else 0
        place = topic_end + (2 if qos else 0)
        if first & 0xF0 != PUBLISH or qos > 1 or topic_end <= 2 or place > len(body):
            return None
        number = int.from_bytes(body[topic_end:place], "big") if qos else None
        properties = NO_PROPERTIES
        if self._has_properties:
            length, end = read_length(body, place)
            octets = body[place : end + length]
            known = self._known.get(octets)
            if known is None:
                known, _ = read_properties(octets, 0)
                if len(self._known) >= MOST_KNOWN:
                    self._known.clear()
                self._known[octets] = known
            properties, place = known, end + length
        if number == 0 or TOPIC_ALIAS in properties.numbers:  # nobody has allowed an alias
            return None
        return Publication(
            _text(body[2:topic_end]), body[place:], bool(first & 1), number, properties
        )

    def _answer(self, first: int, body: bytes) -> BrokerAnswer | None:
        """The answer; None, or IndexError, where it is none."""
        number, properties, of_5 = 0, NO_PROPERTIES, self._has_properties
        if first == PINGRESP:
            return None if body else BrokerAnswer(first)
        if first in (SUBACK, UNSUBACK):
            number, end = int.from_bytes(body[:2], "big"), 2
            if of_5:
                properties, end = read_properties(body, end)
            codes = body[end:]
            return BrokerAnswer(first, number, codes, properties) if number else None
        if first == CONNACK:
            # A broker that does not know 5.0 refuses in the words of 3.1.1.
            code, end = body[1], 2
            is_short = not of_5 or (code and len(body) == 2)
            if body[0] > 1:
                return None
        elif first == PUBACK:
            number, end = int.from_bytes(body[:2], "big"), 3 if of_5 and len(body) > 2 else 2
            code = body[2] if end == 3 else 0
            is_short = len(body) == end
            if not number:
                return None
        elif first == DISCONNECT and of_5:
            code, end = (body[0], 1) if body else (0, 0)
            is_short = len(body) == end
        else:
            return None
        if of_5 and not is_short:
            properties, end = read_properties(body, end)
        answer = BrokerAnswer(first, number, bytes((code,)), properties)
        return answer if end == len(body) else None


def read_length(data: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits an octet, and where it ends; IndexError where it is cut (1.5.5)."""
    number = 0
    for place in range(at, at + 4):
        number |= (data[place] & 0x7F) << 7 * (place - at)
        if data[place] < 0x80:
            return number, place + 1
    raise BrokenPacketError("a length of more than four octets")


def read_properties(data: bytes, at: int) -> tuple[PacketProperties, int]:
    """Properties at that place, and where they end; raises `BrokenPacketError`, or IndexError."""
    length, place = read_length(data, at)
    end = place + length
    if end > len(data):
        raise BrokenPacketError("properties that are longer than their packet")
    content_type, pairs, numbers = None, [], dict[int, int]()
    seen = set[int]()
    while place < end:
        kind, place = data[place], place + 1
        if kind in seen and kind not in (OF_USER, OF_SUBSCRIPTION):
            raise BrokenPacketError(f"property {kind:#04x} twice")
        seen.add(kind)
        if kind == OF_USER:
            name, place = read_octets(data, place, end)
            value, place = read_octets(data, place, end)
            pairs.append((_text(name), _text(value)))
        elif kind in TEXTS:
            value, place = read_octets(data, place, end)
            if kind == OF_CONTENT_TYPE:
                content_type = _text(value)
        elif kind == OF_SUBSCRIPTION:
            numbers[kind], place = read_length(data, place)
        elif kind in NUMBERS:
            octets, place = data[place : place + NUMBERS[kind]], place + NUMBERS[kind]
            numbers[kind] = int.from_bytes(octets, "big")
        else:
            raise BrokenPacketError(f"unknown property {kind:#04x}")
    if place != end:
        raise BrokenPacketError("properties that are longer than they say")
    return PacketProperties(content_type, tuple(pairs), numbers), end


def read_octets(data: bytes, at: int, end: int) -> tuple[bytes, int]:
    """Octets behind their number, and where they end; `BrokenPacketError` beyond `end`."""
    begin = at + 2
    behind = begin + int.from_bytes(data[at:begin], "big")
    if behind > end:
        raise BrokenPacketError("a text that is longer than its packet")
    return data[begin:behind], behind


def _text(octets: bytes) -> str:
    # Some brokers pass on what others send unread: one client must not end everybody's connection.
    return octets.decode(errors="replace")

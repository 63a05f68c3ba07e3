"""Packets of MQTT: against those that paho-mqtt makes and reads, cut anywhere, and broken."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from paho.mqtt import client as paho
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from plotfeed.feeds.messages.message import (
    MESSAGE_EXPIRY_S,
    Address,
    Message,
    SectorMessage,
    SectorStamp,
)
from plotfeed.feeds.transport.mqtt.packets import (
    CONNACK,
    DISCONNECT,
    GOODBYE,
    PINGREQ,
    PINGRESP,
    PUBACK,
    SUBACK,
    UNSUBACK,
    BrokenPacketError,
    BrokerAnswer,
    BrokerReader,
    Publication,
    acknowledgements,
    connect_packet,
    publish_packet,
    reason_name,
    subscribe_packet,
    unsubscribe_packet,
)
from plotfeed.proto.varint import varint

words = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=30)
pairs = st.lists(st.tuples(words, words), max_size=5).map(tuple)
versions = st.sampled_from([4, 5])
ids = st.integers(1, 65_535)
integers = st.integers(-1, 10**10)
of_sectors = st.builds(
    SectorMessage,
    st.builds(Address, words, words, words, words, st.sampled_from([0, 1])),
    st.binary(max_size=300),
    st.builds(SectorStamp, integers, integers, st.integers(-(2**40), 2**63)),
    st.integers(0, 1000),
)
messages = of_sectors | st.builds(
    Message,
    topic=words,
    payload=st.binary(max_size=300),
    content_type=words,
    due_utc_ns=st.just(0),
    properties=pairs,
    retain=st.booleans(),
    qos=st.sampled_from([0, 1]),
)


def by_paho(version: int, write: Callable[[Any], object], client_id: str = "test") -> bytes:
    """What paho-mqtt would write."""
    written: list[bytes] = []
    client: Any = paho.Client(
        paho.CallbackAPIVersion.VERSION2,
        client_id=client_id,
        protocol=paho.MQTTProtocolVersion(version),
    )
    client._clean_start, client._sock = True, object()
    client._packet_queue = lambda _command, packet, *_: written.append(bytes(packet))
    write(client)
    client._sock = None
    return b"".join(written)


@given(words, messages, versions, st.tuples(words, st.none() | words), st.integers(1, 65_535))
def test_who_connects_with_a_will_says_what_an_independent_client_says(
    client_id: str, will: Message, version: int, access: tuple[str, str | None], alive_s: int
) -> None:
    def write(client: Any) -> None:
        properties = None
        if version >= 5:
            properties = Properties(PacketTypes.WILLMESSAGE)
            properties.ContentType = will.content_type
            if will.properties:
                properties.UserProperty = list(will.properties)
        client.username_pw_set(*access)
        client._will, client._will_topic = True, will.topic.encode()
        client._will_payload, client._will_qos = will.payload, will.qos
        client._will_retain, client._will_properties = will.retain, properties
        client._send_connect(alive_s)

    made = connect_packet(client_id, version, *access, will=will, keep_alive_s=alive_s)
    assert made == by_paho(version, write, client_id)


@given(ids, words, versions, st.booleans())
def test_what_is_asked_of_a_broker_is_what_an_independent_client_asks(
    number: int, topic_filter: str, version: int, as_published: bool
) -> None:
    octets = topic_filter.encode()

    def subscribe(client: Any) -> None:
        client._last_mid = number - 1
        options = SubscribeOptions(qos=1, retainAsPublished=as_published)
        client._send_subscribe(False, [(octets, options if version >= 5 else 1)])

    def unsubscribe(client: Any) -> None:
        client._last_mid = number - 1
        client._send_unsubscribe(False, [octets])

    made = subscribe_packet(number, topic_filter, version, as_published=as_published)
    assert made == by_paho(version, subscribe)
    assert unsubscribe_packet(number, topic_filter, version) == by_paho(version, unsubscribe)
    assert acknowledgements([number]) == by_paho(version, lambda c: c._send_puback(number))
    assert by_paho(version, lambda client: client._send_pingreq()) == PINGREQ
    assert by_paho(version, lambda client: client._send_disconnect()) == GOODBYE


@given(messages, versions, ids)
@example(Message("a", b"", "", 0, [("k", "v" * 120)]), 5, 1)
@example(Message("a", b"", "", 0, [("k", "v" * 60_000)]), 5, 1)
def test_a_publication_is_what_an_independent_client_reads_and_makes(
    message: Message, version: int, number: int
) -> None:
    made = publish_packet(message, version, number=number if message.qos else None)
    expected = by_paho(
        4,
        lambda client: client._send_publish(
            number, message.topic.encode(), message.payload, message.qos, message.retain
        ),
    )
    if version < 5:
        assert made == expected
        return
    first, rest = made[0], body_of(made)
    head = 2 + len(message.topic.encode()) + (2 if message.qos else 0)
    assert (first, rest[:head]) == (expected[0], body_of(expected)[:head])
    properties = Properties(PacketTypes.PUBLISH)
    _, octets = properties.unpack(rest[head:])
    assert rest[head + octets :] == message.payload
    assert properties.ContentType == message.content_type
    assert getattr(properties, "UserProperty", []) == list(message.properties)
    told = getattr(properties, "MessageExpiryInterval", None)
    assert told == (None if message.retain else MESSAGE_EXPIRY_S)


def body_of(packet: bytes) -> bytes:
    place = 1
    while packet[place] >= 0x80:
        place += 1
    return packet[place + 1 :]


@pytest.mark.parametrize(
    ("octets", "length"),
    [(124, "7f"), (125, "8001"), (16_380, "ff7f"), (16_381, "808001"), (2_097_149, "80808001")],
)
def test_remaining_lengths_are_those_of_the_standards_table(octets: int, length: str) -> None:
    """MQTT 3.1.1, table 2.4; the topic takes three octets more."""
    message = Message(topic="t", payload=b"x" * octets, content_type="", due_utc_ns=0)
    packet = publish_packet(message, 4)
    assert packet[1 : 1 + len(length) // 2].hex() == length
    assert len(packet) == 1 + len(length) // 2 + 3 + octets
    reader = BrokerReader(4)
    assert [*reader.receive(packet[:-1])] == []
    (event,) = reader.receive(packet[-1:])
    assert isinstance(event, Publication)
    assert event.payload == message.payload


codes = st.sampled_from([0, 1, 0x80, 0x87, 0x97])


@st.composite
def sent_by_a_broker(draw: st.DrawFn, version: int) -> tuple[bytes, BrokerAnswer | Message]:
    """A packet, and what it says: a message has its number as due time."""
    kind = draw(st.sampled_from([0, CONNACK, PUBACK, SUBACK, UNSUBACK, PINGRESP, DISCONNECT]))
    number, code, least = draw(ids), draw(codes), draw(ids)
    if not kind or (kind == DISCONNECT and version < 5):
        message = draw(messages)
        message.due_utc_ns = number if message.qos else 0
        return publish_packet(message, version, number=number if message.qos else None), message
    properties, numbered, said = b"", number.to_bytes(2, "big"), bytes((code,))
    if version >= 5 and kind != PINGRESP:
        told = Properties(kind >> 4)
        told.ReasonString, told.UserProperty = draw(words), list(draw(pairs)) or [("a", "b")]
        if kind == CONNACK:
            told.ReceiveMaximum = told.MaximumPacketSize = told.ServerKeepAlive = least
        properties = bytes(told.pack()) if draw(st.booleans()) else b"\0"
    if kind == CONNACK:
        number, body = 0, bytes((draw(st.integers(0, 1)), code)) + properties
    elif kind in (SUBACK, UNSUBACK):
        said = bytes(draw(st.lists(codes, min_size=1, max_size=4)))
        body = numbered + properties + said
    else:  # a reason may be left out, and its properties
        parts = [said, properties][: draw(st.integers(0, 2)) if properties else 0]
        said = said if parts else b"\0"
        number, body = (number, numbered) if kind == PUBACK else (0, b"")
        body += b"".join(parts)
    return bytes((kind,)) + varint(len(body)) + body, BrokerAnswer(kind, number, said)


streams = versions.flatmap(
    lambda version: st.tuples(st.just(version), st.lists(sent_by_a_broker(version), max_size=6))
)


def in_pieces(octets: bytes, sizes: list[int]) -> list[bytes]:
    pieces = []
    for size in sizes:
        pieces.append(octets[:size])
        octets = octets[size:]
    return [*pieces, octets]


@given(streams, st.lists(st.integers(0, 60), max_size=12))
def test_what_a_broker_says_is_read_however_it_is_cut(
    stream: tuple[int, list[tuple[bytes, BrokerAnswer | Message]]], sizes: list[int]
) -> None:
    version, sent = stream
    reader = BrokerReader(version)
    pieces = in_pieces(b"".join(octets for octets, _ in sent), sizes)
    events = [event for piece in pieces for event in reader.receive(memoryview(piece))]
    assert len(events) == len(sent)
    for event, (_, expected) in zip(events, sent, strict=True):
        if isinstance(event, BrokerAnswer):
            assert isinstance(expected, BrokerAnswer)
            found = (event.kind, event.number, event.codes)
            assert found == (expected.kind, expected.number, expected.codes)
            assert len({*event.properties.numbers.values()}) <= 1
            continue
        assert isinstance(expected, Message)
        assert (event.topic, event.payload) == (expected.topic, expected.payload)
        assert (event.retain, event.number or 0) == (expected.retain, expected.due_utc_ns)
        if version >= 5:
            assert event.properties.content_type == expected.content_type
            assert event.properties.pairs == tuple(expected.properties)


def read(version: int, pieces: list[bytes]) -> tuple[list[object], str | None]:
    """What was read, and why no more, if so."""
    reader, events = BrokerReader(version), list[object]()
    for piece in pieces:
        try:
            events.extend(reader.receive(piece))
        except BrokenPacketError as error:
            return events, str(error)
    return events, None


@given(
    versions,
    st.binary(max_size=60)
    | st.builds(
        lambda kind, body: bytes((kind,)) + varint(len(body)) + body,
        st.sampled_from([0x20, 0x30, 0x32, 0x40, 0x90, 0xB0, 0xD0, 0xE0]),
        st.binary(max_size=40),
    ),
    st.lists(st.integers(0, 20), max_size=8),
)
@example(5, bytes.fromhex("900501020180"), [])
def test_garbage_is_one_kind_of_error_and_the_same_however_it_is_cut(
    version: int, garbage: bytes, sizes: list[int]
) -> None:
    assert read(version, in_pieces(garbage, sizes)) == read(version, [garbage])


BROKEN = [
    (5, "30ffffffff7f"),  # a length of five octets
    (5, "3003000000"),  # no topic
    (4, "3405000174000178"),  # QoS 2, which nobody has asked for
    (4, "32050001740000"),  # QoS 1 without a number
    (5, "30080001740323000178"),  # a topic alias, which nobody has allowed
    (5, "300600017405ff0100"),  # properties longer than their packet
    (5, "3006000174020200"),  # one that goes beyond the others
    (5, "300800017404010101010"[:-1]),  # a number twice
    (5, "300600017402ff00"),  # an unknown property
    (4, "20020200"),  # flags that nobody knows
    (4, "2003000000"),
    (4, "200100"),
    (5, "2004000002"),
    (4, "4001ff"),
    (4, "40020000"),  # the number 0
    (4, "4003000100"),  # a reason, which 3.1.1 does not have
    (4, "900100"),
    (4, "d00100"),
    (4, "e000"),  # only a client says goodbye by 3.1.1
    (5, "50020001"),  # of QoS 2
    (5, "c000"),  # a client's
    (5, "00"),
    (5, "0000"),
]


def test_what_no_broker_may_say_ends_the_connection() -> None:
    for version, packet in BROKEN:
        events, error = read(version, [bytes.fromhex(packet) + bytes(300)])
        assert events == [], packet
        assert error, packet


def test_a_refusal_in_the_words_of_3_1_1_is_understood_by_who_speaks_5() -> None:
    assert read(5, [b"\x20\x02\x00\x01"]) == ([BrokerAnswer(CONNACK, codes=b"\1")], None)
    assert read(5, [b"\x20\x02\x00\x00"])[1] is not None


def test_a_topic_that_is_no_text_ends_nobodys_connection() -> None:
    """Some brokers pass on what others send without a look at it."""
    (event,), error = read(4, [b"\x30\x0b\x00\x02\xff\xfepayload"])
    assert isinstance(event, Publication)
    assert (event.topic, event.payload, error) == ("\ufffd\ufffd", b"payload", None)


def test_reason_codes_have_words() -> None:
    said = {5: "not authorised", 0x87: "not authorized", 0x9D: "server moved", 0x77: "reason 0x77"}
    assert {code: reason_name(code) for code in said} == said

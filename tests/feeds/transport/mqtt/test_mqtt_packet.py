"""Against gmqtt's own packets, and as the standard counts lengths."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import gmqtt
import pytest
from gmqtt.mqtt.package import PublishPacket
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.user_properties import Address, SectorProperties, SectorStamp
from plotfeed.feeds.transport.mqtt.publish_packet import pack, publish_packet

words = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=30)


def by_gmqtt(message: Message, version: int, expiry_s: int, number: int | None) -> bytes:
    more = {}
    if version >= 5:
        more = {"content_type": message.content_type}
        if message.properties:
            more["user_property"] = list(message.properties)  # type: ignore[assignment]
        if not message.retain:
            more["message_expiry_interval"] = expiry_s  # type: ignore[assignment]
    qos = 0 if number is None else 1
    packet = gmqtt.Message(message.topic, message.payload, qos=qos, retain=message.retain, **more)
    ids = SimpleNamespace(next_id=lambda: number)
    protocol = SimpleNamespace(proto_ver=version, id_generator=ids)
    _, octets = PublishPacket.build_package(packet, protocol)
    return bytes(octets)


numbers = st.integers(-1, 10**10)
of_sectors = st.builds(
    SectorProperties,
    st.builds(Address, words, words, words, words, st.just(0)),
    st.builds(SectorStamp, numbers, numbers, st.integers(-(2**40), 2**63)),
    st.integers(0, 1000),
)
messages = st.builds(
    Message,
    topic=words,
    payload=st.binary(max_size=300),
    content_type=words,
    due_utc_ns=st.just(0),
    properties=st.lists(st.tuples(words, words), max_size=5).map(tuple) | of_sectors,
    retain=st.booleans(),
)


numbers = st.one_of(st.none(), st.integers(1, 65_535))


@given(messages, st.sampled_from([4, 5]), st.integers(1, 2**32 - 1), numbers)
def test_a_packet_is_what_an_independent_client_makes_of_the_same_message(
    message: Message, version: int, expiry_s: int, number: int | None
) -> None:
    expected = by_gmqtt(message, version, expiry_s, number)
    assert publish_packet(message, version, expiry_s, number=number) == expected


@given(st.lists(messages, max_size=5), st.sampled_from([4, 5]), st.integers(0, 1))
def test_messages_of_qos_0_hold_their_packets_when_they_are_packed(
    some: list[Message], version: int, qos: int
) -> None:
    last = [replace(message, qos=qos) for message in some[-1:]]
    pack([*some[:-1], *last], version)
    for message in [*some[:-1], *last]:
        made = {} if message.qos else {version: publish_packet(message, version)}
        assert message.packets == made


@pytest.mark.parametrize(
    ("octets", "length"),
    [
        (124, "7f"),
        (125, "8001"),
        (16_380, "ff7f"),
        (16_381, "808001"),
        (2_097_148, "ffff7f"),
        (2_097_149, "80808001"),
    ],
)
def test_remaining_lengths_are_those_of_the_standards_table(octets: int, length: str) -> None:
    """MQTT 3.1.1, table 2.4; the topic takes three octets more."""
    message = Message(topic="t", payload=b"x" * octets, content_type="", due_utc_ns=0)
    packet = publish_packet(message, 4, 60)
    assert packet[1 : 1 + len(length) // 2].hex() == length
    assert len(packet) == 1 + len(length) // 2 + 3 + octets

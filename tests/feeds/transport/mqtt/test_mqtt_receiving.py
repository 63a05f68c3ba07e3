"""What comes over MQTT, read by us, against what gmqtt reads in the same packets."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.brokers import free_port
from support.deliveries import NOBODY
from support.sessions import Start, every_broker
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import Outgoing
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.gmqtt_client import PUBLISH, GmqttClient
from plotfeed.proto.varint import varint

words = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12)


def text(value: str) -> bytes:
    octets = value.encode()
    return len(octets).to_bytes(2, "big") + octets


properties = st.lists(
    st.one_of(
        st.builds(lambda t: b"\x03" + text(t), words),
        st.builds(lambda a, b: b"\x26" + text(a) + text(b), words, words),
        st.builds(lambda n: b"\x02" + n.to_bytes(4, "big"), st.integers(0, 2**32 - 1)),
        st.builds(lambda n: b"\x23" + n.to_bytes(2, "big"), st.integers(1, 3)),  # an alias
        st.sampled_from([b"\xff", b"\x01\x01"]),
    ),
    max_size=4,
).map(b"".join)


def packet(qos: int, topic: str, properties: bytes | None, payload: bytes) -> bytes:
    number = b"\x01\x02" if qos else b""
    of_5 = b"" if properties is None else varint(len(properties)) + properties
    return text(topic) + number + of_5 + payload


class Ears:
    """A client of ours that is not connected, and all that it does with packets that come."""

    def __init__(self, version: int, *, by_gmqtt: bool) -> None:
        self.heard: list[tuple[Any, ...]] = []
        self.client = GmqttClient(
            "test",
            version,
            username=None,
            password=None,
            on_accepted=lambda _: None,
            on_granted=lambda *_: None,
            on_message=self.came,
            on_acknowledged=lambda _: None,
            on_ended=lambda _: None,
        )
        inner = self.client._client
        inner._connection_state.protocol_version = version
        inner._connection = inner._package_handler._connection = self
        if by_gmqtt:
            cache = inner._package_handler._handler_cache
            cache[PUBLISH] = inner._package_handler._handle_publish_packet
        self.written = b""
        self._transport = self

    def came(
        self, topic: str, payload: bytes, qos: int, retain: bool, properties: dict[str, Any]
    ) -> None:
        known = {k: v for k, v in properties.items() if k not in ("dup", "retain")}
        self.heard.append((topic, payload, qos, retain, known))

    def is_closing(self) -> bool:
        return False

    def send_package(self, octets: bytes) -> None:
        self.written += octets

    def send_command_with_mid(self, command: int, number: int, _dup: bool, **_: object) -> None:
        self.written += bytes((command, 2)) + number.to_bytes(2, "big")


async def heard(version: int, packets: Sequence[tuple[int, bytes]], *, by_gmqtt: bool) -> Any:
    ears = Ears(version, by_gmqtt=by_gmqtt)
    for command, octets in packets:
        try:
            ears.client._client._package_handler._handle_packet(command, octets)
        except Exception as error:  # noqa: BLE001 - a packet that is none, which gmqtt passes over
            ears.heard.append((type(error).__name__ != "",))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    return ears.heard, ears.written


publications = st.lists(
    st.tuples(
        st.integers(0, 1), st.booleans(), words, properties, st.binary(max_size=40),
        st.integers(0, 200),
    ),
    max_size=6,
)  # fmt: skip


@given(st.sampled_from([4, 5]), publications)
@example(5, [(0, False, "t", b"\x03" + text("x" * 200), b"payload", 200)] * 2)
@example(
    5, [(1, True, "t", b"\x23\x00\x01", b"1", 200), (1, False, "", b"\x23\x00\x01", b"2", 200)]
)
def test_what_comes_is_what_gmqtt_reads_in_it(version: int, publications: list[Any]) -> None:
    """The last number is how much of a packet comes; what is no packet is passed over."""
    packets = []
    for qos, retain, topic, of_5, payload, most in publications:
        octets = packet(qos, topic, of_5 if version == 5 else None, payload)
        packets.append((PUBLISH | qos << 1 | retain, octets[: max(most, 2)]))
    ours = asyncio.run(heard(version, packets, by_gmqtt=False))
    assert ours == asyncio.run(heard(version, packets, by_gmqtt=True))


def test_a_topic_that_is_no_text_is_passed_on_as_gmqtt_does() -> None:
    packets = [(PUBLISH, b"\x00\x02\xff\xfepayload")]
    ours = asyncio.run(heard(4, packets, by_gmqtt=False))
    assert ours == asyncio.run(heard(4, packets, by_gmqtt=True))


def test_messages_that_come_together_are_acknowledged_together() -> None:
    async def writes() -> int:
        ears, count = Ears(5, by_gmqtt=False), 0

        def write(octets: bytes) -> None:
            nonlocal count
            count += 1
            assert octets == b"\x40\x02\x01\x02" * 50

        ears.send_package = write  # type: ignore[method-assign]
        for _ in range(50):
            octets = packet(1, "t", b"", b"x")
            ears.client._client._package_handler._handle_packet(PUBLISH | 2, octets)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert len(ears.heard) == 50
        return count

    assert asyncio.run(writes()) == 1


@every_broker
@pytest.mark.parametrize("octets", [100, 127, 128, 200, 16_383, 16_384, 60_000])
@pytest.mark.asyncio
async def test_however_long_properties_are_the_connection_stays(
    start: Start, tmp_path: Path, octets: int
) -> None:
    port = free_port()
    heard: list[bytes] = []
    with start(tmp_path, port):
        link = MqttTransport(
            BrokerAddress("127.0.0.1", port, (5,)),
            "test",
            subscribe=["a"],
            on_message=lambda _topic, payload, _type: heard.append(payload),
        )
        async with link.connected(PATIENCE_S):
            pairs = [("k", "v" * (octets - 6))]
            for payload in (b"1", b"2"):
                message = Message("a", payload, "", 0, properties=pairs, qos=1)
                link.publish([Outgoing(message, client=NOBODY, transports=1)])
                await until(lambda payload=payload: payload in heard)  # type: ignore[misc]
            assert link.connections == 1

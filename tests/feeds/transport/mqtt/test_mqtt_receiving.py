"""What comes over a connection: acknowledged together, of any size, a sign of life, or broken."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from support.brokers import free_port
from support.deliveries import NOBODY, Deliveries
from support.scripted_broker import ScriptedBroker, linked, serving
from support.sessions import Start, every_broker
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import publish
from plotfeed.feeds.transport.mqtt import connection
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.connection import MqttConnection
from plotfeed.feeds.transport.mqtt.packets import acknowledgements, publish_packet

pytestmark = pytest.mark.usefixtures("hurried")


@pytest.mark.asyncio
async def test_messages_that_come_together_are_acknowledged_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broker, heard, written = ScriptedBroker(), list[bytes](), list[bytes]()
    async with serving(broker):
        address = BrokerAddress("127.0.0.1", broker.port, (5,))
        link = MqttConnection(
            address, 5, "test", on_message=lambda _topic, payload, _type: heard.append(payload)
        )
        await link.open(PATIENCE_S)
        monkeypatch.setattr(link, "_write", written.append)
        message = Message("t", b"x", "", 0, qos=1)
        octets = b"".join(publish_packet(message, 5, number=n) for n in range(1, 51))
        link.get_buffer(-1)[: len(octets)] = octets
        link.buffer_updated(len(octets))
        link.abort()
    assert heard == [b"x"] * 50
    assert written == [acknowledgements(range(1, 51))]


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
                publish([link], [message.again(NOBODY, 1)])
                await until(lambda payload=payload: payload in heard)  # type: ignore[misc]
            assert link.connections == 1


@pytest.mark.asyncio
async def test_a_broker_that_says_nothing_is_gone_unless_its_socket_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connection, "KEEP_ALIVE_S", 0.2)
    async with serving(broker := ScriptedBroker(reads=False)):  # which answers no ping
        link = MqttConnection(BrokerAddress("127.0.0.1", broker.port, (5,)), 5, "test")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(connection, "connect_packet", _with_a_long_keep_alive)
            await link.open(PATIENCE_S)
        for _ in range(30):
            link._buffer.moved_s = asyncio.get_running_loop().time()
            await asyncio.sleep(0.02)
        assert not link.lost.is_set()
        await asyncio.wait_for(link.lost.wait(), PATIENCE_S)
    assert link.good_bye == "it says nothing any more"


_whole = connection.connect_packet


def _with_a_long_keep_alive(*told: str, keep_alive_s: float, **more: object) -> bytes:
    return _whole(*told, keep_alive_s=60, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "body", "why"),
    [
        (0x20, b"\0\0\0", "a second CONNACK"),
        (0x50, b"\0\1", "a packet of kind 0x50 that no such client gets"),
        (0x30, b"\0\1t\x02\xff\0", "unknown property 0xff"),
    ],
)
@pytest.mark.asyncio
async def test_a_broker_that_breaks_the_rules_is_left_with_a_word_and_tried_again(
    caplog: pytest.LogCaptureFixture, kind: int, body: bytes, why: str
) -> None:
    broker, deliveries = ScriptedBroker(), Deliveries()
    async with linked(broker) as link:
        deliveries.publish(link, 1)
        await until(lambda: broker.received == 1)
        broker.send(kind, body)
        await until(lambda: link.connections == 2)
        broker.acknowledges = True
        await until(lambda: broker.received == 2)
    (line,) = [r.getMessage() for r in caplog.records if "lost the connection" in r.getMessage()]
    assert f"(it does not keep to MQTT: {why})" in line

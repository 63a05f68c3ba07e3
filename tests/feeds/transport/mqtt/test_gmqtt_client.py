"""What plotfeed relies on in gmqtt besides its public interface; in words, for when it changes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version
from operator import attrgetter
from typing import Any

import pytest
from gmqtt.mqtt.handler import MQTTConnectError
from support.deliveries import Deliveries
from support.scripted_broker import ScriptedBroker, serving
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.transport.mqtt import gmqtt_client
from plotfeed.feeds.transport.mqtt.gmqtt_client import (
    PRIVATE,
    GmqttClient,
    reason_name,
    refusal_code,
)
from plotfeed.feeds.transport.mqtt.publish_packet import publish_packet


class Used:
    """A client of ours over a scripted broker, and what it is told."""

    def __init__(self) -> None:
        self.answers: list[bytes] = []
        self.ended: list[bytes] = []
        self.client = GmqttClient(
            "test",
            5,
            username=None,
            password=None,
            on_accepted=lambda _: None,
            on_granted=lambda *_: None,
            on_message=lambda *_: None,
            on_acknowledged=self.answers.append,
            on_ended=self.ended.append,
        )

    @property
    def connection(self) -> Any:
        return self.client._client._connection


@asynccontextmanager
async def used(broker: ScriptedBroker) -> AsyncIterator[Used]:
    it = Used()
    async with asyncio.timeout(PATIENCE_S), serving(broker):
        await it.client.connect("127.0.0.1", broker.port, None)
        try:
            yield it
        finally:
            it.client.abort()


def told(name: str, what: str) -> str:
    return (
        f"gmqtt {version('gmqtt')}: {name} {what}. plotfeed uses it as: {PRIVATE[name]}. "
        "Look at feeds/transport/mqtt/gmqtt_client.py, and at the bound on gmqtt in pyproject.toml."
    )


def test_gmqtt_is_the_one_whose_private_parts_are_known() -> None:
    assert version("gmqtt").startswith("0.8."), "gmqtt is another one: see what PRIVATE has become"


@pytest.mark.parametrize("name", PRIVATE)
@pytest.mark.asyncio
async def test_every_private_part_that_is_used_is_there(name: str) -> None:
    async with used(ScriptedBroker()) as it:
        owner, _, path = name.partition(".")
        owners = {
            "Client": it.client._client,
            "MqttPackageHandler": it.client._client._package_handler,
            "MQTTConnection": it.connection,
            "MQTTConnectError": MQTTConnectError(4),
        }
        try:
            attrgetter(path)(owners[owner])
        except AttributeError:
            pytest.fail(told(name, "is gone"))


@pytest.mark.asyncio
async def test_what_is_written_packed_arrives_as_it_is() -> None:
    broker, deliveries = ScriptedBroker(), Deliveries()
    async with used(broker) as it:
        packets = [publish_packet(deliveries.make(qos=0).message, 5) for _ in range(3)]
        it.client.write(b"".join(packets))
        await until(lambda: broker.received == 3)
    payloads = [delivery.message.payload for delivery in deliveries.made]
    assert broker.heard == [payloads], told("MQTTConnection.send_package", "does not write octets")


@pytest.mark.asyncio
async def test_an_answer_comes_to_us_whether_it_is_a_refusal_or_not() -> None:
    broker, deliveries = ScriptedBroker(), Deliveries()
    async with used(broker) as it:
        for number in (1000, 1001, 1002):
            message = deliveries.make(qos=1).message
            it.client.write(publish_packet(message, 5, number=number))
        await until(lambda: len(broker.unacknowledged) == 3)
        broker.acknowledge(2)
        broker.acknowledge(1, b"\x97")
        await until(lambda: len(it.answers) == 3)
    expected = [b"\x03\xe8", b"\x03\xe9", b"\x03\xea\x97"]
    cache = "MqttPackageHandler._handler_cache"
    assert it.answers == expected, told(cache, "does not lead a PUBACK to us")


@pytest.mark.asyncio
async def test_there_are_ids_for_more_than_the_broker_takes_at_once() -> None:
    """Receive Maximum is of publications; gmqtt counts subscriptions too."""
    async with used(ScriptedBroker(properties=b"\x21\x00\x02")) as it:
        try:
            for number in range(10):
                it.client.subscribe(f"topic/{number}", as_published=True)
        except Exception as error:  # noqa: BLE001 - whatever it is by then
            name = "MqttPackageHandler.id_generator._max"
            pytest.fail(told(name, f"does not give room for subscriptions: {error!r}"))


@pytest.mark.asyncio
async def test_the_protocol_is_told_of_a_buffer_that_is_not_taken() -> None:
    said: list[str] = []
    async with used(ScriptedBroker(reads=False)) as it:
        it.client.watch_buffer(lambda: said.append("pause"), lambda: said.append("resume"))
        it.client.write(bytes(16 << 20))
        assert it.client.transport.get_write_buffer_size() > 0, told(
            "MQTTConnection._transport", "is not the transport that is written to"
        )
        assert said == ["pause"], told("MQTTConnection._protocol", "is not told of a full buffer")


@pytest.mark.asyncio
async def test_what_ended_the_connection_is_known() -> None:
    broker = ScriptedBroker()
    async with used(broker) as it:
        assert it.client.what_broke() is None
        assert it.ended == []
        broker.hang_up()
        await until(lambda: bool(it.ended))
        closed = it.connection._protocol.closed
        assert closed.done(), told("MQTTConnection._protocol.closed", "is not set by the end")
        assert isinstance(it.client.what_broke(), ConnectionError | None)


@pytest.mark.asyncio
async def test_a_sign_of_life_keeps_a_slow_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gmqtt_client, "KEEP_ALIVE_S", 1)
    name = "MQTTConnection._last_data_in"
    async with used(ScriptedBroker(reads=False)) as it:  # which answers no ping
        begin_s = time.monotonic()
        while time.monotonic() < begin_s + 3:
            it.client.note_life(time.monotonic())
            await asyncio.sleep(0.1)
        assert it.ended == [], told(name, "does not count as a sign of life")
        await until(lambda: bool(it.ended))
    assert time.monotonic() > begin_s + 4, told(name, "is not what a dead connection is told by")


@pytest.mark.asyncio
async def test_a_connection_that_is_cut_keeps_no_timer() -> None:
    async with used(ScriptedBroker()) as it:
        it.client.abort()
        timer = it.connection._keep_connection_callback
        assert timer.cancelled(), told("MQTTConnection._keep_connection_callback", "still runs")


@pytest.mark.parametrize(
    ("code", "words"), [(5, "not authorised"), (0x87, "not authorized"), (0x9D, "server moved")]
)
def test_a_refusal_has_its_code_and_words(code: int, words: str) -> None:
    code_of = refusal_code(MQTTConnectError(code))
    assert code_of == code, told("MQTTConnectError._code", "is not CONNACK's reason code")
    assert reason_name(code) == words, told("MQTTConnectError.__messages__", "has other words")
    assert refusal_code(OSError()) is None

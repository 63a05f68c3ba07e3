"""What a link does with a broker that is slow, small, strict, or gone."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from certificates import Certificates
from mqtt_client import PATIENCE_S
from scripted_broker import ScriptedBroker, serving

from plotfeed.feeds.broker_address import BrokerAddress
from plotfeed.feeds.in_flight import MAX_UNACKNOWLEDGED, MAX_WAITING
from plotfeed.feeds.message import Message
from plotfeed.feeds.mqtt import MqttLink
from plotfeed.feeds.mqtt_access import Access
from plotfeed.feeds.mqtt_connection import MAX_UNSENT_OCTETS
from plotfeed.feeds.mqtt_failure import MqttError


def message(octets: int = 10, qos: int = 0) -> Message:
    return Message(topic="t", payload=bytes(octets), content_type="x", due_utc_ns=0, qos=qos)


@asynccontextmanager
async def linked(
    broker: ScriptedBroker, *subscribe: str, tls: Certificates | None = None
) -> AsyncIterator[MqttLink]:
    context, address = None, "mqtt"
    access = Access()
    if tls is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tls.broker.certificate, tls.broker.key)
        address, access = "mqtts", Access(ca_file=tls.ca)
    async with serving(broker, context):
        url = f"{address}://127.0.0.1:{broker.port}"
        link = MqttLink(
            BrokerAddress.parse(url, versions=(5,), access=access), "test", subscribe=subscribe
        )
        running = asyncio.create_task(link.run())
        try:
            await link.wait_until_up(PATIENCE_S)
            yield link
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


async def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        await asyncio.sleep(0.005)


@pytest.mark.parametrize("window", [1, 2, 5, 20])
def test_no_more_is_on_its_way_than_the_broker_takes_and_the_rest_waits(window: int) -> None:
    async def check() -> None:
        broker = ScriptedBroker(properties=b"\x21" + window.to_bytes(2, "big"))
        async with linked(broker) as link:
            assert all(link.publish(message(qos=1)) for _ in range(50))
            await until(lambda: broker.received > 0)
            await asyncio.sleep(0.05)
            while broker.received < 50:
                assert 1 <= len(broker.unacknowledged) <= window
                sent = broker.received
                broker.acknowledge(1)
                await until(lambda sent=sent: broker.received > sent)  # type: ignore[misc]
            draining = asyncio.create_task(link.drain(PATIENCE_S))
            await asyncio.sleep(0.05)
            assert not draining.done()
            broker.acknowledge(len(broker.unacknowledged))
            await draining

    asyncio.run(check())


def test_what_waits_is_bounded() -> None:
    async def check() -> None:
        broker = ScriptedBroker()
        async with linked(broker) as link:
            taken = sum(link.publish(message(qos=1)) for _ in range(20_000))
            assert taken == MAX_UNACKNOWLEDGED + MAX_WAITING
            assert link.publish(message(qos=0))

    asyncio.run(check())


@pytest.mark.parametrize("secured", [False, True])
def test_a_broker_that_has_stalled_is_given_no_more(secured: bool, tmp_path: Path) -> None:
    async def check() -> None:
        broker = ScriptedBroker(reads=False)
        tls = Certificates(tmp_path) if secured else None
        async with linked(broker, tls=tls) as link:
            taken = 0
            while link.publish(message(1 << 20)):
                taken += 1
                await asyncio.sleep(0)
                assert taken < 100
            # Besides what may wait, sockets at both ends and TLS hold some.
            assert MAX_UNSENT_OCTETS >> 20 <= taken <= (MAX_UNSENT_OCTETS >> 20) + 20
            assert not link.publish(message(qos=1))
            await link.drain(0.05)

    asyncio.run(check())


def test_a_message_larger_than_the_broker_takes_is_not_sent() -> None:
    async def check() -> None:
        broker = ScriptedBroker(properties=b"\x27" + (5000).to_bytes(4, "big"))
        async with linked(broker) as link:
            assert not link.publish(message(6000))
            assert link.publish(message(3000))
            await until(lambda: broker.received == 1)
            assert link.is_up

    asyncio.run(check())


def test_a_lost_connection_says_why_and_what_may_be_lost(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def check() -> None:
        broker = ScriptedBroker()
        async with linked(broker) as link:
            for _ in range(3):
                link.publish(message(qos=1))
            await until(lambda: broker.received == 3)
            broker.send(0xE0, b"\x97\x00")  # quota exceeded
            await until(lambda: link.connections == 2)
            assert link.publish(message(qos=1))
            await until(lambda: broker.received == 4)

    asyncio.run(check())
    (line,) = [r.getMessage() for r in caplog.records if "lost the connection" in r.getMessage()]
    assert line.endswith(" (quota exceeded); 3 messages unacknowledged")


def test_a_subscription_that_is_not_granted_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async def check() -> None:
        async with linked(ScriptedBroker(granted=0x87), "here/#"):
            await until(lambda: any("does not grant" in r.getMessage() for r in caplog.records))

    asyncio.run(check())


@pytest.mark.parametrize(
    ("code", "words"),
    [(0x8A, "banned"), (0x9D, "server moved"), (0x84, "unsupported protocol"), (0x99, "payload")],
)
def test_a_refusal_is_told_in_words(code: int, words: str) -> None:
    async def check() -> str:
        with pytest.raises(MqttError) as caught:
            async with linked(ScriptedBroker(code=code)):
                pass
        return str(caught.value)

    assert f"it refuses: {words}" in asyncio.run(check())

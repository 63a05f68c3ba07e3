"""What a link does with a broker that is slow, small, or strict."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from support.certificates import Certificates
from support.deliveries import Deliveries
from support.scripted_broker import ScriptedBroker, end_connection, linked, numbers
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.messages.transports import publish
from plotfeed.feeds.transport.mqtt import client, send_queue
from plotfeed.feeds.transport.mqtt.connection import MAX_UNACKNOWLEDGED, MqttError
from plotfeed.feeds.transport.mqtt.send_queue import MAX_UNSENT_MESSAGES, MAX_UNSENT_OCTETS

pytestmark = pytest.mark.usefixtures("hurried")


@pytest.mark.parametrize("window", [1, 2, 5, 20])
@pytest.mark.asyncio
async def test_no_more_is_on_its_way_than_the_broker_takes_and_the_rest_waits(window: int) -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(properties=b"\x21" + window.to_bytes(2, "big"))
    async with linked(broker, "a", "b", "c") as link:
        deliveries.publish(link, 50)
        while broker.received < 50:
            await until(lambda: len(broker.unacknowledged) == window)
            assert (link.unacknowledged, link.waiting) == (window, 50 - broker.received)
            sent = broker.received
            broker.acknowledge(1)
            await until(lambda sent=sent: broker.received > sent)  # type: ignore[misc]
        assert deliveries.delivered == list(range(50 - window))
        draining = asyncio.create_task(link.drain(PATIENCE_S))
        await asyncio.sleep(0.05)
        assert not draining.done()
        broker.acknowledge(len(broker.unacknowledged))
        await draining
        assert deliveries.delivered == list(range(50))
        assert numbers(broker.heard[0]) == list(range(50))


@pytest.mark.asyncio
async def test_what_waits_is_bounded_and_leaves_qos_0_alone() -> None:
    deliveries = Deliveries()
    async with linked(ScriptedBroker()) as link:
        deliveries.publish(link, 20_000)
        assert (link.unacknowledged, link.waiting) == (MAX_UNACKNOWLEDGED, 10_000)
        assert (
            link.counts.dropped == len(deliveries.given_up) == 20_000 - 10_000 - MAX_UNACKNOWLEDGED
        )
        late = deliveries.make(qos=0)
        publish([link], [late])
        assert late.was_delivered
        assert late.sent_utc_ns is not None
    assert deliveries.unsettled == []


@pytest.mark.parametrize("secured", [False, True])
@pytest.mark.asyncio
async def test_a_broker_that_has_stalled_is_given_no_more(secured: bool, tmp_path: Path) -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(reads=False)
    tls = Certificates(tmp_path) if secured else None
    async with linked(broker, tls=tls) as link:
        while not deliveries.given_up:
            deliveries.publish(link, 1, qos=0, octets=1 << 20)
            await asyncio.sleep(0)
            assert len(deliveries.made) < 100
        # Besides what may wait, sockets at both ends and TLS hold some.
        taken = len(deliveries.made) - 1
        assert MAX_UNSENT_OCTETS >> 20 <= taken <= (MAX_UNSENT_OCTETS >> 20) + 20
        assert 6 <= len(deliveries.unsettled) <= (MAX_UNSENT_OCTETS >> 20) + 1
        deliveries.publish(link, 1, qos=1)
        assert link.waiting == 1
        await link.drain(0.05)
    # What the socket had taken is as good as delivered; the rest is known to be lost.
    assert len(deliveries.delivered) + len(deliveries.given_up) == len(deliveries.made)
    assert link.counts.dropped == len(deliveries.given_up)


@pytest.mark.asyncio
async def test_small_messages_that_a_socket_does_not_take_are_bounded_by_their_number() -> None:
    deliveries = Deliveries()
    async with linked(ScriptedBroker(reads=False)) as link:
        while not deliveries.unsettled:
            deliveries.publish(link, 1, qos=0, octets=1 << 18)
        deliveries.publish(link, 2 * MAX_UNSENT_MESSAGES, qos=0)
        assert len(deliveries.unsettled) <= MAX_UNSENT_MESSAGES
        assert link.counts.dropped == len(deliveries.given_up) >= MAX_UNSENT_MESSAGES


@pytest.mark.parametrize("secured", [False, True])
@pytest.mark.asyncio
async def test_what_had_to_wait_for_a_slow_socket_arrives_in_order(
    secured: bool, tmp_path: Path
) -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(acknowledges=True)
    tls = Certificates(tmp_path) if secured else None
    async with linked(broker, tls=tls, policy="drop-newest", messages=1000) as link:
        for qos in (0, 1, 0):
            deliveries.publish(link, 100, qos=qos, octets=1 << 18)
            assert link.waiting > 0
            await link.drain(PATIENCE_S)
        await until(lambda: broker.received == 300)
    assert numbers(broker.heard[0]) == deliveries.delivered == list(range(300))
    assert (link.counts.dropped, link.counts.repeated) == (0, 0)


@pytest.mark.asyncio
async def test_a_socket_that_takes_nothing_for_long_is_given_up(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(client, "WATCH_EVERY_S", 0.01)
    monkeypatch.setattr(send_queue, "GIVE_UP_S", 0.1)

    deliveries = Deliveries()
    broker = ScriptedBroker(reads=False)
    async with linked(broker, policy="wait") as link:
        broker.reads = broker.acknowledges = True  # on the next one
        deliveries.publish(link, 5, qos=0, octets=1 << 20)
        assert (in_buffer := len(deliveries.unsettled)) > 0
        deliveries.publish(link, 20, qos=1, octets=1 << 20)
        deliveries.publish(link, 20, qos=0, octets=1 << 20)
        await until(lambda: "it takes nothing any more" in caplog.text)
        monkeypatch.setattr(send_queue, "GIVE_UP_S", PATIENCE_S)
        await until(lambda: broker.received == 40)
        await link.drain(PATIENCE_S)
        assert link.connections == 2
    # Of QoS 0, what was in the buffer; the others had not left, or are sent again.
    assert deliveries.given_up == [*range(5 - in_buffer, 5)]
    assert deliveries.delivered == [*range(5 - in_buffer), *range(5, 45)]
    assert link.counts.dropped == in_buffer
    assert link.counts.repeated > 0
    assert "it takes nothing any more" in caplog.text


@pytest.mark.asyncio
async def test_a_message_larger_than_the_broker_takes_is_not_sent() -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(properties=b"\x27" + (5000).to_bytes(4, "big"), acknowledges=True)
    async with linked(broker) as link:
        for qos in (0, 1):
            deliveries.publish(link, 1, qos=qos, octets=6000)
            deliveries.publish(link, 1, qos=qos, octets=3000)
        await until(lambda: len(deliveries.delivered) == 2)
        assert (deliveries.given_up, link.counts.dropped) == ([0, 2], 2)
        assert numbers(broker.heard[0]) == [1, 3]
        await end_connection(broker, link)
        for octets in (6000, 3000):
            deliveries.publish(link, 1, octets=octets)
        await until(lambda: len(broker.heard) == 2 and numbers(broker.heard[1]) == [5])
        assert deliveries.given_up == [0, 2, 4]


@pytest.mark.asyncio
async def test_what_a_broker_answers_with_a_refusal_is_not_delivered(
    caplog: pytest.LogCaptureFixture,
) -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker()
    async with linked(broker) as link:
        deliveries.publish(link, 5)
        await until(lambda: broker.received == 5)
        broker.acknowledge(1, b"\x00")
        broker.acknowledge(1, b"\x97\x00")  # quota exceeded, without properties
        broker.acknowledge(1, b"\x10\x00")  # nobody has subscribed
        broker.acknowledge(1, b"\x87")  # not authorised
        broker.acknowledge(1)
        await link.drain(PATIENCE_S)
        assert (deliveries.delivered, deliveries.given_up) == ([0, 2, 4], [1, 3])
        assert (link.counts.refused, link.counts.dropped, link.connections) == (2, 0, 1)
    (line,) = [r.getMessage() for r in caplog.records]
    assert line.endswith("refuses what is published on t: quota exceeded")


@pytest.mark.asyncio
async def test_at_the_end_everything_is_settled_and_nothing_more_is_taken() -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker()
    async with linked(broker, policy="wait", messages=5) as link:
        deliveries.publish(link, MAX_UNACKNOWLEDGED + 5)
        await until(lambda: broker.received == MAX_UNACKNOWLEDGED)
        broker.acknowledge(2)
        await until(lambda: len(deliveries.delivered) == 2)
        deliveries.publish(link, 2)
        waiting = asyncio.create_task(link.room())
        await asyncio.sleep(0)
        assert not waiting.done()
    await waiting
    deliveries.publish(link, 1)
    assert deliveries.delivered == [0, 1]
    assert len(deliveries.given_up) == MAX_UNACKNOWLEDGED + 6
    assert (link.waiting, link.unacknowledged) == (0, 0)


@pytest.mark.asyncio
async def test_a_subscription_that_is_not_granted_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async with linked(ScriptedBroker(granted=0x87), "here/#"):
        await until(lambda: any("does not grant" in r.getMessage() for r in caplog.records))


@pytest.mark.parametrize(
    ("code", "words"),
    [(0x8A, "banned"), (0x9D, "server moved"), (0x84, "unsupported protocol"), (0x99, "payload")],
)
@pytest.mark.asyncio
async def test_a_refusal_is_told_in_words(code: int, words: str) -> None:
    with pytest.raises(MqttError) as caught:
        async with linked(ScriptedBroker(code=code)):
            pass
    assert f"it refuses: {words}" in str(caught.value)

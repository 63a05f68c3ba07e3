"""What a link does with a broker that is slow, small, strict, or gone."""

from __future__ import annotations

import asyncio
import gc
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path

import gmqtt
import pytest
from support.certificates import Certificates
from support.deliveries import Deliveries, number_of
from support.scripted_broker import ScriptedBroker, serving
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport.mqtt import client, send_queue
from plotfeed.feeds.transport.mqtt.address import BrokerAccess, BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.connection import MqttError
from plotfeed.feeds.transport.mqtt.gmqtt_client import MAX_UNACKNOWLEDGED
from plotfeed.feeds.transport.mqtt.send_queue import MAX_UNSENT_MESSAGES, MAX_UNSENT_OCTETS

BUSY = 0x89
"""A refusal that is not for ever."""


@asynccontextmanager
async def linked(
    broker: ScriptedBroker, *subscribe: str, tls: Certificates | None = None, **queue: object
) -> AsyncIterator[MqttTransport]:
    context, address = None, "mqtt"
    access = BrokerAccess()
    if tls is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tls.broker.certificate, tls.broker.key)
        address, access = "mqtts", BrokerAccess(ca_file=tls.ca)
    async with serving(broker, context):
        url = f"{address}://127.0.0.1:{broker.port}"
        link = MqttTransport(
            BrokerAddress.parse(url, versions=(5,), access=access),
            "test",
            subscribe=subscribe,
            queue=MqttQueueKeys.model_validate(queue),
        )
        running = asyncio.create_task(link.run())
        try:
            await link.wait_until_up(PATIENCE_S)
            yield link
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


async def end_connection(broker: ScriptedBroker, link: MqttTransport, *, code: int = 0) -> None:
    """The next ones are answered with that code."""
    broker.code = code
    broker.hang_up()
    await until(lambda: not link.is_up)


def numbers(payloads: list[bytes]) -> list[int]:
    return [number_of(payload) for payload in payloads]


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "BACKOFF_S", (0.01,))


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
        link.publish(late)
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
    assert line.endswith("refuses what is published: quota exceeded")


@pytest.mark.asyncio
async def test_a_lost_connection_says_why_and_what_is_sent_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker()
    async with linked(broker) as link:
        deliveries.publish(link, 3)
        await until(lambda: broker.received == 3)
        broker.send(0xE0, b"\x97\x00")  # quota exceeded
        await until(lambda: link.connections == 2)
        deliveries.publish(link, 1)
        await until(lambda: broker.received == 7)
        assert [numbers(heard) for heard in broker.heard] == [[0, 1, 2], [0, 1, 2, 3]]
        assert link.counts.repeated == 3
    (line,) = [r.getMessage() for r in caplog.records if "lost the connection" in r.getMessage()]
    assert line.endswith(" (quota exceeded); 3 unacknowledged messages will be sent again")


@pytest.mark.parametrize("losses", [1, 3])
@pytest.mark.asyncio
async def test_messages_of_qos_1_arrive_in_order_however_often_the_connection_is_lost(
    losses: int,
) -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(properties=b"\x21\x00\x0a")
    async with linked(broker) as link:
        deliveries.publish(link, 100)
        for _ in range(losses):
            await until(lambda: len(broker.unacknowledged) == 10)
            broker.acknowledge(4)
            await until(lambda: len(broker.unacknowledged) == 10)
            await end_connection(broker, link, code=BUSY)
            deliveries.publish(link, 20)
            broker.code = 0
            await until(lambda: link.is_up)
        await until(lambda: len(broker.unacknowledged) == 10)
        broker.acknowledges = True
        broker.acknowledge(10)
        await link.drain(PATIENCE_S)
    every = list(range(100 + 20 * losses))
    assert deliveries.delivered == every
    assert (link.counts.repeated, link.counts.dropped) == (10 * losses, 0)
    heard = [numbers(payloads) for payloads in broker.heard if payloads]
    assert len(heard) == losses + 1
    for before, after in pairwise(heard):
        assert after[0] == before[-10]  # ten were unacknowledged
    assert heard[-1][-1] == every[-1]
    assert all(one == list(range(one[0], one[-1] + 1)) for one in heard)


@pytest.mark.parametrize(
    ("policy", "arrive", "given_up"),
    [
        ("drop-oldest", [*range(90, 100)], [*range(90)]),
        ("drop-newest", [*range(10)], [*range(10, 100)]),
        ("wait", [*range(100)], []),
    ],
)
@pytest.mark.parametrize("qos", [0, 1])
@pytest.mark.asyncio
async def test_while_the_broker_is_gone_the_policy_says_what_waits(
    policy: str, arrive: list[int], given_up: list[int], qos: int
) -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(acknowledges=True)
    async with linked(broker, policy=policy, messages=10) as link:
        await end_connection(broker, link, code=BUSY)
        deliveries.publish(link, 100, qos=qos)
        assert link.waiting == len(arrive)
        assert link.counts.dropped == len(given_up)
        assert deliveries.given_up == given_up
        assert link.is_full == (policy == "wait")
        await until(lambda: len(broker.heard) > 3)
        broker.code = 0
        await until(lambda: broker.received == len(arrive))
        await link.drain(PATIENCE_S)
        assert numbers(broker.heard[-1]) == deliveries.delivered == arrive
        assert not link.is_full


@pytest.mark.asyncio
async def test_without_settings_plots_of_qos_0_do_not_wait_for_a_broker() -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(acknowledges=True)
    async with linked(broker) as link:
        await end_connection(broker, link, code=BUSY)
        for _ in range(10):
            deliveries.publish(link, 1, qos=0)
            deliveries.publish(link, 1, qos=1)
        broker.code = 0
        await until(lambda: broker.received == 10)
        await link.drain(PATIENCE_S)
        assert deliveries.given_up == list(range(0, 20, 2))
        assert numbers(broker.heard[-1]) == deliveries.delivered == list(range(1, 20, 2))


@pytest.mark.asyncio
async def test_what_waits_too_long_for_a_broker_is_dropped() -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(acknowledges=True)
    async with linked(broker, policy="wait", max_age_s=0.05) as link:
        await end_connection(broker, link, code=BUSY)
        deliveries.publish(link, 5)
        await asyncio.wait_for(link.room(), PATIENCE_S)
        await until(lambda: deliveries.given_up == list(range(5)))
        assert (link.waiting, link.counts.dropped) == (0, 5)


@pytest.mark.parametrize("messages", [0, 1, 10])
@pytest.mark.asyncio
async def test_whoever_waits_for_room_loses_nothing(messages: int) -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(properties=b"\x21\x00\x05", acknowledges=True)
    async with linked(broker, policy="wait", messages=messages) as link:

        async def publish_all() -> None:
            for i in range(300):
                await link.room()
                deliveries.publish(link, 1, qos=i % 3 > 0)
                # What was on its way when a connection ended waits again, too: five at most.
                assert link.waiting <= max(messages, 1) + 1 + 5

        publishing = asyncio.create_task(publish_all())
        for end in (50, 120, 200):
            await until(lambda end=end: broker.received >= end)  # type: ignore[misc]
            await end_connection(broker, link, code=BUSY)
            published = len(deliveries.made)
            await asyncio.sleep(0.02)
            assert len(deliveries.made) <= published + messages + 2
            assert not publishing.done()
            broker.code = 0
        await publishing
        await link.drain(PATIENCE_S)
    sure = [p.number for p in deliveries.made if p.message.qos]
    assert {*sure} <= {*deliveries.delivered}
    assert {*sure} <= {number_of(p) for heard in broker.heard for p in heard}
    assert link.counts.dropped == len(deliveries.given_up)


@pytest.mark.asyncio
async def test_of_a_status_only_the_last_arrives_late() -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(acknowledges=True)
    async with linked(broker) as link:
        await end_connection(broker, link, code=BUSY)
        for topic in ("a/status", "b/status", "a/status", "a/status"):
            deliveries.publish(link, 1, topic=topic, retain=True)
        broker.code = 0
        await until(lambda: broker.received == 2)
        await link.drain(PATIENCE_S)
        assert deliveries.delivered == numbers(broker.heard[-1]) == [1, 3]
        assert deliveries.given_up == [0, 2]
        assert (link.counts.superseded, link.counts.dropped) == (2, 0)


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
async def test_thousands_that_waited_leave_in_slices_with_others_in_between() -> None:
    deliveries = Deliveries()
    broker = ScriptedBroker(acknowledges=True)
    async with linked(broker, policy="wait", messages=5000) as link:
        await end_connection(broker, link, code=BUSY)
        deliveries.publish(link, 4000, qos=0)
        broker.code = 0
        waiting = [link.waiting]
        while waiting[-1]:
            await asyncio.sleep(0)
            waiting.append(link.waiting)
        assert max(a - b for a, b in pairwise(waiting)) <= 100
        await until(lambda: broker.received == 4000)
        assert numbers(broker.heard[-1]) == list(range(4000))


@pytest.mark.asyncio
async def test_hundreds_of_connections_leave_nothing_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(client, "BACKOFF_S", (0.0,))

    def left() -> tuple[int, int]:
        gc.collect()
        clients = sum(isinstance(x, gmqtt.Client) for x in gc.get_objects())
        return clients, len(asyncio.all_tasks())

    deliveries = Deliveries()
    broker = ScriptedBroker()
    ends = 0
    async with linked(broker) as link:
        before = None
        deliveries.publish(link, 3)
        while link.connections < 300:
            await until(lambda: link.is_up and len(broker.unacknowledged) > 0)
            before = before or left()
            broker.hang_up() if ends % 2 else broker.send(0xE0, b"\x8b\x00")
            ends += 1
            connections = link.connections
            await until(lambda c=connections: not link.is_up or link.connections > c)  # type: ignore[misc]
        await until(lambda: link.is_up and len(broker.unacknowledged) == 3)
        assert before is not None
        clients, tasks = left()
        assert clients <= before[0] + 1
        assert tasks <= before[1] + 3
        assert (link.unacknowledged, link.waiting, deliveries.given_up) == (3, 0, [])
        timers = asyncio.get_running_loop()._scheduled  # type: ignore[attr-defined]
        assert len(timers) < 150  # asyncio keeps some that are cancelled


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

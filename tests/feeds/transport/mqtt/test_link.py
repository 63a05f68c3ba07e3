"""What a link does with a broker that is gone, slow, small or strict, as a test scripts it."""

from __future__ import annotations

import asyncio
import gc
from itertools import count, pairwise, takewhile
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port
from support.certificates import Certificates
from support.deliveries import number_of
from support.own_time import in_own_time
from support.scripted_broker import BUSY, ScriptedBroker, end_connection, linked, numbers, scripted
from support.servers import serving
from support.waiting import PATIENCE_S, kept_up, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import publish
from plotfeed.feeds.transport.mqtt import connection
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import WATCH_EVERY_S, MqttTransport
from plotfeed.feeds.transport.mqtt.connection import (
    KEEP_ALIVE_S,
    MAX_UNACKNOWLEDGED,
    MqttConnection,
    MqttError,
)
from plotfeed.feeds.transport.mqtt.packets import acknowledgements, publish_packet
from plotfeed.feeds.transport.mqtt.send_queue import (
    GIVE_UP_S,
    MAX_UNSENT_MESSAGES,
    MAX_UNSENT_OCTETS,
)


@in_own_time
async def test_a_lost_connection_says_why_and_what_is_sent_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with scripted() as (link, broker, deliveries):
        deliveries.publish(link, 3)
        await until(lambda: broker.received == 3)
        broker.send(0xE0, b"\x97\x00")  # quota exceeded
        await until(lambda: link.connections == 2)
        deliveries.publish(link, 1)
        await until(lambda: broker.received == 7)
        assert [numbers(heard) for heard in broker.heard] == [[0, 1, 2], [0, 1, 2, 3]]
    (line,) = [r.getMessage() for r in caplog.records if "lost the connection" in r.getMessage()]
    assert line.endswith(" (quota exceeded); 3 unacknowledged messages will be sent again")


@in_own_time
async def test_messages_of_qos_1_arrive_in_order_however_often_the_connection_is_lost() -> None:
    losses = 3
    async with scripted(properties=b"\x21\x00\x0a") as (link, broker, deliveries):
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
    heard = [numbers(payloads) for payloads in broker.heard if payloads]
    assert len(heard) == losses + 1
    for before, after in pairwise(heard):
        assert after[0] == before[-10]  # ten were unacknowledged
    assert heard[-1][-1] == every[-1]
    assert all(one == list(range(one[0], one[-1] + 1)) for one in heard)


POLICIES = {
    "drop-oldest": ([*range(80, 100)], [*range(80)]),
    "drop-newest": ([*range(20)], [*range(20, 100)]),
    "wait": ([*range(100)], []),
}


@pytest.mark.parametrize("policy", POLICIES)
@in_own_time
async def test_while_the_broker_is_gone_the_policy_says_what_waits(policy: str) -> None:
    arrive, given_up = POLICIES[policy]
    keys: dict[str, Any] = {"policy": policy, "messages": 10, "acknowledges": True}
    async with scripted(**keys) as (link, broker, deliveries):
        await end_connection(broker, link, code=BUSY)
        for number in range(100):
            deliveries.publish(link, 1, qos=number % 2)  # each QoS has a queue
        assert (link.waiting, link.is_full) == (len(arrive), policy == "wait")
        assert deliveries.given_up == given_up
        await until(lambda: len(broker.heard) > 3)
        broker.code = 0
        await until(lambda: broker.received == len(arrive))
        await link.drain(PATIENCE_S)
        assert sorted(numbers(broker.heard[-1])) == deliveries.delivered == arrive
        assert not link.is_full


@in_own_time
async def test_without_settings_plots_of_qos_0_do_not_wait_for_a_broker() -> None:
    async with scripted(acknowledges=True) as (link, broker, deliveries):
        await end_connection(broker, link, code=BUSY)
        for _ in range(10):
            deliveries.publish(link, 1, qos=0)
            deliveries.publish(link, 1, qos=1)
        broker.code = 0
        await until(lambda: broker.received == 10)
        await link.drain(PATIENCE_S)
        assert deliveries.given_up == list(range(0, 20, 2))
        assert numbers(broker.heard[-1]) == deliveries.delivered == list(range(1, 20, 2))


@in_own_time
async def test_what_waits_too_long_for_a_broker_is_dropped() -> None:
    async with scripted(policy="wait", messages=5, max_age_s=7.0) as (link, broker, deliveries):
        await end_connection(broker, link, code=BUSY)
        deliveries.publish(link, 5)
        await asyncio.sleep(6.0)
        assert (link.waiting, link.is_full) == (5, True)
        await asyncio.wait_for(link.room(), PATIENCE_S)
        assert deliveries.given_up == list(range(5))
        assert link.waiting == 0


@pytest.mark.parametrize("messages", [0, 10])
@in_own_time
async def test_whoever_waits_for_room_loses_nothing(messages: int) -> None:
    async with scripted(
        policy="wait", messages=messages, properties=b"\x21\x00\x05", acknowledges=True
    ) as (link, broker, deliveries):
        is_over = asyncio.Event()

        async def publish_all() -> None:
            for i in takewhile(lambda i: i < 300 or not is_over.is_set(), count()):
                await link.room()
                deliveries.publish(link, 1, qos=i % 3 > 0)
                # What was on its way when a connection ended waits again, too: five at most.
                assert link.waiting <= max(messages, 1) + 1 + 5

        publishing = asyncio.create_task(publish_all())
        for end in (50, 120, 200):
            await until(lambda end=end: broker.received >= end)  # type: ignore[misc]
            await end_connection(broker, link, code=BUSY)
            published = len(deliveries.made)
            await asyncio.sleep(0.2)
            assert len(deliveries.made) <= published + messages + 2
            assert not publishing.done()
            broker.code = 0
        is_over.set()
        await publishing
        await link.drain(PATIENCE_S)
    sure = [p.number for p in deliveries.made if p.qos]
    assert {*sure} <= {*deliveries.delivered}
    assert {*sure} <= {number_of(p) for heard in broker.heard for p in heard}


@in_own_time
async def test_thousands_that_waited_leave_in_slices_with_others_in_between() -> None:
    keys: dict[str, Any] = {"policy": "wait", "messages": 5000, "acknowledges": True}
    async with scripted(**keys) as (link, broker, deliveries):
        await end_connection(broker, link, code=BUSY)
        deliveries.publish(link, 2000, qos=0)
        broker.code = 0
        waiting = [link.waiting]
        while waiting[-1]:
            await asyncio.sleep(0)
            waiting.append(link.waiting)
        assert max(a - b for a, b in pairwise(waiting)) <= 100
        await until(lambda: broker.received == 2000)
        assert numbers(broker.heard[-1]) == list(range(2000))


@in_own_time
async def test_many_connections_leave_nothing_behind() -> None:
    def left() -> tuple[int, int]:
        gc.collect()
        clients = sum(isinstance(x, MqttConnection) for x in gc.get_objects())
        return clients, len(asyncio.all_tasks())

    async with scripted() as (link, broker, deliveries):
        ends, before = 0, None
        deliveries.publish(link, 3)
        while link.connections < 30:
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
        assert (link.waiting, deliveries.given_up) == (0, [])
        timers = asyncio.get_running_loop()._scheduled  # type: ignore[attr-defined]
        assert len(timers) < 50  # asyncio keeps some that are cancelled


@pytest.mark.parametrize(("window", "octets"), [(1, 10), (5, 10), (5, 10_001)])
@in_own_time
async def test_no_more_is_on_its_way_than_may_be_and_the_rest_waits(
    window: int, octets: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many messages as the broker takes, as many octets as we do."""
    monkeypatch.setattr(connection, "MAX_UNACKNOWLEDGED_OCTETS", 50_000)
    properties = b"\x21" + window.to_bytes(2, "big") if octets == 10 else b""
    async with scripted("a", "b", "c", properties=properties) as (link, broker, deliveries):
        deliveries.publish(link, 50, octets=octets)
        while broker.received < 50:
            await until(lambda: len(broker.unacknowledged) == window)
            assert link.waiting == 50 - broker.received
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


@in_own_time
async def test_what_waits_is_bounded_and_leaves_qos_0_alone() -> None:
    async with scripted() as (link, _, deliveries):
        deliveries.publish(link, 20_000)
        assert link.waiting == 10_000
        assert len(deliveries.given_up) == 20_000 - 10_000 - MAX_UNACKNOWLEDGED
        late = deliveries.make(qos=0)
        publish([link], [late])
        assert late.was_delivered
        assert late.sent_utc_ns is not None
    assert deliveries.unsettled == []


@pytest.mark.parametrize("secured", [False, True])
@in_own_time
async def test_a_broker_that_has_stalled_is_given_no_more(secured: bool, tmp_path: Path) -> None:
    tls = Certificates(tmp_path) if secured else None
    async with scripted(tls=tls, reads=False) as (link, _, deliveries):
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


@pytest.mark.parametrize("secured", [False, True])
@in_own_time
async def test_what_had_to_wait_for_a_slow_socket_arrives_in_order(
    secured: bool, tmp_path: Path
) -> None:
    more: dict[str, Any] = {"acknowledges": True, "policy": "drop-newest", "messages": 1000}
    tls = Certificates(tmp_path) if secured else None
    async with scripted(tls=tls, **more) as (link, broker, deliveries):
        for qos in (0, 1, 0):
            deliveries.publish(link, 60, qos=qos, octets=1 << 18)
            assert link.waiting > 0
            await link.drain(PATIENCE_S)
        await until(lambda: broker.received == 180)
    assert numbers(broker.heard[0]) == deliveries.delivered == list(range(180))


@in_own_time
async def test_a_socket_that_takes_nothing_for_long_is_given_up(
    caplog: pytest.LogCaptureFixture,
) -> None:
    began_s = asyncio.get_running_loop().time()
    async with scripted(policy="wait", reads=False) as (link, broker, deliveries):
        broker.reads = broker.acknowledges = True  # on the next one
        deliveries.publish(link, 5, qos=0, octets=1 << 20)
        assert (in_buffer := len(deliveries.unsettled)) > 0
        deliveries.publish(link, 20, qos=1, octets=1 << 20)
        deliveries.publish(link, 20, qos=0, octets=1 << 20)
        await until(lambda: "it takes nothing any more" in caplog.text)
        took_s = asyncio.get_running_loop().time() - began_s
        assert GIVE_UP_S < took_s < GIVE_UP_S + WATCH_EVERY_S + 5.0
        await until(lambda: broker.received == 40)
        await link.drain(PATIENCE_S)
        assert link.connections == 2
    # Of QoS 0, what was in the buffer; the others had not left, or are sent again.
    assert deliveries.given_up == [*range(5 - in_buffer, 5)]
    assert deliveries.delivered == [*range(5 - in_buffer), *range(5, 45)]


@in_own_time
async def test_a_message_larger_than_the_broker_takes_is_not_sent() -> None:
    most = b"\x27" + (5000).to_bytes(4, "big")
    async with scripted(properties=most, acknowledges=True) as (link, broker, deliveries):
        for qos in (0, 1):
            deliveries.publish(link, 1, qos=qos, octets=6000)
            deliveries.publish(link, 1, qos=qos, octets=3000)
        await until(lambda: len(deliveries.delivered) == 2)
        assert deliveries.given_up == [0, 2]
        assert numbers(broker.heard[0]) == [1, 3]
        await end_connection(broker, link)
        for octets in (6000, 3000):
            deliveries.publish(link, 1, octets=octets)
        await until(lambda: len(broker.heard) == 2 and numbers(broker.heard[1]) == [5])
        assert deliveries.given_up == [0, 2, 4]


@in_own_time
async def test_what_a_broker_answers_with_a_refusal_is_not_delivered(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with scripted() as (link, broker, deliveries):
        deliveries.publish(link, 5)
        await until(lambda: broker.received == 5)
        broker.acknowledge(1, b"\x00")
        broker.acknowledge(1, b"\x97\x00")  # quota exceeded, without properties
        broker.acknowledge(1, b"\x10\x00")  # nobody has subscribed
        broker.acknowledge(1, b"\x87")  # not authorised
        broker.acknowledge(1)
        await link.drain(PATIENCE_S)
        assert (deliveries.delivered, deliveries.given_up) == ([0, 2, 4], [1, 3])
        assert link.connections == 1
    (line,) = [r.getMessage() for r in caplog.records]
    assert line.endswith("refuses what is published on t: quota exceeded")


@in_own_time
async def test_at_the_end_everything_is_settled_and_nothing_more_is_taken() -> None:
    async with scripted(policy="wait", messages=5) as (link, broker, deliveries):
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
    assert link.waiting == 0


@in_own_time
async def test_a_subscription_that_is_not_granted_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async with linked(ScriptedBroker(granted=0x87), "here/#"):
        await until(lambda: any("does not grant" in r.getMessage() for r in caplog.records))


@in_own_time
async def test_a_broker_that_may_be_waited_for_is_waited_for_and_that_is_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    broker = ScriptedBroker(port=free_port())
    link = MqttTransport(BrokerAddress("127.0.0.1", broker.port, (5,), waits=True), "test")
    async with kept_up(link.run()):
        coming = asyncio.create_task(link.wait_until_up(1.0))
        await asyncio.sleep(30.0)
        assert not coming.done()
        async with serving(broker.serve, broker.port) as broker.port:
            await coming
    assert [m for m in caplog.messages if "waits for" in m] == [
        f"waits for the MQTT broker mqtt://127.0.0.1:{broker.port} (Connect call failed "
        f"('127.0.0.1', {broker.port})); stop: Ctrl-C"
    ]


@in_own_time
async def test_a_refusal_is_told_in_words() -> None:
    with pytest.raises(MqttError, match="it refuses: banned"):
        async with linked(ScriptedBroker(code=0x8A)):
            pass


@in_own_time
async def test_messages_that_come_together_are_acknowledged_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broker, heard, written = ScriptedBroker(), list[bytes](), list[bytes]()
    async with serving(broker.serve, broker.port) as broker.port:
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


@in_own_time
async def test_a_broker_that_says_nothing_is_gone_unless_its_socket_moves() -> None:
    loop = asyncio.get_running_loop()
    broker = ScriptedBroker(reads=False)  # which answers no ping
    async with serving(broker.serve) as broker.port:
        link = MqttConnection(BrokerAddress("127.0.0.1", broker.port, (5,)), 5, "test")
        await link.open(PATIENCE_S)
        for _ in range(20):
            link._buffer.moved_s = loop.time()
            await asyncio.sleep(KEEP_ALIVE_S / 5)
        assert not link.lost.is_set()
        since_s = loop.time()
        await asyncio.wait_for(link.lost.wait(), PATIENCE_S)
        assert 1.5 * KEEP_ALIVE_S < loop.time() - since_s < 3 * KEEP_ALIVE_S
    assert link.good_bye == "it says nothing any more"


@pytest.mark.parametrize(
    ("kind", "body", "why"),
    [
        (0x20, b"\0\0\0", "a second CONNACK"),
        (0x50, b"\0\1", "a packet of kind 0x50 that no such client gets"),
        (0x30, b"\0\1t\x02\xff\0", "unknown property 0xff"),
    ],
)
@in_own_time
async def test_a_broker_that_breaks_the_rules_is_left_with_a_word_and_tried_again(
    caplog: pytest.LogCaptureFixture, kind: int, body: bytes, why: str
) -> None:
    async with scripted() as (link, broker, deliveries):
        deliveries.publish(link, 1)
        await until(lambda: broker.received == 1)
        broker.send(kind, body)
        await until(lambda: link.connections == 2)
        broker.acknowledges = True
        await until(lambda: broker.received == 2)
    (line,) = [r.getMessage() for r in caplog.records if "lost the connection" in r.getMessage()]
    assert f"(it does not keep to MQTT: {why})" in line


@pytest.mark.parametrize("octets", [50, 60_000])
@in_own_time
async def test_what_leaves_together_arrives_in_order_whether_the_socket_takes_it_or_not(
    octets: int,
) -> None:
    async with scripted() as (link, broker, deliveries):
        for _ in range(3):
            publish([link], [deliveries.make(qos=0, octets=octets) for _ in range(40)])
        await until(lambda: broker.received == 120)
    assert numbers(broker.heard[0]) == deliveries.delivered == list(range(120))


@in_own_time
async def test_what_a_stalled_broker_leaves_in_the_socket_is_undelivered_when_it_is_gone() -> None:
    """What had left before is sent, and nothing is told of twice."""
    async with scripted(reads=False) as (link, broker, deliveries):
        while not deliveries.given_up:  # the socket is full, and then its buffer
            publish([link], [deliveries.make(qos=0, octets=100_000) for _ in range(40)])
        before = len(deliveries.delivered)
        assert link._connection is not None
        held = link._connection._buffer.octets / 100_000
        assert held == pytest.approx(len(deliveries.unsettled), abs=1.0)
        assert len(deliveries.made) * 100_000 > MAX_UNSENT_OCTETS
        deliveries.publish(link, 2 * MAX_UNSENT_MESSAGES, qos=0)  # small ones have a bound, too
        assert len(deliveries.unsettled) <= MAX_UNSENT_MESSAGES
        await end_connection(broker, link, code=BUSY)
        await until(lambda: not deliveries.unsettled)
        assert link.waiting == 0
    assert len(deliveries.delivered) >= before > 0

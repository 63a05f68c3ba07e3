"""What a link does with a broker that is gone for a while, and when it is back."""

from __future__ import annotations

import asyncio
import gc
from itertools import count, pairwise, takewhile

import pytest
from support.deliveries import Deliveries, number_of
from support.scripted_broker import BUSY, ScriptedBroker, end_connection, linked, numbers
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.transport import ways_out
from plotfeed.feeds.transport.mqtt.connection import MqttConnection

pytestmark = pytest.mark.usefixtures("hurried")


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
            await asyncio.sleep(0.02)
            assert len(deliveries.made) <= published + messages + 2
            assert not publishing.done()
            broker.code = 0
        is_over.set()
        await publishing
        await link.drain(PATIENCE_S)
    sure = [p.number for p in deliveries.made if p.qos]
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
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.0,))

    def left() -> tuple[int, int]:
        gc.collect()
        clients = sum(isinstance(x, MqttConnection) for x in gc.get_objects())
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

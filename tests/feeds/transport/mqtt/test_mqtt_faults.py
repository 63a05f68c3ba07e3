"""Real brokers that are killed, restarted, paused, or cut off, and what a link loses by it."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto, own_broker
from support.cut_proxy import Proxy, proxied
from support.deliveries import Deliveries, number_of
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport import ways_out
from plotfeed.feeds.transport.mqtt import client, connection, send_queue
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.connection import MAX_UNACKNOWLEDGED
from plotfeed.feeds.transport.mqtt.send_queue import MAX_UNSENT_OCTETS
from plotfeed.testing import MqttReceiver

PAUSE_S = {"drop-oldest": 0.0, "drop-newest": 0.0, "wait": 2.0}
Start = Callable[[Path, int], AbstractContextManager["subprocess.Popen[bytes]"]]


def start_mosquitto(folder: Path, port: int) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Whose own queues are not what is tested."""
    listener = f"listener {port} 127.0.0.1\nallow_anonymous true\n"
    return mosquitto(folder, port, f"{listener}max_queued_messages 0\n")


@pytest.fixture(params=[start_mosquitto, own_broker], ids=["mosquitto", "embedded"])
def start(request: pytest.FixtureRequest) -> Start:
    found: Start = request.param
    return found


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.02,))


@asynccontextmanager
async def linked(port: int, **queue: object) -> AsyncIterator[MqttTransport]:
    address = BrokerAddress("127.0.0.1", port, (5,))
    link = MqttTransport(address, "test", queue=MqttQueueKeys.model_validate(queue))
    running = asyncio.create_task(link.run())
    try:
        await link.wait_until_up(PATIENCE_S)
        yield link
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def publish(deliveries: Deliveries, link: MqttTransport, n: int, **how: int) -> None:
    """In small bursts, with the network at work in between."""
    for start in range(0, n, 20):
        deliveries.publish(link, min(20, n - start), **how)
        await asyncio.sleep(0.001)


def pause(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)


async def drained(link: MqttTransport) -> None:
    await link.drain(PATIENCE_S)
    assert (link.waiting, link.unacknowledged) == (0, 0)


def heard_by(client: MqttReceiver, *, at_least: int | None = None) -> list[int]:
    """Numbers, in the order in which they came; waits for one if it is asked to."""
    if at_least is not None:
        client.wait_for(lambda m: number_of(m.payload) >= at_least)
    return [number_of(payload) for payload in client.on("t")]


@pytest.mark.parametrize("mid_sentence", [False, True])
@pytest.mark.asyncio
async def test_a_broker_killed_and_restarted_costs_no_message_that_it_had_not_acknowledged(
    start: Start, mid_sentence: bool, tmp_path: Path
) -> None:
    """It is killed at work, or when it has read nothing for a while."""

    async def with_the_first(port: int, proxy: Proxy, link: MqttTransport) -> list[int]:
        with MqttReceiver(port, 5, "t") as ears:
            await publish(deliveries, link, 500)
            if mid_sentence:
                pause(process)
                await publish(deliveries, link, 300)
                assert link.unacknowledged > 0
            proxy.is_closed = True
            process.kill()
            process.wait()
            await until(lambda: not link.is_up)
            await asyncio.to_thread(ears.wait_until_cut_off)
            return heard_by(ears)

    async def with_the_second(port: int, proxy: Proxy, link: MqttTransport) -> list[int]:
        with MqttReceiver(port, 5, "t") as ears:  # before the link can be there
            proxy.is_closed = False
            await publish(deliveries, link, 500)
            await drained(link)
            return await asyncio.to_thread(heard_by, ears, at_least=len(deliveries.made) - 1)

    deliveries = Deliveries()
    port = free_port()
    async with proxied(port) as proxy, AsyncExitStack() as stack:
        with start(tmp_path, port) as process:
            link = await stack.enter_async_context(linked(proxy.port, policy="wait"))
            before = await with_the_first(port, proxy, link)
        acknowledged = {*deliveries.delivered}
        await publish(deliveries, link, 500)
        assert link.waiting + len(acknowledged) == len(deliveries.made)
        with start(tmp_path, port) as process:
            after = await with_the_second(port, proxy, link)
    every = [p.number for p in deliveries.made]
    assert deliveries.delivered == every
    # What it had acknowledged and not passed on yet died with it, and that alone.
    assert after == [n for n in every if n not in acknowledged]
    assert {*every} - {*before} - {*after} <= acknowledged
    assert link.counts.dropped == 0
    assert link.counts.repeated > 0 or not mid_sentence


@pytest.mark.asyncio
async def test_across_a_restart_of_a_broker_that_remembers_nothing_is_lost_at_all(
    tmp_path: Path,
) -> None:
    """Each message is retained on a topic of its own, so that the broker can be asked for all."""
    port = free_port()
    settings = (
        f"listener {port} 127.0.0.1\nallow_anonymous true\n"
        f"persistence true\npersistence_location {tmp_path}/\n"
    )

    deliveries = Deliveries()

    async def publish_some() -> None:
        for _ in range(300):
            deliveries.publish(link, 1, topic=f"t/{len(deliveries.made)}", retain=True)
            await asyncio.sleep(0)

    running = AsyncExitStack()
    with mosquitto(tmp_path, port, settings):
        link = await running.enter_async_context(linked(port, policy="wait"))
        await publish_some()
        publishing = asyncio.create_task(publish_some())
        await asyncio.sleep(0.01)
    await publishing
    with mosquitto(tmp_path, port, settings):
        await publish_some()
        await drained(link)
        await running.aclose()
        with MqttReceiver(port, 5, "t/#") as ears:
            all_came = lambda _: len(ears.heard) == len(deliveries.made)  # noqa: E731
            await asyncio.to_thread(ears.wait_for, all_came)
    assert link.connections == 2
    assert sorted(number_of(m.payload) for m in ears.heard) == deliveries.delivered
    assert len(deliveries.delivered) == 900


@pytest.mark.parametrize("policy", ["drop-oldest", "drop-newest", "wait"])
@pytest.mark.asyncio
async def test_a_paused_broker_costs_what_the_policy_gives_up_and_bounded_memory(
    start: Start, policy: str, tmp_path: Path
) -> None:
    deliveries = Deliveries()
    port = free_port()
    with start(tmp_path, port) as process, MqttReceiver(port, 5, "t") as ears:
        async with linked(port, policy=policy, messages=700) as link:
            await publish(deliveries, link, 200)
            await drained(link)
            pause(process)
            try:
                began_s = time.monotonic()
                await publish(deliveries, link, 3000)
                await asyncio.sleep(PAUSE_S[policy] - (time.monotonic() - began_s))
                assert link.is_up
                assert link.unacknowledged <= MAX_UNACKNOWLEDGED
                paused = [*range(200, 3200)]
                dropped = {
                    "drop-oldest": paused[link.unacknowledged : -700],
                    "drop-newest": paused[link.unacknowledged + 700 :],
                    "wait": [],
                }[policy]
                assert deliveries.delivered == [*range(200)]
                assert deliveries.given_up == dropped
                assert link.waiting == (700 if policy != "wait" else 3000 - link.unacknowledged)
            finally:
                process.send_signal(signal.SIGCONT)
            await drained(link)
            await publish(deliveries, link, 20)
            await drained(link)
            assert link.connections == 1
        heard = await asyncio.to_thread(heard_by, ears, at_least=3219)
    assert heard == deliveries.delivered
    assert sorted(heard + deliveries.given_up) == [p.number for p in deliveries.made]
    assert (link.counts.repeated, link.counts.dropped) == (0, len(deliveries.given_up))


@pytest.mark.asyncio
async def test_a_paused_broker_is_given_no_more_plots_of_qos_0_than_may_be_late(
    start: Start, tmp_path: Path
) -> None:
    deliveries = Deliveries()
    port = free_port()
    with start(tmp_path, port) as process:
        async with linked(port) as link:
            pause(process)
            try:
                await publish(deliveries, link, 500, qos=0, octets=1 << 16)
                held = sum(len(p.payload) for p in deliveries.made if not p.said)
                assert MAX_UNSENT_OCTETS / 2 < held <= MAX_UNSENT_OCTETS + (1 << 16)
                assert link.waiting == 0
                assert len(deliveries.given_up) == link.counts.dropped > 0
            finally:
                process.send_signal(signal.SIGCONT)
            await drained(link)
            assert link.connections == 1
    assert deliveries.unsettled == []
    assert link.counts.dropped == len(deliveries.given_up)


@pytest.mark.parametrize(
    ("silently", "policy"),
    [(False, "drop-oldest"), (False, "drop-newest"), (False, "wait"), (True, "wait")],
)
@pytest.mark.asyncio
async def test_a_cut_network_costs_what_the_policy_gives_up(
    start: Start, silently: bool, policy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing comes through; then the connection is reset, or nobody says anything at all."""

    async def speaks_no_tls(_address: BrokerAddress) -> bool:
        return False  # without a look, which the proxy would count as a connection of the link

    monkeypatch.setattr(connection, "_speaks_tls", speaks_no_tls)
    monkeypatch.setattr(client, "WATCH_EVERY_S", 0.02)
    if silently:
        monkeypatch.setattr(connection, "KEEP_ALIVE_S", 1)
        monkeypatch.setattr(send_queue, "GIVE_UP_S", 0.3)

    deliveries = Deliveries()
    port = free_port()
    with start(tmp_path, port), MqttReceiver(port, 5, "t") as ears:
        async with proxied(port) as proxy, linked(proxy.port, policy=policy, messages=50) as link:
            for _ in range(5):
                await publish(deliveries, link, 20)
                await drained(link)
            proxy.hold()
            proxy.is_closed = True
            await publish(deliveries, link, 200, octets=1 << 14)
            assert link.is_up or silently
            if not silently:
                proxy.cut()
            await until(lambda: not link.is_up)
            monkeypatch.setattr(connection, "KEEP_ALIVE_S", 60)
            monkeypatch.setattr(send_queue, "GIVE_UP_S", PATIENCE_S)
            await publish(deliveries, link, 100)
            assert link.waiting <= 300
            proxy.is_closed = False
            await until(lambda: link.is_up)
            await drained(link)
            await publish(deliveries, link, 20)
            await drained(link)
            # A broker gives up whoever stalls for one and a half seconds of such a keep-alive.
            assert link.connections == proxy.connections >= 2
            assert silently or link.connections == 2
        heard = await asyncio.to_thread(heard_by, ears, at_least=419)
    delivered, given_up = {*deliveries.delivered}, {*deliveries.given_up}
    assert delivered <= {*heard} <= delivered | given_up
    assert delivered | given_up == set(range(420))
    assert link.counts.dropped == len(given_up)
    assert len(heard) - len({*heard}) <= link.counts.repeated
    once = list(dict.fromkeys(heard))
    assert all(a < b for a, b in pairwise(once))
    if policy == "wait":
        assert given_up == set()
    else:
        assert {*range(100)} | {*range(400, 420)} <= delivered
        assert (399 in delivered) == (policy == "drop-oldest")

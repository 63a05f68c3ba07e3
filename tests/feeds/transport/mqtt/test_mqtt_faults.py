"""Mosquitto killed, restarted and paused, a network cut, and what a link loses by it."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from support.brokers import broker_here, free_port
from support.cut_proxy import Proxy, proxied
from support.deliveries import Deliveries, number_of
from support.own_time import in_own_time
from support.scripted_broker import hearing
from support.sessions import quiet_mosquitto
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport.mqtt import connection
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.testing import MqttReceiver


@asynccontextmanager
async def linked(port: int, **queue: object) -> AsyncIterator[MqttTransport]:
    address = BrokerAddress("127.0.0.1", port, (5,))
    link = MqttTransport(address, "test", queue=MqttQueueKeys.model_validate(queue))
    async with link.connected(PATIENCE_S):
        yield link


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


@pytest.mark.asyncio
async def test_a_broker_killed_and_restarted_costs_no_message_that_it_had_not_acknowledged(
    tmp_path: Path,
) -> None:
    """It is killed when it has read nothing for a while."""

    async def with_the_first(port: int, proxy: Proxy, link: MqttTransport) -> list[int]:
        with MqttReceiver(port, 5, "t") as ears:
            await publish(deliveries, link, 200)
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
            await publish(deliveries, link, 200)
            await drained(link)
            return await asyncio.to_thread(heard_by, ears, at_least=len(deliveries.made) - 1)

    deliveries = Deliveries()
    port = free_port()
    async with proxied(port) as proxy, AsyncExitStack() as stack:
        with quiet_mosquitto(tmp_path, port) as process:
            link = await stack.enter_async_context(linked(proxy.port, policy="wait"))
            before = await with_the_first(port, proxy, link)
        acknowledged = {*deliveries.delivered}
        await publish(deliveries, link, 200)
        assert link.waiting + len(acknowledged) == len(deliveries.made)
        with quiet_mosquitto(tmp_path, port) as process:
            after = await with_the_second(port, proxy, link)
    every = [p.number for p in deliveries.made]
    assert deliveries.delivered == every
    # What it had acknowledged and not passed on yet died with it, and that alone.
    assert after == [n for n in every if n not in acknowledged]
    assert {*every} - {*before} - {*after} <= acknowledged
    assert link.counts.dropped == 0
    assert link.counts.repeated > 0


@pytest.mark.parametrize(
    ("silently", "policy"),
    [(False, "drop-oldest"), (False, "drop-newest"), (False, "wait"), (True, "wait")],
)
@in_own_time
async def test_a_cut_network_costs_what_the_policy_gives_up(
    silently: bool, policy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing comes through; then the connection is reset, or nobody says anything at all."""

    async def speaks_no_tls(_address: BrokerAddress) -> bool:
        return False  # without a look, which the proxy would count as a connection of the link

    monkeypatch.setattr(connection, "_speaks_tls", speaks_no_tls)
    deliveries = Deliveries()
    async with broker_here() as port, hearing(port, "t") as ears, proxied(port) as proxy:
        async with linked(proxy.port, policy=policy, messages=50) as link:
            for _ in range(5):
                await publish(deliveries, link, 20)
                await drained(link)
            proxy.hold()
            proxy.is_closed = True
            await publish(deliveries, link, 200, octets=1 << 14)
            assert link.is_up
            if not silently:
                proxy.cut()
            await until(lambda: not link.is_up)
            await publish(deliveries, link, 100)
            assert link.waiting <= 300
            proxy.is_closed = False
            await until(lambda: link.is_up)
            await drained(link)
            await publish(deliveries, link, 20)
            await drained(link)
            assert link.connections == proxy.connections == 2
        await until(lambda: number_of(ears[-1][1]) == 419)
    heard = [number_of(payload) for _, payload in ears]
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

"""A network that is cut, and what a link loses by it."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise

import pytest
from support.brokers import broker_here
from support.deliveries import Deliveries, number_of
from support.own_time import in_own_time
from support.scripted_broker import hearing
from support.servers import proxied
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport.mqtt import connection
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport


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


async def drained(link: MqttTransport) -> None:
    await link.drain(PATIENCE_S)
    assert link.waiting == 0


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
    assert all(100 <= n < 300 for n, times in Counter(heard).items() if times > 1)
    once = list(dict.fromkeys(heard))
    assert all(a < b for a, b in pairwise(once))
    if policy == "wait":
        assert given_up == set()
    else:
        assert {*range(100)} | {*range(400, 420)} <= delivered
        assert (399 in delivered) == (policy == "drop-oldest")

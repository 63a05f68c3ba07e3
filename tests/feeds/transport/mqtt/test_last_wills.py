"""Connections that hold a last will each, over real brokers."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from support.brokers import free_port, own_broker
from support.cut_proxy import proxied
from support.deliveries import NOBODY
from support.sessions import Start, every_broker
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.transport import ways_out
from plotfeed.feeds.transport.mqtt import connection, last_wills
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.last_wills import LastWills
from plotfeed.testing import MqttReceiver

SENSORS = [f"s{i}" for i in range(25)]
LEAVE_S = 2.0  # For what a broker that was killed may have taken with it


def number_up(wills: LastWills) -> int:
    """How many connections are up, each with its will."""
    return sum(not each.lost.is_set() for each in wills._connections.values())


def status(sensor: str, state: str) -> Message:
    payload = json.dumps({"sensor": sensor, "state": state}).encode()
    return Message(
        topic=f"p/{sensor}/status",
        payload=payload,
        content_type="application/json",
        due_utc_ns=0,
        retain=True,
        qos=1,
    )


@asynccontextmanager
async def placed(
    port: int,
    sensors: Sequence[str] = SENSORS,
    versions: tuple[int, ...] = (5, 4),
    says_goodbye: bool = True,
) -> AsyncIterator[tuple[LastWills, list[str]]]:
    """With a link that says ONLINE, and whose wills came back."""
    link = MqttTransport(BrokerAddress("127.0.0.1", port, versions), "test")
    back: list[str] = []

    def is_back(sensor: str) -> None:
        back.append(sensor)
        link.publish([status(sensor, "ONLINE").again(NOBODY, 1)])

    there = LastWills(link, {s: status(s, "OFFLINE") for s in sensors}, is_back)
    async with link.connected(PATIENCE_S):
        running = asyncio.create_task(there.run())
        await there.wait_until_up()
        for sensor in sensors:
            link.publish([status(sensor, "ONLINE").again(NOBODY, 1)])
        await link.drain(PATIENCE_S)
        try:
            yield there, back
        finally:
            await link.drain(LEAVE_S)
            if says_goodbye:
                there.forget()
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


def states(ears: MqttReceiver, sensor: str) -> list[str]:
    return [json.loads(payload)["state"] for payload in ears.on(f"p/{sensor}/status")]


def all_states(ears: MqttReceiver) -> dict[str, list[str]]:
    return {sensor: states(ears, sensor) for sensor in SENSORS}


def were(*expected: str) -> dict[str, list[str]]:
    return {sensor: [*expected] for sensor in SENSORS}


@every_broker
@pytest.mark.asyncio
async def test_wills_that_were_cut_off_are_told_and_what_comes_back_is_told_anew(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(last_wills, "LOOK_EVERY_S", 0.02)
    port = free_port()
    with start(tmp_path, port), MqttReceiver(port, 5, "p/+/status") as ears:
        async with proxied(port) as proxy:
            async with placed(proxy.port) as (there, back):
                assert number_up(there) == len(SENSORS)
                await until(lambda: all_states(ears) == were("ONLINE"))
                proxy.cut()
                await until(lambda: all_states(ears) == were("ONLINE", "OFFLINE", "ONLINE"))
                assert sorted(back) == sorted(SENSORS)
                assert number_up(there) == len(SENSORS)
            await asyncio.sleep(0.2)  # those that say goodbye have no will
            assert all_states(ears) == were("ONLINE", "OFFLINE", "ONLINE")


@every_broker
@pytest.mark.asyncio
async def test_wills_that_say_goodbye_are_forgotten(start: Start, tmp_path: Path) -> None:
    port = free_port()
    with start(tmp_path, port), MqttReceiver(port, 5, "p/+/status") as ears:
        async with placed(port):
            await until(lambda: all_states(ears) == were("ONLINE"))
        await asyncio.sleep(0.2)
        assert all_states(ears) == were("ONLINE")


@every_broker
@pytest.mark.asyncio
async def test_wills_that_say_no_goodbye_are_told(start: Start, tmp_path: Path) -> None:
    """As of a session that broke."""
    port = free_port()
    with start(tmp_path, port), MqttReceiver(port, 5, "p/+/status") as ears:
        async with placed(port, says_goodbye=False):
            await until(lambda: all_states(ears) == were("ONLINE"))
        await until(lambda: all_states(ears) == were("ONLINE", "OFFLINE"))


@pytest.mark.asyncio
async def test_connections_that_say_nothing_else_are_kept_alive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And one whose broker is silent is cut, which the broker finds out sooner or later."""
    keep_alive_s = 3  # the broker cuts off who was silent for half as long again
    monkeypatch.setattr(connection, "KEEP_ALIVE_S", keep_alive_s)
    monkeypatch.setattr(last_wills, "LOOK_EVERY_S", 0.1)
    port = free_port()
    with own_broker(tmp_path, port), MqttReceiver(port, 5, "p/+/status") as ears:
        async with proxied(port) as proxy, placed(proxy.port) as (there, back):
            await until(lambda: all_states(ears) == were("ONLINE"))
            await asyncio.sleep(2 * keep_alive_s)
            assert (number_up(there), back) == (len(SENSORS), [])
            assert all_states(ears) == were("ONLINE")
            proxy.hold()
            await until(lambda: len(back) == len(SENSORS))


@pytest.mark.asyncio
async def test_a_broker_that_does_not_take_so_many_connections_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.05,))
    monkeypatch.setattr(last_wills, "LOOK_EVERY_S", 0.02)
    port = free_port()
    with own_broker(tmp_path, port):
        async with proxied(port) as proxy:
            proxy.most = 5
            async with placed(proxy.port) as (there, back):
                await asyncio.sleep(0.5)
                await until(lambda: number_up(there) == 4)  # the link is one, too
                assert back == []
    assert len([r for r in caplog.records if "no last will" in r.message]) == 1


@every_broker
@pytest.mark.asyncio
async def test_a_broker_that_is_away_is_not_asked_by_everybody(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The link beside them is the one that knocks."""
    monkeypatch.setattr(last_wills, "LOOK_EVERY_S", 0.02)
    port = free_port()
    async with proxied(port) as proxy:
        with start(tmp_path, port) as process:
            async with placed(proxy.port) as (there, back):
                process.kill()
                process.wait()
                await until(lambda: number_up(there) == 0)
                before = proxy.connections
                await asyncio.sleep(1.0)
                assert proxy.connections == before
                with start(tmp_path, port):
                    await until(lambda: number_up(there) == len(SENSORS))
                    assert sorted(back) == sorted(SENSORS)

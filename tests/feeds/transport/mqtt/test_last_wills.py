"""Connections that hold a last will each, over a broker of others, and over ours in own time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from support.brokers import broker_here, free_port, mosquitto
from support.deliveries import NOBODY
from support.own_time import in_own_time
from support.scripted_broker import hearing
from support.servers import proxied
from support.waiting import PATIENCE_S, kept_up, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.transport.mqtt import client, connection
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import LastWills, MqttTransport

SENSORS = [f"s{i}" for i in range(25)]
LEAVE_S = 2.0  # For what a broker that was killed may have taken with it


def number_up(wills: LastWills) -> int:
    """How many connections are up, each with its will."""
    return sum(not each.lost.is_set() for each in wills._connections.values())


def status(sensor: str, state: str) -> Message:
    return Message(f"p/{sensor}/status", state.encode(), "text/plain", 0, retain=True, qos=1)


@asynccontextmanager
async def placed(
    port: int, *, says_goodbye: bool = True
) -> AsyncIterator[tuple[LastWills, list[str]]]:
    """With a link that says ONLINE, and whose wills came back."""
    link, back = MqttTransport(BrokerAddress("127.0.0.1", port), "test"), list[str]()

    def is_there(sensor: str) -> None:
        link.publish([status(sensor, "ONLINE").again(NOBODY, 1)])

    def is_back(sensor: str) -> None:
        back.append(sensor)
        is_there(sensor)

    there = LastWills(link, {s: status(s, "OFFLINE") for s in SENSORS}, is_back)
    async with link.connected(PATIENCE_S), kept_up(there.run()):
        await there.wait_until_up()
        for sensor in SENSORS:
            is_there(sensor)
        await link.drain(PATIENCE_S)
        yield there, back
        await link.drain(LEAVE_S)
        if says_goodbye:
            there.forget()


def all_states(ears: list[tuple[str, bytes]]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {sensor: [] for sensor in SENSORS}
    for topic, payload in ears:
        found[topic.split("/")[1]].append(payload.decode())
    return found


def were(*expected: str) -> dict[str, list[str]]:
    return {sensor: [*expected] for sensor in SENSORS}


@pytest.mark.asyncio
async def test_wills_that_were_cut_off_are_told_and_what_comes_back_is_told_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By mosquitto; those that say goodbye have no will, those that break have one."""
    monkeypatch.setattr(client, "LOOK_EVERY_S", 0.02)
    port, states = free_port(), ["ONLINE", "OFFLINE", "ONLINE"]
    with mosquitto(tmp_path, port):
        async with hearing(port, "p/+/status") as ears:
            async with proxied(port) as proxy, placed(proxy.port) as (there, back):
                await until(lambda: all_states(ears) == were("ONLINE"))
                proxy.cut()
                await until(lambda: all_states(ears) == were(*states))
                assert sorted(back) == sorted(SENSORS)
                assert number_up(there) == len(SENSORS)
            async with placed(port, says_goodbye=False):
                await until(lambda: all_states(ears) == were(*states, "ONLINE"))
            await until(lambda: all_states(ears) == were(*states, "ONLINE", "OFFLINE"))


@in_own_time
async def test_connections_that_say_nothing_else_are_kept_alive() -> None:
    """And one whose broker is silent is cut, which the broker finds out sooner or later."""
    async with (
        broker_here() as port,
        hearing(port, "p/+/status") as ears,
        proxied(port) as proxy,
        placed(proxy.port) as (there, back),
    ):
        await until(lambda: all_states(ears) == were("ONLINE"))
        await asyncio.sleep(10 * connection.KEEP_ALIVE_S)
        assert (number_up(there), back) == (len(SENSORS), [])
        assert all_states(ears) == were("ONLINE")
        proxy.hold()
        await until(lambda: len(back) == len(SENSORS))


@in_own_time
async def test_a_broker_that_does_not_take_so_many_connections_is_told_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with broker_here() as port, proxied(port) as proxy:
        proxy.most = 5
        async with placed(proxy.port) as (there, back):
            await asyncio.sleep(20.0)
            assert (number_up(there), back) == (4, [])  # the link is one, too
    hint = "it hung up without an answer: it may have as many connections as it takes"
    (line,) = (m for m in caplog.messages if "no last will" in m)
    assert line.endswith(f"no last will at mqtt://127.0.0.1:{proxy.port} ({hint})")


@pytest.mark.asyncio
async def test_a_broker_that_is_away_is_not_asked_by_everybody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The link beside them is the one that knocks."""
    monkeypatch.setattr(client, "LOOK_EVERY_S", 0.02)
    port = free_port()
    async with proxied(port) as proxy:
        with mosquitto(tmp_path, port) as process:
            async with placed(proxy.port) as (there, back):
                process.kill()
                process.wait()
                await until(lambda: number_up(there) == 0)
                before = proxy.connections
                await asyncio.sleep(0.3)
                assert proxy.connections == before
                with mosquitto(tmp_path, port):
                    await until(lambda: number_up(there) == len(SENSORS))
                    assert sorted(back) == sorted(SENSORS)

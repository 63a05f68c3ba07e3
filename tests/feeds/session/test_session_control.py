"""Commands to a session over a real broker: what they change, and what is refused."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, own_broker
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork, Start, at_work, every_broker
from support.waiting import until

from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import MqttMessage, MqttReceiver

MS = 1_000_000
CONTROL, SETTINGS, ERRORS = "plotfeed/control", "plotfeed/radar/settings", "plotfeed/errors"
OTHER = radar("other", period_s=6.0, sectors=96)


def scene(folder: Path, **changes: str) -> Scene:
    sensors = radar(period_s=6.0, sectors=96) + OTHER
    text = scene_text(sensors=sensors, mqtt="truth = false", port=1883, **changes)
    return load(scene_file(folder, text))


async def command(ears: MqttReceiver, **what: Any) -> dict[str, Any]:
    """What the settings are afterwards."""
    await asyncio.to_thread(ears.wait_for, is_settings)  # the first ones are from the beginning
    since = len(ears.heard)
    ears.publish(CONTROL, json.dumps({"sensor": "radar", **what}).encode())
    heard = await asyncio.to_thread(ears.wait_for, is_settings, since)
    told: dict[str, Any] = json.loads(heard.payload)
    return told


def is_settings(message: MqttMessage) -> bool:
    return message.topic == SETTINGS


async def next_messages(session: AtWork, sensor: str = "radar") -> list[pb.Sent]:
    """What the ledger says of sectors that end from now on."""
    since_ns = session.clock.now_ns() + 70 * MS  # one may be worked out already

    def found() -> list[pb.Sent]:
        return [
            one
            for entry in session.entries
            if entry.sensor == sensor
            for one in entry.messages
            if one.due_utc_ns > since_ns
        ]

    await until(lambda: len(found()) >= 6)
    return found()


def delays_ns(messages: list[pb.Sent]) -> set[int]:
    return {one.link_due_utc_ns - one.due_utc_ns for one in messages}


@every_broker
@pytest.mark.asyncio
async def test_commands_change_a_sensor_at_once_and_are_retained(
    start: Start, tmp_path: Path
) -> None:
    port = free_port()
    with start(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as ears:
        async with at_work(scene(tmp_path), port) as session:
            told = await command(ears, set={"link": {"latency_ms": 150}})
            assert told["in_force"]["link"] == {"latency_ms": 150}
            assert delays_ns(await next_messages(session)) == {150 * MS}
            assert delays_ns(await next_messages(session, "other")) == {0}
            told = await command(ears, set={"link": {"loss": {"kind": "random", "probability": 1}}})
            assert told["in_force"]["link"]["latency_ms"] == 150  # changes add up
            assert {one.fate for one in await next_messages(session)} == {pb.LOST}
            told = await command(ears, set={"link": None, "pfa": 1e-2})
            assert told["in_force"]["pfa"] == 1e-2
            plots = session.totals.plots
            assert delays_ns(await next_messages(session)) == {0}
            assert session.totals.plots > plots + 20
            told = await command(ears, set={"enabled": False})
            assert told["controlled"] == {"link": None, "pfa": 1e-2, "enabled": False}
            await session.sectors_more(4)  # those that were worked out before
            await session.sectors_more(10)
            assert {r.sensor for r in session.sectors[-10:]} == {"other"}
            with MqttReceiver(port, 5, SETTINGS) as late:
                late_told = await asyncio.to_thread(late.wait_for, lambda m: m.retained)
                assert json.loads(late_told.payload) == told
            told = await command(ears, reset=True)
            assert told["controlled"] == {}
            assert "link" not in told["in_force"]
            assert delays_ns(await next_messages(session)) == {0}
            assert session.session.sensors["radar"].sensor == session.session.scene.sensor[0]
    assert (session.totals.controls, session.totals.refused) == (5, 0)


REFUSED = {
    b"": "not JSON",
    b"[]": "expected an object",
    b'{"sensor": "radar"}': "expected either",
    b'{"sensor": "nobody", "reset": true}': "there is no 'nobody'; expected one of radar, other",
    b'{"sensor": "radar", "set": {"pfa": 2}}': "pfa",
    b'{"sensor": "radar", "set": {"link": {"latency": 5}}}': "latency",
    b'{"sensor": "radar", "set": {"position_enu_m": [0, 0, 0]}}': "position_enu_m",
    b'{"sensor": "radar", "set": {"pfa": 1e-5}, "reset": true}': "expected either",
    b'{"clock": {"speed": 10}}': "real time cannot be held or hurried",
    b" " * (1 << 17): "at most 65536",
}


@pytest.mark.asyncio
async def test_what_cannot_be_done_is_refused_in_a_line_and_changes_nothing(tmp_path: Path) -> None:
    port = free_port()
    with own_broker(tmp_path, port), MqttReceiver(port, 5, ERRORS, SETTINGS) as ears:
        async with at_work(scene(tmp_path), port) as session:
            for number, (payload, words) in enumerate(REFUSED.items(), 1):
                ears.publish(CONTROL, payload)
                await until(lambda: len(ears.on(ERRORS)) >= number)  # noqa: B023
                told = json.loads(ears.on(ERRORS)[-1])
                assert words in told["detail"]
                assert told["detail"].isprintable()
                expected = {"topic": CONTROL, "drone": "", "reason": "control"}
                assert told.items() >= {**expected, "count": str(number)}.items()
            assert session.session.sensors["radar"].sensor == session.session.scene.sensor[0]
    assert (session.totals.refused, session.totals.controls) == (len(REFUSED), 0)
    assert len(ears.on(SETTINGS)) == 1


@pytest.mark.asyncio
async def test_a_simulated_clock_is_held_stepped_and_hurried_over_the_wire(tmp_path: Path) -> None:
    what = scene(tmp_path, start_utc="2026-01-01T12:00:00Z")

    port, clock = free_port(), WallClock(what.scene.start_utc_ns, speed=5.0)
    with own_broker(tmp_path, port), MqttReceiver(port, 5, ERRORS) as ears:
        async with at_work(what, port, clock=clock) as session:
            await session.sectors_more(2)
            ears.publish(CONTROL, b'{"clock": {"paused": true}}')
            await until(lambda: clock.is_paused)
            stood_ns = clock.now_ns()
            ears.publish(CONTROL, b'{"clock": {"step_s": 1.5}}')
            await until(lambda: clock.now_ns() > stood_ns and clock.is_paused)
            assert clock.now_ns() == stood_ns + 1500 * MS
            ears.publish(CONTROL, b'{"clock": {"paused": false, "speed": 20}}')
            await until(lambda: clock.speed == 20 and not clock.is_paused)
            await session.sectors_more(20)
    assert ears.on(ERRORS) == []
    assert session.totals.controls == 3
    sector_ns, step_end_ns = 6_000 * MS // 96, stood_ns + 1500 * MS
    ends_ns = {report.sector.end_ns for report in session.sectors}
    stepped = range(stood_ns // sector_ns + 1, step_end_ns // sector_ns + 1)
    assert {number * sector_ns for number in stepped} <= ends_ns  # standing misses none

"""Commands to a session over a real broker: what is retained of them, refused, and of its clock."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, own_broker
from support.scene_files import radar, scene_file, scene_text
from support.sessions import at_work
from support.waiting import until

from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.testing import MqttReceiver

MS = 1_000_000
CONTROL, SETTINGS, ERRORS = "plotfeed/control", "plotfeed/radar/settings", "plotfeed/errors"
DESCRIPTION = "plotfeed/radar/description"
REFUSED = {
    b"[]": "expected an object",
    b'{"sensor": "nobody", "reset": true}': "there is no 'nobody'; expected one of radar",
    b'{"sensor": "radar", "set": {"link": {"latency": 5}}}': "latency",
    b" " * (1 << 17): "at most 65536",
}


@pytest.mark.asyncio
async def test_a_session_obeys_refuses_in_a_line_and_has_its_clock_held_over_the_wire(
    tmp_path: Path,
) -> None:
    sensors, start = radar(period_s=6.0, sectors=96), "2026-01-01T12:00:00Z"
    text = scene_text(sensors=sensors, mqtt="truth = false", port=1883, start_utc=start)
    what, port = load(scene_file(tmp_path, text)), free_port()
    clock = WallClock(what.scene.start_utc_ns, speed=5.0)

    def told(ears: MqttReceiver, topic: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(ears.on(topic)[-1])
        return found

    with own_broker(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as ears:
        async with at_work(what, port, clock=clock) as session:
            await until(lambda: len(ears.on(SETTINGS)) == len(ears.on(DESCRIPTION)) == 1)
            first = told(ears, DESCRIPTION)
            command = {"link": {"latency_ms": 150}, "azimuth_min_deg": -30.0}
            asked = {"sensor": "radar", "set": command | {"azimuth_max_deg": 30.0}}
            ears.publish(CONTROL, json.dumps(asked).encode())
            await until(lambda: len(ears.on(SETTINGS)) == len(ears.on(DESCRIPTION)) == 2)
            assert told(ears, SETTINGS)["in_force"]["link"] == {"latency_ms": 150}
            second = told(ears, DESCRIPTION)
            changed = {key for key in first if first[key] != second.get(key)}
            assert changed == {"time_utc", "azimuth_min_deg", "azimuth_max_deg"}
            for topic in (SETTINGS, DESCRIPTION):
                with MqttReceiver(port, 5, topic) as late:
                    kept = await asyncio.to_thread(late.wait_for, lambda m: m.retained)
                    assert json.loads(kept.payload) == told(ears, topic)
            for number, (payload, words) in enumerate(REFUSED.items(), 1):
                ears.publish(CONTROL, payload)
                await until(lambda: len(ears.on(ERRORS)) >= number)  # noqa: B023
                error = told(ears, ERRORS)
                assert words in error["detail"]
                assert error["detail"].isprintable()
                expected = {"topic": CONTROL, "drone": "", "reason": "control"}
                assert error.items() >= {**expected, "count": str(number)}.items()
            ears.publish(CONTROL, b'{"clock": {"paused": true}}')
            await until(lambda: clock.is_paused)
            stood_ns = clock.now_ns()
            ears.publish(CONTROL, b'{"clock": {"step_s": 1.5}}')
            await until(lambda: clock.now_ns() > stood_ns and clock.is_paused)
            assert clock.now_ns() == stood_ns + 1500 * MS
            ears.publish(CONTROL, b'{"clock": {"paused": false, "speed": 20}}')
            await until(lambda: clock.speed == 20 and not clock.is_paused)
            await session.sectors_more(20)
    assert (session.totals.controls, session.totals.refused) == (4, len(REFUSED))
    sector_ns, step_end_ns = 6_000 * MS // 96, stood_ns + 1500 * MS
    ends_ns = {batch.sector.end_ns for batch in session.sectors}
    stepped = range(stood_ns // sector_ns + 1, step_end_ns // sector_ns + 1)
    assert {number * sector_ns for number in stepped} <= ends_ns  # standing misses none

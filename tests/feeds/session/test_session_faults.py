"""Whole sessions over real brokers that are flooded, fed garbage, or given a clock that steps."""

from __future__ import annotations

import asyncio
import json
import random
import time
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, own_broker
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork, Start, at_work, every_broker
from support.waiting import until

from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.telemetry.fair_queue import MAX_WAITING
from plotfeed.feeds.telemetry.position_report import MAX_DETAIL, PositionReport
from plotfeed.feeds.telemetry.receiver import MAX_REFUSALS_PER_S
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.models.state import AltitudeReference
from plotfeed.testing import MqttReceiver

S = 1_000_000_000
LONG = radar(period_s=6.0, sectors=96)  # Of which a machine that others use misses no turn
ERRORS, CONTROL = "plotfeed/errors", "plotfeed/control"


def scene(folder: Path, **changes: Any) -> Scene:
    text = {"sensors": LONG, "drones": "", "mqtt": "truth = false", **changes}
    return load(scene_file(folder, scene_text(port=1883, **text)))


def report(t_utc_ns: int, number: int = 0) -> PositionReport:
    """Of a drone somewhere within cover."""
    return PositionReport(
        t_utc_ns=t_utc_ns,
        latitude_deg=40.45 + 0.0004 * (number % 101),
        longitude_deg=-3.73 + 0.0004 * (number // 101 % 101),
        altitude_m=900.0,
        altitude_reference=AltitudeReference.ELLIPSOID,
    )


def telemetry(session: AtWork, drone: str, number: int = 0) -> tuple[str, bytes]:
    """Topic and payload."""
    payload = report(session.clock.now_ns(), number).to_protobuf()
    return f"plotfeed/telemetry/{drone}", payload


def assert_no_sector_is_missing(session: AtWork, sectors: int = 96) -> None:
    places = [r.sector.scan * sectors + r.sector.index for r in session.sectors]
    assert places == list(range(places[0], places[0] + len(places)))
    assert session.totals.missed_scans == 0


def refusals(ears: MqttReceiver) -> list[dict[str, Any]]:
    return [json.loads(payload) for payload in ears.on(ERRORS)]


FLOOD = 50_000


@every_broker
@pytest.mark.asyncio
async def test_a_flood_of_telemetry_is_counted_and_holds_no_sector_up(
    start: Start, tmp_path: Path
) -> None:
    """As fast as the broker takes it; nine of ten messages are garbage."""

    def flood(now_ns: int) -> Iterator[tuple[str, bytes]]:
        for i in range(FLOOD):
            good = report(now_ns + i * 1000, i % 50).to_protobuf() if i % 10 == 0 else b"\xff"
            yield f"plotfeed/telemetry/d{i % 50}", good

    port, markers = free_port(), 0
    with start(tmp_path, port), MqttReceiver(port, 5, ERRORS) as ears:
        async with at_work(scene(tmp_path), port) as session:
            await session.sectors_more(2)
            await asyncio.to_thread(ears.publish_all, [*flood(session.clock.now_ns())])
            while "marker" not in session.session.trajectories.names:
                ears.publish_all([telemetry(session, "marker")])
                markers += 1
                await asyncio.sleep(0.1)
            await session.sectors_more(2)
    heard = session.taken + session.session.intake.given_up
    totals = session.totals
    assert totals.telemetry + totals.conflated + totals.refused == heard
    assert totals.flooded == session.session.intake.given_up
    assert MAX_WAITING < heard <= FLOOD + markers
    assert {"d0", "d10", "d20", "d30", "d40", "marker"} == {*session.session.trajectories.names}
    assert session.most_waiting <= MAX_WAITING
    assert_no_sector_is_missing(session)
    by_second = Counter(refused["time_utc"][:19] for refused in refusals(ears))
    assert 0 < max(by_second.values()) <= MAX_REFUSALS_PER_S


@pytest.mark.asyncio
async def test_as_many_drones_as_may_be_are_followed_and_one_more_is_refused(
    tmp_path: Path,
) -> None:
    lasting = "stale_after_s = 60.0\ngeoid_undulation_m = 51.0\nmax_new_drones_per_s = 10000"

    port, most = free_port(), 10_000
    with own_broker(tmp_path, port), MqttReceiver(port, 5, ERRORS) as ears:
        async with at_work(scene(tmp_path, telemetry=lasting), port) as session:
            for first in range(0, most, 1000):
                now_ns = session.clock.now_ns()
                drones = range(first, first + 1000)
                ears.publish_all(
                    (f"plotfeed/telemetry/d{i}", report(now_ns + k, i).to_protobuf())
                    for i in drones
                    for k in (0, 1)
                )
                await until(lambda: session.totals.telemetry == 2 * first + 2000)  # noqa: B023
            ears.publish_all([telemetry(session, "one-more")])
            refused = await asyncio.to_thread(ears.wait_for, lambda m: m.topic == ERRORS)
            ears.publish_all([telemetry(session, "d1234", 1234)])
            await until(lambda: session.totals.telemetry == 2 * most + 1)
            await until(lambda: sum(len(r.looks) for r in session.sectors) > 1000)
    told = json.loads(refused.payload)
    assert (told["reason"], told["drone"]) == ("too_many_drones", "one-more")
    assert "10000 drones are the most taken" in told["detail"]
    assert (session.totals.drones, session.totals.refused) == (most, 1)
    assert_no_sector_is_missing(session)


def garbage(chance: random.Random) -> Iterator[tuple[str, bytes, str | None]]:
    """Topic, payload and content type, none of which can be taken."""
    good = json.loads(report(0).to_json())
    drone = f"plotfeed/telemetry/d{chance.randrange(5)}"
    octets = chance.randbytes(chance.choice((0, 1, 3, 40, 400, 4096)))
    media = chance.choice((None, "application/json", "application/x-protobuf", "text/plain", "é;;"))
    yield drone, b"\xff" + octets, media
    wrong: tuple[Any, ...] = (None, "x", [], {}, -1e300, True, 10**400)
    yield drone, json.dumps(good | {chance.choice([*good]): chance.choice(wrong)}).encode(), None
    yield drone, json.dumps(dict(chance.sample([*good.items()], len(good) - 1))).encode(), None
    yield drone, b'{"latitude_deg": 1' + b"[" * chance.choice((1, 2000)), "application/json"
    cut = report(0).to_protobuf()
    yield drone, cut[: chance.randrange(1, len(cut))] + b"\xff", "application/x-protobuf"
    yield drone, bytes([chance.choice((48, 129))]) + octets, "application/x-asterix; cat=129"
    yield "plotfeed/telemetry/", b"{}", None
    name = "".join(map(chr, chance.choices(range(0x30, 0x2FF), k=chance.choice((70, 20_000)))))
    name = "".join(c for c in name if c.isprintable())
    yield f"plotfeed/telemetry/{name}", octets, None
    yield CONTROL, octets, None
    keys = ("sensor", "set", "reset", "clock", "x")
    command = {key: chance.choice(("radar", {}, [], {"pfa": 2}, 1, None)) for key in keys}
    yield CONTROL, json.dumps(command).encode(), None
    yield CONTROL, b'{"sensor": "radar", "set": ' + b'{"link": ' * chance.choice((1, 5000)), None


HUGE = 900_000
NESTED_SETS = ({"pfa": 2.0}, {"id": "other"}, {"link": {"latency_ms": -1}}, {"link": {"x": 1}},
               {"scan": {"period_s": 9}}, {"pfa": float("nan")}, {"event": []}, {})  # fmt: skip


@every_broker
@pytest.mark.asyncio
async def test_a_minute_of_garbage_is_refused_in_lines_and_changes_nothing(
    start: Start, tmp_path: Path
) -> None:
    """At twenty times the pace. Whatever it is, it is told why; what is good is still taken."""
    what = scene(tmp_path, start_utc="2026-01-01T12:00:00Z", sensors=radar(period_s=30, sectors=96))
    published = Counter[str]()

    async def publish(ears: MqttReceiver, session: AtWork, number: int) -> None:
        chance = random.Random(number)  # noqa: S311 - no secret
        for topic, payload, content_type in garbage(chance):
            ears.publish(topic, payload, content_type)
            published["bad"] += 1
        if number % 10 == 0:
            ears.publish_all([telemetry(session, "good"), telemetry(session, "x" * 70)])
            published.update(("good", "bad"))
        if number % 50 == 0:
            big = chance.choice((b"\0", b" ", b"[")) * HUGE
            for topic in (CONTROL, "plotfeed/telemetry/big"):
                await asyncio.to_thread(ears.publish, topic, big)
                published["bad"] += 1
        keys = chance.choice(NESTED_SETS)
        ears.publish(CONTROL, json.dumps({"sensor": "radar", "set": keys}).encode())
        published["bad" if keys else "good"] += 1

    port, clock = free_port(), WallClock(what.scene.start_utc_ns, speed=20.0)
    with start(tmp_path, port), MqttReceiver(port, 5, ERRORS) as ears:
        async with at_work(what, port, clock=clock) as session:
            number = 0
            while number <= 60 or clock.now_ns() < session.session.start_ns + 59 * S:
                await publish(ears, session, number)
                number += 1
                await asyncio.sleep(0.02)
            await until(lambda: session.taken == published.total())
            await session.sectors_more(1)
    totals = session.totals
    assert totals.telemetry + totals.controls == published["good"] > 5
    assert totals.refused == published["bad"] > 100
    assert session.session.intake.given_up == 0
    # On a slow machine its reports are so far apart that it is gone in between.
    assert {*session.session.trajectories.names} <= {"good"}
    assert session.session.sensors["radar"].sensor == what.sensor[0]
    assert_no_sector_is_missing(session)
    assert session.sectors[-1].sector.end_ns > session.session.start_ns + 59 * S
    lines = refusals(ears)
    assert all(0 < len(line["detail"]) <= MAX_DETAIL for line in lines)
    assert all(line["detail"].isprintable() for line in lines)
    assert {"undecodable", "missing", "control", "name"} <= {line["reason"] for line in lines}


@pytest.mark.asyncio
async def test_a_clock_of_the_system_that_steps_back_moves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By an hour. Telemetry is taken by the session's own time."""
    now_ns, now_s = time.time_ns, time.time

    port = free_port()
    with own_broker(tmp_path, port), MqttReceiver(port, 5, ERRORS) as ears:
        async with at_work(scene(tmp_path), port) as session:
            await session.sectors_more(3)
            before_ns = session.clock.now_ns()
            monkeypatch.setattr(time, "time_ns", lambda: now_ns() - 3600 * S)
            monkeypatch.setattr(time, "time", lambda: now_s() - 3600)
            await session.sectors_more(10)
            assert before_ns < session.clock.now_ns() < before_ns + 60 * S
            ears.publish_all([telemetry(session, "d")])
            await until(lambda: session.totals.telemetry == 1)
            old = report(time.time_ns()).to_protobuf()
            ears.publish_all([("plotfeed/telemetry/d", old)])
            refused = await asyncio.to_thread(ears.wait_for, lambda m: m.topic == ERRORS)
            await session.sectors_more(3)
    assert json.loads(refused.payload)["reason"] == "stale"
    assert_no_sector_is_missing(session)
    ends_ns = [r.sector.end_ns for r in session.sectors]
    assert {b - a for a, b in pairwise(ends_ns)} == {6 * S // 96}
    # As late as ever: an hour neither too soon nor too late.
    assert all(0 <= one.sent_utc_ns - one.due_utc_ns < 60 * S for one in session.sent)

"""Sessions that are flooded, fed garbage, or given a clock that steps."""

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
from support.sessions import Asked, AtWork, at_work, simulated
from support.waiting import until

from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.telemetry.fair_queue import MAX_WAITING
from plotfeed.feeds.telemetry.position_report import MAX_DETAIL, PositionReport
from plotfeed.feeds.telemetry.receiver import MAX_REFUSALS_PER_S
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.state import AltitudeReference
from plotfeed.testing import MqttReceiver

S = 1_000_000_000
LONG = radar(period_s=6.0, sectors=96)  # Of which a machine that others use misses no turn
CONTROL, TELEMETRY = "plotfeed/control", "plotfeed/telemetry"


def scene(folder: Path, **changes: Any) -> Scene:
    text = {"sensors": LONG, "drones": "", "mqtt": "truth = false", **changes}
    return load(scene_file(folder, scene_text(port=1883, **text)))


def report(t_utc_ns: int, east: int = 0) -> PositionReport:
    """Of a drone within cover."""
    at = 40.45, -3.72 + 1e-6 * east, 900.0, AltitudeReference.ELLIPSOID
    return PositionReport(t_utc_ns, *at, (20.0, 0.0, 0.0))


def assert_no_sector_is_missing(session: AtWork) -> None:
    """Of 96 a turn."""
    sectors = [batch.sector for batch in session.sectors if batch.sensor == "radar"]
    places = [sector.scan * 96 + sector.index for sector in sectors]
    assert places == list(range(places[0], places[0] + len(places)))


FLOOD, CHUNK = 10_000, 1_000
# A broker that is itself behind with a flood may pass a report on when it is seconds old.
NEVER_LATE = "stale_after_s = 3600"


def octets(session: AtWork) -> list[tuple[int, str, bytes]]:
    batches = [(batch, one) for batch in session.sectors for some in batch.messages for one in some]
    return [(batch.sector.end_ns, one.topic, one.payload) for batch, one in batches]


def test_beside_a_flood_others_are_followed_and_the_record_makes_the_same_again(
    tmp_path: Path,
) -> None:
    """As fast as the broker takes it, nine of ten messages garbage; no sector is held up."""
    sensors, path = LONG + radar("quick", period_s=1.0, sectors=32), tmp_path / "record.mcap"
    what = scene(tmp_path, telemetry=NEVER_LATE, sensors=sensors)

    def flood(ears: MqttReceiver, now_ns: int) -> None:
        for first in range(0, FLOOD, CHUNK):
            good = (report(now_ns + i * 20_000, i % 100) for i in range(first, first + CHUNK, 10))
            payloads = [p for one in good for p in (one.to_protobuf(), *[b"\xff"] * 9)]
            ears.publish_all((f"{TELEMETRY}/flood", payload) for payload in payloads)

    async def flooded(recorder: Recorder) -> AtWork:
        port, number, to = free_port(), 0, lambda: MqttReceiver(port, 5)
        with own_broker(tmp_path, port), to() as drone, to() as many:
            recording = SessionRecorder(recorder, ledger_is_sent=False)
            async with at_work(what, port, recording) as watch:
                working = asyncio.create_task(asyncio.to_thread(flood, many, watch.clock.now_ns()))
                while not (working.done() and any(len(batch.looks) for batch in watch.sectors)):
                    now_ns = watch.clock.now_ns()
                    drone.publish(f"{TELEMETRY}/quiet", report(now_ns, number).to_protobuf())
                    number += 1
                    await asyncio.sleep(0.05)
                await until(lambda: watch.received_on.count(f"{TELEMETRY}/quiet") == number)
                await watch.sectors_more(2)
        return watch

    with Recorder(path, attachments=attachments_of(what, 0), waits=True) as recorder:
        watch = asyncio.run(flooded(recorder))
    totals, intake = watch.totals, watch.session.intake
    assert {"quiet", "flood"} == set(watch.session.trajectories.names)
    assert totals.telemetry + totals.conflated + totals.refused == watch.taken + intake.given_up
    assert totals.flooded == intake.given_up > 0
    assert watch.most_waiting <= MAX_WAITING
    assert_no_sector_is_missing(watch)
    clock = InstantClock(SessionRecord.open(path).start_utc_ns)
    for_s = (watch.sectors[-1].sector.end_ns - clock.now_ns()) / S
    again = simulated(what, for_s, (), RecordedTelemetry(path), clock=clock)
    in_time = {each[:2] for each in octets(watch)}  # a machine that stalls misses some
    assert sorted(each for each in octets(again) if each[:2] in in_time) == sorted(octets(watch))
    assert sum(len(batch.looks) for batch in again.sectors) > 0


def garbage(chance: random.Random) -> Iterator[tuple[str, bytes]]:
    """Topic and payload, none of which can be taken."""
    good = json.loads(report(0).to_json())
    drone = f"{TELEMETRY}/d{chance.randrange(5)}"
    some = chance.randbytes(chance.choice((0, 1, 3, 40, 400, 4096)))
    yield drone, b"\xff" + some
    wrong: tuple[Any, ...] = (None, "x", [], {}, -1e300, True, 10**400)
    yield drone, json.dumps(good | {chance.choice([*good]): chance.choice(wrong)}).encode()
    yield drone, json.dumps(dict(chance.sample([*good.items()], len(good) - 1))).encode()
    yield drone, b'{"latitude_deg": 1' + b"[" * chance.choice((1, 2000))
    cut = report(0).to_protobuf()
    yield drone, cut[: chance.randrange(1, len(cut))] + b"\xff"
    yield drone, bytes([chance.choice((48, 129))]) + some
    yield f"{TELEMETRY}/", b"{}"
    name = "".join(map(chr, chance.choices(range(0x30, 0x2FF), k=chance.choice((70, 20_000)))))
    yield f"{TELEMETRY}/{''.join(c for c in name if c.isprintable())}", some
    yield CONTROL, some
    keys = ("sensor", "set", "reset", "clock", "x")
    command = {key: chance.choice(("radar", {}, [], {"pfa": 2}, 1, None)) for key in keys}
    yield CONTROL, json.dumps(command).encode()
    yield CONTROL, b'{"sensor": "radar", "set": ' + b'{"link": ' * chance.choice((1, 5000))
    changes = ({"pfa": 2.0}, {"id": "other"}, {"link": {"latency_ms": -1}}, {"link": {"x": 1}},
               {"scan": {"period_s": 9}}, {"pfa": float("nan")}, {"event": []})  # fmt: skip
    yield CONTROL, json.dumps({"sensor": "radar", "set": chance.choice(changes)}).encode()
    if chance.random() < 0.1:
        big = chance.choice((b"\0", b" ", b"[")) * 900_000
        yield from ((CONTROL, big), (f"{TELEMETRY}/big", big))


def test_a_minute_of_garbage_is_refused_in_lines_and_changes_nothing(tmp_path: Path) -> None:
    """Whatever it is, it is told why; what is good is still taken."""
    what = scene(tmp_path, start_utc="2026-01-01T12:00:00Z", sensors=radar(period_s=30, sectors=96))
    start_ns, asked, good = what.scene.start_utc_ns or 0, list[Asked](), 0
    for number in range(120):
        at_s = number / 2
        some = garbage(random.Random(number))  # noqa: S311 - no secret
        asked += [(at_s, topic, payload) for topic, payload in some]
        if number % 10 == 0:
            told = report(start_ns + round(at_s * S)).to_protobuf()
            asked += [(at_s, f"{TELEMETRY}/{name}", told) for name in ("good", "x" * 70)]
            asked.append((at_s, CONTROL, b'{"sensor": "radar", "set": {}}'))
            good += 2
    ran = simulated(what, 62.0, asked)
    totals = ran.totals
    assert totals.telemetry + totals.controls == good
    assert totals.refused == len(asked) - good > 1000
    assert totals.drones <= 1  # its reports are so far apart that it is gone in between
    assert ran.session.sensors["radar"].sensor == what.sensor[0]
    assert_no_sector_is_missing(ran)
    errors = ran.told("errors")
    assert all(0 < len(error["detail"]) <= MAX_DETAIL for error in errors)
    assert all(error["detail"].isprintable() for error in errors)
    assert {"undecodable", "missing", "control", "name"} <= totals.refused_by.keys()
    by_second = Counter(error["time_utc"][:19] for error in errors)
    assert 0 < max(by_second.values()) <= MAX_REFUSALS_PER_S


@pytest.mark.asyncio
async def test_a_clock_of_the_system_that_steps_back_moves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By an hour. Telemetry is taken by the session's own time."""
    now_ns, now_s = time.time_ns, time.time
    async with at_work(scene(tmp_path), None) as session:
        await session.sectors_more(2)
        before_ns = session.clock.now_ns()
        monkeypatch.setattr(time, "time_ns", lambda: now_ns() - 3600 * S)
        monkeypatch.setattr(time, "time", lambda: now_s() - 3600)
        await session.sectors_more(5)
        assert before_ns < session.clock.now_ns() < before_ns + 60 * S
        for t_ns in (session.clock.now_ns(), time.time_ns()):
            told = report(t_ns).to_protobuf()
            session.session._hear(f"{TELEMETRY}/d", told, None)
            await until(lambda: not session.session.intake)
        await session.sectors_more(2)
    assert (session.totals.telemetry, session.totals.refused_by["stale"]) == (1, 1)
    assert_no_sector_is_missing(session)
    ends_ns = [batch.sector.end_ns for batch in session.sectors]
    assert {b - a for a, b in pairwise(ends_ns)} == {6 * S // 96}
    # As late as ever: an hour neither too soon nor too late.
    assert all(0 <= one.sent_utc_ns - one.due_utc_ns < 60 * S for one in session.sent)

"""A session over a real broker that one topic floods: others are followed, a re-run is the same."""

from __future__ import annotations

import asyncio
from collections import Counter
from pathlib import Path

import pytest
from support.brokers import free_port
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork, Start, every_broker
from support.waiting import until

from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.models.state import AltitudeReference
from plotfeed.testing import MqttReceiver

S = 1_000_000_000
FLOOD = 20_000
# A broker that is itself behind with a flood may pass a report on when it is seconds old.
NEVER_LATE = "stale_after_s = 3600"


def report(t_utc_ns: int, east: int) -> bytes:
    return PositionReport.to_protobuf(
        PositionReport(
            t_utc_ns=t_utc_ns,
            latitude_deg=40.45,
            longitude_deg=-3.72 + 1e-6 * east,
            altitude_m=900.0,
            altitude_reference=AltitudeReference.ELLIPSOID,
            velocity_enu_m_s=(20.0, 0.0, 0.0),
        )
    )


def flood(ears: MqttReceiver, now_ns: int) -> None:
    for first in range(0, FLOOD, 1_000):
        numbers = range(first, first + 1_000)
        ears.publish_all(
            ("plotfeed/telemetry/flood", report(now_ns + i * 20_000, i % 100)) for i in numbers
        )


class Taken(Observer):
    """How many messages of each topic were taken out of the queue."""

    def __init__(self) -> None:
        self.by_topic = Counter[str]()

    def received(self, topic: str, *_: object) -> None:
        self.by_topic[topic] += 1


Octets = list[tuple[int, str, bytes]]


def octets(session: AtWork) -> Octets:
    return [
        (sector.sector.end_ns, one.topic, one.payload)
        for sector in session.sectors
        for outgoing in sector.messages
        for one in outgoing
    ]


@every_broker
@pytest.mark.asyncio
async def test_beside_a_flood_others_are_followed_and_the_record_makes_the_same_again(
    start: Start, tmp_path: Path
) -> None:
    text = scene_text(
        port=1883,
        drones="",
        sensors=radar(period_s=1.0, sectors=32),
        mqtt="truth = false",
        telemetry=NEVER_LATE,
    )
    scene = load(scene_file(tmp_path, text))
    port, path, clock, stop = free_port(), tmp_path / "record.mcap", WallClock(), asyncio.Event()
    watch = AtWork(clock)
    taken = Taken()
    with (
        Recorder(path, attachments=attachments_of(scene, 0), waits=True) as recorder,
        start(tmp_path, port),
        MqttReceiver(port, 5) as drone,
        MqttReceiver(port, 5) as flooder,
    ):
        observers = [watch, taken, SessionRecorder(recorder, ledger_is_sent=False)]
        broker = f"mqtt://127.0.0.1:{port}"
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(
                run(scene, clock=clock, broker=broker, stop=stop, observers=observers)
            )
            await until(watch.begins.is_set)
            flooding = tasks.create_task(asyncio.to_thread(flood, flooder, clock.now_ns()))
            number, trajectories = 0, watch.session.trajectories
            while not flooding.done() or number < 20:
                drone.publish("plotfeed/telemetry/quiet", report(clock.now_ns(), number))
                number += 1
                await asyncio.sleep(0.1)
            await flooding
            await until(lambda: taken.by_topic["plotfeed/telemetry/quiet"] == number)
            await watch.sectors_more(2)
            stop.set()
    assert {"quiet", "flood"} == set(trajectories.names)
    assert watch.totals.flooded > 0

    record = SessionRecord.open(path)
    again = AtWork(InstantClock(record.start_utc_ns))
    await run(
        scene,
        clock=again.clock,
        broker="none",
        duration_s=(watch.sectors[-1].sector.end_ns - record.start_utc_ns) / S,
        observers=[again, RecordedTelemetry(path)],
    )
    in_time = {end_ns for end_ns, _, _ in octets(watch)}  # a machine that stalls misses some
    assert [each for each in octets(again) if each[0] in in_time] == octets(watch)
    assert sum(len(sector.plots) for sector in again.sectors) > 0

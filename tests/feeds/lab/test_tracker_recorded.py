"""A session's record has what the tracker under test published, and is scored by itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto
from support.scene_files import radar, scene_file, scene_text
from support.sessions import at_work
from support.waiting import until

from plotfeed.feeds.lab.track_reports import read_tracks
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
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Stage
from plotfeed.testing import MqttReceiver

TOPIC = "tracker/out"
TRACK = {"track": 7, "latitude_deg": 40.45, "longitude_deg": -3.73}


class Followed(Observer):
    def __init__(self) -> None:
        self.heard: list[bytes] = []

    def tracked(self, _topic: str, payload: bytes, *_: object) -> None:
        self.heard.append(payload)


@pytest.mark.asyncio
async def test_tracks_are_in_the_record_and_are_no_telemetry(tmp_path: Path) -> None:
    port, path = free_port(), tmp_path / "there.mcap"
    text = scene_text(sensors=radar(), port=port) + f'[page]\ntracks_topic = "{TOPIC}"\n'
    scene, watch = load(scene_file(tmp_path, text)), Followed()
    clock = WallClock()
    with (
        mosquitto(tmp_path, port),
        Recorder(path, attachments=attachments_of(scene, clock.now_ns())) as recorder,
    ):
        recording = SessionRecorder(recorder, ledger_is_sent=scene.mqtt.truth)
        async with at_work(scene, port, recording, watch, clock=clock) as session:
            with MqttReceiver(port, 4) as client:

                def is_heard() -> bool:
                    client.publish(TOPIC, json.dumps(TRACK).encode())
                    return bool(watch.heard)

                await until(is_heard)
        totals = session.totals
    assert (totals.telemetry, totals.refused) == (0, 0)
    with McapReader(path) as log:
        messages = list(log.messages(topics={TOPIC}))
    message = messages[0]
    assert (message.stage, json.loads(message.payload)) == (Stage.TELEMETRY, TRACK)
    read = read_tracks(path, scene)
    assert list(read.names) == ["7"]
    assert read.reports.received_utc_ns.tolist() == [each.log_time_ns for each in messages]
    again = SessionRecord.open(path)
    totals = await run(
        scene,
        clock=InstantClock(again.start_utc_ns),
        broker="none",
        duration_s=1.0,
        observers=[RecordedTelemetry(path)],
    )
    assert (totals.telemetry, totals.refused) == (0, 0)


def test_a_tracker_is_asked_for_where_an_observer_follows_it_a_sensors_own_too(
    tmp_path: Path,
) -> None:
    from plotfeed.feeds.session.observer import tracker_topics

    def topics(topic: str, *observers: Observer) -> list[str]:
        text = scene_text(sensors=radar(), port=1) + f'[page]\ntracks_topic = "{topic}"\n'
        scene = load(scene_file(tmp_path, text))
        return tracker_topics(scene, observers)

    assert topics(TOPIC) == topics(TOPIC, Observer()) == []
    assert topics(TOPIC, Followed()) == [TOPIC]
    assert topics("plotfeed/radar/asterix/062", Followed()) == ["plotfeed/radar/asterix/062"]

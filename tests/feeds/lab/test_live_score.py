"""The score of a tracker while a session runs: what it is by hand, and what comes over a broker."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from support.command import running
from support.scene_files import radar as radar_of_file
from support.scene_files import scene_file, scene_text
from support.waiting import wait_until

from plotfeed.feeds.lab.live import EVERY_SECONDS, LiveScore
from plotfeed.feeds.recording.recorded_tracks import read_tracks
from plotfeed.feeds.recording.recorder import RecordedTelemetry, SessionRecord
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.schema.asyncapi import document
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.utc import NS
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Stage
from plotfeed.testing import SITE, START_NS, MqttMessage, MqttReceiver, held, radar, scene

FAR_M = 2000.0 * np.cos(np.radians(5.0))  # To drones that hover at 2 km, over the ground
Tracker = Callable[[int], list[dict[str, Any]]]


class EverySecond(Observer):
    """Has a session scored at each second of its own time, with a tracker made up."""

    def __init__(self, live: LiveScore, tracker: Tracker) -> None:
        self._live, self._tracker = live, tracker
        self._next_ns = START_NS + NS
        self.scores: list[dict[str, Any]] = []

    def before_due(self, due_utc_ns: int) -> None:
        """A second is over."""
        while due_utc_ns > self._next_ns:
            told = self._tracker(self._next_ns)
            if told:
                self._live.tracked("x", json.dumps(told).encode(), None, self._next_ns)
            found = self._live.score(self._next_ns)
            if found is not None:
                self.scores.append(found)
            self._next_ns += NS


def scored(made: Scene, seconds: float, tracker: Tracker) -> list[dict[str, Any]]:
    live = LiveScore()
    every = EverySecond(live, tracker)
    clock = InstantClock(START_NS)
    asyncio.run(run(made, clock=clock, broker="none", duration_s=seconds, observers=[live, every]))
    assert live.score(START_NS) is None  # the session is over
    return every.scores


def track(number: int, east_m: float, north_m: float, t_ns: int, **more: Any) -> dict[str, Any]:
    latitude_deg, longitude_deg, height_m = map(float, SITE.to_geodetic([east_m, north_m, 200.0]))
    return {
        "track": number,
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "height_m": height_m,
        "time_utc_ns": t_ns,
    } | more


def two() -> Scene:
    """Two drones that hover, 2 km north and 2 km east of a radar that sees both."""
    drones = [held("north", 0.0, 5.0, 2000.0), held("east", 90.0, 5.0, 2000.0)]
    return scene([radar()], drones, seed=5)


def test_figures_are_those_worked_out_by_hand() -> None:
    def tracker(now_ns: int) -> list[dict[str, Any]]:
        """One drone 3 m off, half a second late; one track of nobody; the other drone is missed."""
        late_ns = now_ns - NS // 2
        return [track(1, 3.0, FAR_M, late_ns), track(2, 700.0, 700.0, late_ns)]

    last = scored(two(), 20.0, tracker)[-1]
    now = last["now"]
    assert last["drones"] == last["tracks"] == 2
    # 3 m of localisation, and 50^2 / 2 each for the missed drone and for the false track.
    assert now["gospa_m"] == pytest.approx(np.sqrt(9.0 + 2500.0), rel=1e-3)
    assert now["ospa_m"] == pytest.approx(np.sqrt((9.0 + 2500.0) / 2), rel=1e-3)
    assert now["completeness"] == now["spuriousness"] == 0.5
    assert now["position_error_m"] == pytest.approx(3.0, abs=0.1)
    assert now["latency_s"] == pytest.approx(0.5)
    assert last["window"]["completeness"] == pytest.approx(0.5, abs=0.15)


def test_birds_are_no_drones() -> None:
    """Ten of them, which the radar sees and no track is of."""
    way = [{"east_m": 500.0, "north_m": 1000.0 + n, "above_site_m": 100.0} for n in (0.0, 900.0)]
    birds = [{"id": "gulls", "count": 10, "rcs_m2": 0.1, "path": way}]
    made = scene([radar()], [held("north", 0.0, 5.0, 2000.0)], seed=5, birds=birds)
    last = scored(made, 10.0, lambda now_ns: [track(1, 0.0, FAR_M, now_ns)])[-1]
    assert (last["drones"], last["tracks"], last["dimensions"]) == (1, 1, 2)
    assert last["now"]["completeness"] == 1.0
    assert last["now"]["gospa_m"] < 1.0


def test_a_track_goes_on_by_its_velocity_and_is_stale_after_a_while() -> None:
    def tracker(now_ns: int) -> list[dict[str, Any]]:
        """Once, 30 m short of the drone at 10 m/s."""
        first = now_ns == START_NS + 5 * NS
        moving = {"velocity_east_m_s": 0.0, "velocity_north_m_s": 10.0}
        return [track(1, 0.0, FAR_M - 30.0, now_ns, **moving)] if first else []

    errors_m = [s["now"]["position_error_m"] for s in scored(two(), 16.0, tracker)]
    assert errors_m[4] == pytest.approx(30.0, abs=0.2)
    assert errors_m[7] == pytest.approx(0.0, abs=0.2)
    assert errors_m[11] is None


def test_of_a_tracker_that_nobody_hears_there_is_no_figure() -> None:
    scores = scored(two(), 8.0, lambda _: [])
    assert {s["reports"] for s in scores} == {0}
    assert {s["problem"] for s in scores} == {"no tracks have come"}
    assert all(value is None for s in scores for k in ("now", "window") for value in s[k].values())

    def late(now_ns: int) -> list[dict[str, Any]]:
        return [track(1, 0.0, FAR_M, now_ns)] if now_ns >= START_NS + 10 * NS else []

    last = scored(two(), 20.0, late)[-1]
    assert last["problem"] == ""
    assert last["window"]["completeness"] == 0.5  # of the seconds since it is heard


def test_what_is_no_track_is_counted_and_harms_nothing() -> None:
    def tracker(now_ns: int) -> list[dict[str, Any]]:
        return [
            track(1, 0.0, 0.0, now_ns + 60 * NS),  # of the future
            track(2, 0.0, 0.0, now_ns, latitude_deg=123.0),
            track(3, 0.0, 0.0, now_ns, ended=True),
        ]

    last = scored(two(), 8.0, tracker)[-1]
    assert last["unreadable"] == 2 * last["reports"]
    assert last["tracks"] == 0
    LiveScore().tracked("x", b"\xff\x00garbage", None, START_NS)  # before any session


LATER = {"from_s": 15.0, "to_s": 60.0, "set": {"bias": {"azimuth_offset_deg": 2.0}}}


@pytest.mark.parametrize(
    ("keys", "wrong"), [({}, set()), (LATER["set"], {"azimuth"}), ({"event": [LATER]}, {"azimuth"})]
)
def test_the_feed_is_checked_and_anew_for_new_keys(keys: dict[str, Any], wrong: set[str]) -> None:
    drones = [held(f"d{i}", 60.0 * i, 5.0, 2000.0 + 100 * i, rcs_m2=1.0) for i in range(5)]
    scores = scored(scene([radar(pfa=1e-5, **keys)], drones, seed=7), 41.0, lambda _: [])
    assert len(scores) >= 2 * EVERY_SECONDS
    told = {each["check"]: each for each in scores[-1]["feed"]}
    assert told.keys() >= {"azimuth", "range", "Pd", "false alarms", "time"}
    assert {name for name, each in told.items() if each["wrong"]} == wrong
    assert abs(told["azimuth"]["found"] - 2.0 * len(wrong)) < 0.2  # of the new keys alone
    if "event" in keys:
        assert not any(each["wrong"] for s in scores[:14] for each in s["feed"])
    json.dumps(scores[-1], allow_nan=False)


# Over a broker.

OWN = "plotfeed/radar/asterix/062"


def scene_with(folder: Path, topic: str, *, truth: bool = True) -> Path:
    """One radar that turns twice a second, with tracks of its own; one drone."""
    own = radar_of_file(more='report = ["plots", "asterix-062"]\ntracks = { kind = "plain" }')
    text = scene_text(sensors=own, mqtt=f"truth = {str(truth).lower()}")
    return scene_file(folder, text + f'[page]\ntracks_topic = "{topic}"\n')


def test_a_score_is_published_as_described_and_own_tracks_recorded_once(tmp_path: Path) -> None:
    record = tmp_path / "own.mcap"
    with (
        running("run", scene_with(tmp_path, OWN), "--record", record) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/score") as client,
    ):
        found = client.wait_for(lambda message: bool(json.loads(message.payload)["tracks"]))
    told = json.loads(found.payload)
    described = document()["components"]["messages"]["score"]
    jsonschema.validate(told, described["payload"])
    jsonschema.validate(found.user_properties, described["headers"])
    assert (found.content_type, told["tracks_topic"]) == ("application/json", OWN)
    assert told["now"]["completeness"] == 1.0, told  # one drone, one track
    with McapReader(record) as log:
        stages = {message.stage for message in log.messages(topics={OWN})}
    assert stages == {Stage.BEFORE, Stage.AFTER}  # as the sensor sent it, not as telemetry


@pytest.mark.asyncio
async def test_what_a_tracker_publishes_is_recorded_and_no_telemetry(tmp_path: Path) -> None:
    """Neither meanwhile nor where the record is run again."""
    topic, record = "tracker/out", tmp_path / "theirs.mcap"
    told = {"track": 7, "latitude_deg": 40.45, "longitude_deg": -3.73}
    path = scene_with(tmp_path, topic)
    with (
        running("run", path, "--record", record) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/score") as client,
    ):

        def is_heard() -> bool:
            client.publish(topic, json.dumps(told).encode())
            return any(json.loads(payload)["reports"] for payload in client.on("plotfeed/score"))

        wait_until(is_heard)
        session.end(signal.SIGINT)
    with McapReader(record) as log:
        messages = list(log.messages(topics={topic}))
    assert {message.stage for message in messages} == {Stage.TELEMETRY}
    assert json.loads(messages[0].payload) == told
    read = read_tracks(record, load(path))
    assert list(read.names) == ["7"]
    assert read.reports.received_utc_ns.tolist() == [each.log_time_ns for each in messages]
    clock = InstantClock(SessionRecord.open(record).start_utc_ns)
    again = [RecordedTelemetry(record)]
    totals = await run(load(path), clock=clock, broker="none", duration_s=1.0, observers=again)
    assert (totals.telemetry, totals.refused) == (0, 0)


def test_where_the_truth_is_not_published_the_score_is_not(tmp_path: Path) -> None:
    with (
        running("run", scene_with(tmp_path, OWN, truth=False)) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/#") as client,
    ):
        scans: set[int] = set()

        def is_three_seconds_on(message: MqttMessage) -> bool:
            if message.topic.endswith("/plots"):
                scans.add(int(message.user_properties["scan"]))
            return len(scans) > 6  # two a second

        client.wait_for(is_three_seconds_on)
        assert not client.on("plotfeed/score")

"""Formats of tracks in a scene: the same tracks in each of them, by names that no two have."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import pytest

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.recording.record_text import Style
from plotfeed.feeds.scene.report_formats import TRACK_FORMATS
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, flown, fly, radar, rotating, scene, waypoint

DRONES = [flown(f"d{i}", waypoint(90.0 * i, 8, 900), waypoint(90.0 * i, 8, 2000)) for i in range(4)]


@pytest.fixture(scope="module")
def road() -> Feed:
    def sensor(name: str, **more: object) -> dict[str, object]:
        return radar(id=name, report=list(TRACK_FORMATS), scan=rotating(1.0, 8), **more)

    sensors = [sensor("first", tracks={"kind": "plain"}), sensor("second")]
    return fly(scene(sensors, DRONES, seed=401), 8.0)


def told_in(message: Message) -> Iterator[tuple[str, int]]:
    """Tracks that a message tells of: the sensor's name and the number."""
    sensor, _, kind = message.topic.removeprefix("plotfeed/").partition("/")
    octets = message.payload
    if kind == "asterix/062":
        yield from ((sensor, int(record.get("I062/040"))) for record in decode(octets))
        return
    if kind == "tracks":
        names = [track.id for track in pb.TrackBatch.FromString(octets).tracks]
    elif kind == "cot":
        names = [ET.fromstring(octets).attrib["uid"]]  # noqa: S314 - our own
    else:
        found = json.loads(octets)
        one_of = {
            "geojson": lambda: found["features"],
            "air-traffic": lambda: found["observations"],
            "f3411": lambda: found["flights"],
            "foxglove-geojson": lambda: json.loads(found["geojson"])["features"],
            "foxglove-location": lambda: [found],
        }[kind]
        key = {"air-traffic": "icao_address", "foxglove-location": "frame_id"}.get(kind, "id")
        names = [each[key] for each in one_of()]
    for name in names:
        whose, _, number = name.rpartition("-")
        assert whose == sensor
        yield sensor, int(number)


def test_all_formats_tell_of_the_same_tracks_and_numbers_are_of_one_sensor(road: Feed) -> None:
    tracks: dict[str, set[tuple[str, int]]] = {}
    for message in road.messages:
        kind = message.topic.removeprefix("plotfeed/").partition("/")[2]
        if kind in {"asterix/062", *TRACK_FORMATS}:
            tracks.setdefault(kind, set()).update(told_in(message))
    assert len(tracks) == len(TRACK_FORMATS)
    expected = tracks.pop("asterix/062")
    assert {sensor for sensor, _ in expected} == {"first", "second"}
    assert len({number for _, number in expected}) == len(expected) == 8
    assert all(found == expected for found in tracks.values())
    for sensor, kind_of_tracks in (("first", pb.PLAIN), ("second", pb.SMOOTHED_TRUTH)):
        batches = [pb.TrackBatch.FromString(p) for p in road.payloads(f"{sensor}/tracks")]
        assert {batch.kind for batch in batches} == {kind_of_tracks}


@pytest.mark.parametrize("kind", ["plain", "smoothed-truth"])
def test_a_sensor_that_was_off_for_a_minute_begins_its_tracks_anew(kind: str) -> None:
    off = {"from_s": 10.0, "to_s": 70.0, "set": {"enabled": False}}
    drone = flown("d", waypoint(90.0, 1, 900), waypoint(90.0, 100, 1000))
    sensor = radar(report=["asterix-062"], scan=rotating(), tracks={"kind": kind}, event=[off])
    told = [
        (message.due_utc_ns, int(record.get("I062/040")))
        for message in fly(scene([sensor], [drone], seed=401), 80.0).messages
        if message.topic.endswith("/062")
        for record in decode(message.payload)
    ]
    assert {track for due_ns, track in told if due_ns < START_NS + 20 * NS} == {1}
    later = [(due_ns, track) for due_ns, track in told if due_ns > START_NS + 20 * NS]
    assert {track for _, track in later} == {2}
    # It takes as many looks to confirm as at the first time.
    assert abs((later[0][0] - 70 * NS) - told[0][0]) <= NS


def test_show_reads_every_one_of_them_on_any_topic_of_tracks(road: Feed) -> None:
    """On the topics of sensors, and as a tracker under test would publish them."""
    known = {m.topic: m for m in road.messages if m.topic.startswith("plotfeed/first/")}
    for topic, message in known.items():
        for style in Style:
            of = message.payload, message.content_type
            lines = list(message_lines(topic, *of, style=style))
            assert lines, topic
            assert "octets that are not" not in lines[0]
    told = [m.payload for m in known.values() if m.topic.endswith(("062", *TRACK_FORMATS))]
    assert len(told) == len(TRACK_FORMATS)
    tracker = json.dumps([{"track": 1, "latitude_deg": 1.0, "longitude_deg": 2.0}]).encode()
    events = [payload for payload in told if payload[:1] == b"<"]
    for payload in [*(each for each in told if each not in events), tracker, sapient_track()]:
        for line in message_lines("tracker/tracks", payload, None, style=Style.JSON):
            shown = json.loads(line)
            assert "error" not in shown
            assert "error" not in shown["message"]


def sapient_track() -> bytes:
    from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

    message = SapientMessage(node_id="0d1b2c3d-0000-4000-8000-000000000000")
    message.timestamp.FromNanoseconds(START_NS)
    message.detection_report.report_id = "01HV3Z0000000000000000000A"
    return bytes(message.SerializeToString())

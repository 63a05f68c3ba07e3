"""Formats of tracks in a scene: the same tracks in each of them, by names that no two have."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import pytest
from support.road import Road, flown, fly, radar, rotating, scene, waypoint

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.scene.report_formats import TRACK_FORMATS
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode

DRONES = [flown(f"d{i}", waypoint(90.0 * i, 8, 900), waypoint(90.0 * i, 8, 2000)) for i in range(4)]


@pytest.fixture(scope="module")
def road() -> Road:
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
        names = {
            "geojson": lambda: [each["id"] for each in found["features"]],
            "air-traffic": lambda: [each["icao_address"] for each in found["observations"]],
            "f3411": lambda: [each["id"] for each in found["flights"]],
            "gutma": lambda: [found["exchange"]["message"]["file"]["filename"]],
            "foxglove-geojson": lambda: [
                each["id"] for each in json.loads(found["geojson"])["features"]
            ],
            "foxglove-location": lambda: [found["frame_id"]],
        }[kind]()
    for name in names:
        whose, _, number = name.rpartition("-")
        assert whose == sensor
        yield sensor, int(number)


def test_all_formats_tell_of_the_same_tracks_and_numbers_are_of_one_sensor(road: Road) -> None:
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


def test_show_reads_every_one_of_them(road: Road) -> None:
    known = {}
    for message in road.messages:
        known[message.topic] = message
    for topic, message in known.items():
        if topic.startswith("plotfeed/first/"):
            for as_json in (False, True):
                lines = list(
                    message_lines(topic, message.payload, message.content_type, as_json=as_json)
                )
                assert lines, topic
                assert "octets that are not" not in lines[0]


def test_kinds_of_tracks_are_told(road: Road) -> None:
    for sensor, kind in (("first", pb.PLAIN), ("second", pb.SMOOTHED_TRUTH)):
        batches = [pb.TrackBatch.FromString(p) for p in road.payloads(f"{sensor}/tracks")]
        assert {batch.kind for batch in batches} == {kind}

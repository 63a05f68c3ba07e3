from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from support.every_kind import scene_of, seen

from plotfeed.feeds.formats import FORMATS, Batch, SceneFormats, carries_plots
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.recording.record_text import Style
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS, TRACK_FORMATS
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.categories import CATEGORIES, PLOT_ITEMS
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.testing import START_NS, Feed, flown, fly, radar, rotating, scene, waypoint


def test_scenes_and_sensors_know_those_formats_that_are_made() -> None:
    assert FORMATS.keys() == REPORT_FORMATS.keys()
    assert all(row.facts is REPORT_FORMATS[name] for name, row in FORMATS.items())
    for keys in SENSORS.values():
        assert set(keys.formats) <= FORMATS.keys()
        assert len(set(keys.formats)) == len(keys.formats)


@pytest.mark.parametrize("name", FORMATS)
def test_what_a_format_brings_is_read_back(name: str) -> None:
    row = FORMATS[name]
    assert (row.plots_in is None) == row.facts.tells_tracks
    assert row.facts.categories.keys() <= CATEGORIES.keys()
    if row.facts.categories and not row.facts.tells_tracks:
        assert next(iter(row.facts.categories)) in PLOT_ITEMS
    assert carries_plots(f"some/prefix/radar/{row.facts.topic}")


@pytest.mark.parametrize("end", ["status", "asterix/034", "asterix/025", "settings", "truth"])
def test_topics_of_other_messages_carry_no_plots(end: str) -> None:
    assert not carries_plots(f"some/prefix/radar/{end}")


def alone(formats: SceneFormats, seen: Batch) -> list[list[Message]]:
    """What each sector has if it is worked out by itself."""
    every = [seen.rows(np.array([i])) for i in range(len(seen))]
    return [messages for one in every for messages in formats.messages(one)]


def test_sensors_of_one_pass_may_report_in_other_formats() -> None:
    first, second = scene_of("rotating", 2, ["asterix-048"], drones=0).sensor
    second = second.model_copy(update={"report": ("plots", "asterix-015")})
    made = scene_of("rotating", 2, ["asterix-048"], drones=1)
    made = made.model_copy(update={"sensor": (first, second)})
    every = seen(made, scans=1)
    plots = np.diff(every.plots_by).reshape(2, 32)
    with_drone, without = (np.add([0, 32], each.argmax(axis=1)) for each in (plots, plots == 0))
    sectors = every.rows(np.concatenate([with_drone, without]))
    messages = SceneFormats(made).messages(sectors)
    assert messages == alone(SceneFormats(made), sectors)
    kinds = [[m.topic.partition("/rotating-")[2][2:] for m in each] for each in messages]
    assert kinds == [
        ["asterix/048", "asterix/034"],
        ["plots", "asterix/015"],
        ["asterix/034"],
        ["plots"],
    ]


def test_what_some_measure_and_others_do_not_is_encoded_apart() -> None:
    made = scene_of("staring", 2, ["asterix-048"], drones=2)
    found = seen(made, scans=1)
    assert found.plots_by.tolist() == [0, 2, 4]
    height_m = found.plots.height_m.copy()
    height_m[:2] = np.nan
    without = replace(found, plots=found.plots.but(height_m=height_m))
    (first,), (second,) = SceneFormats(made).messages(without)
    assert len(first.payload) == len(second.payload) - 2 * 4  # heights and their flags
    assert [second] == SceneFormats(made).messages(found)[1]
    height_m[1] = 0.0
    with pytest.raises(EncodeError, match="NaN"):
        SceneFormats(made).messages(replace(found, plots=found.plots.but(height_m=height_m)))


def test_properties_are_those_of_cloudevents_in_their_order() -> None:
    made = scene_of("rotating", 1, ["asterix-048"])
    sector = seen(made, scans=1).rows(np.array([3]))
    ((*_, crossing),) = SceneFormats(made).messages(sector)
    scan, end_ns = int(sector.sectors.scan[0]), int(sector.sectors.end_ns[0])
    expected = (
        ("id", f"asterix-034-{scan}-3-0"),
        ("type", "plotfeed.asterix.034"),
        ("specversion", "1.0"),
        ("source", "plotfeed/rotating-0"),
        ("time", iso_utc(end_ns)),
        ("sensor", "rotating-0"),
        ("scan", str(scan)),
        ("sector", "3"),
    )
    assert crossing.properties == expected


def test_no_sectors_have_no_messages() -> None:
    made = scene_of("rotating", 2, ["asterix-048", "plots"])
    none = seen(made).rows(np.zeros(0, np.int64))
    assert SceneFormats(made).messages(none) == []


# The same tracks in each format of tracks, by names that no two have.

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


@pytest.mark.parametrize("ahead_s", [0.0, 2.0])
def test_a_track_ends_once_its_drone_is_gone_whatever_the_clock_says(ahead_s: float) -> None:
    drone = flown("d", waypoint(90.0, 8, 900), waypoint(90.0, 8, 2900), speed_m_s=50.0)
    keys = {"range_max_m": 1200.0, "bias": {"time_offset_s": ahead_s}, "scan": rotating()}
    told = fly(scene([radar(report=["asterix-062"], **keys)], [drone], seed=401), 30.0)
    assert sum(r.get("I062/080/TSE") == 1 for r in told.records("radar", 62)) == 1


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
    report = SapientMessage(node_id="0d1b2c3d-0000-4000-8000-000000000000")
    report.timestamp.FromNanoseconds(START_NS)
    report.detection_report.report_id = "01HV3Z0000000000000000000A"
    others = [payload for payload in told if payload not in events]
    for payload in [*others, tracker, report.SerializeToString()]:
        for line in message_lines("tracker/tracks", payload, None, style=Style.JSON):
            shown = json.loads(line)
            assert "error" not in shown
            assert "error" not in shown["message"]

"""Tracks as every format tells them, from files of every kind, and what is none."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from support.ledgers import written
from support.scene_files import radar, scene_file, scene_text
from support.told_tracks import NS, RADAR, T_NS, told_tracks

from plotfeed.feeds.formats.told_tracks import tracks_in
from plotfeed.feeds.lab.track_reports import UNKNOWN_NS, TracksRead, read_tracks
from plotfeed.feeds.scene.scene import load
from plotfeed.models.frames import LocalFrame
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.content_types import (
    GEOJSON,
    JSON,
    asterix_content_type,
    json_content_type,
    protobuf_content_type,
)
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.tracks.encode_tracks import cot_events, feature_collection, track_batch
from plotfeed.replay.asterix_files import RawWriter
from plotfeed.replay.pcap import PcapWriter
from plotfeed.replay.recorded import Recorded, Stage

TRACKS = told_tracks(5, np.random.default_rng(1))
SITE = LocalFrame(40.45, -3.73, 650.0)
BATCH = protobuf_content_type("plotfeed.v1.TrackBatch")
SAPIENT = protobuf_content_type("sapient_msg.bsi_flex_335_v2_0.SapientMessage")


BLOCK = TrackEncoder062(25, 10).blocks(TRACKS)[0]
STATUS = bytes([65, 0, 7, 0xC0, 25, 10, 1])  # Of the tracker, in the same datagram
OURS = track_batch(TRACKS, RADAR, 1, 0)
# Octets and how they are called; how exact places (degrees) and other values are; a name, and the
# index of a covariance with the standard deviation whose square it is, and how exact that is.
TOLD: dict[str, tuple[bytes, str, float, float, str, tuple[int, float, float] | None]] = {
    "062": (
        *(BLOCK, asterix_content_type(62), 180 / 2**25, 1.0, f"25.10.{TRACKS.track[0]}"),
        (0, TRACKS.sigma_east_m[0], 0.05),
    ),
    "062 behind 065": (STATUS + BLOCK, "", 180 / 2**25, 1.0, f"25.10.{TRACKS.track[0]}", None),
    "protobuf": (
        *(OURS, BATCH, 1e-9, 1e-6, f"radar-{TRACKS.track[0]}"),
        (2, TRACKS.sigma_up_m[0], 1e-6),
    ),
    "protobuf without a word": (OURS, "", 1e-9, 1e-6, f"radar-{TRACKS.track[0]}", None),
    "GeoJSON": (feature_collection(TRACKS, RADAR), GEOJSON, 1e-7, 0.01, "", None),
}


@pytest.mark.parametrize("name", TOLD)
def test_tracks_are_those_that_were_told_each_as_exact_as_its_format(name: str) -> None:
    payload, content_type, place_deg, other, called, spread = TOLD[name]
    found = tracks_in(payload, content_type, T_NS + NS, SITE)
    assert len(found) == len(TRACKS)
    assert found[0].name.startswith(called)
    for told, row in zip(found, range(len(TRACKS)), strict=True):
        one = {name: column[row] for name, column in vars(TRACKS).items()}
        assert told.t_utc_ns is not None
        assert abs(told.t_utc_ns - T_NS) <= NS / 128
        place = (told.latitude_deg, told.longitude_deg)
        assert place == pytest.approx((one["latitude_deg"], one["longitude_deg"]), abs=place_deg)
        assert told.height_m == pytest.approx(one["height_m"], abs=other)
        velocity = [one[n] for n in ("velocity_east_m_s", "velocity_north_m_s", "climb_m_s")]
        assert told.velocity_enu_m_s == pytest.approx(velocity, abs=0.2)
        assert told.ended == one["last"]
    if spread is not None:
        which, sigma_m, within = spread
        assert found[0].covariance_m2[which] == pytest.approx(sigma_m**2, rel=within)


def test_asterix_062_by_x_and_y_counts_from_the_site() -> None:
    """SAC 1, SIC 2, time, X 1000 m, Y -500 m, track 7: FSPEC 010, 070, 100 and 040."""
    x, y = (2000).to_bytes(3, "big"), (-1000).to_bytes(3, "big", signed=True)
    body = bytes.fromhex("9508") + bytes([1, 2]) + (43_200 * 128).to_bytes(3, "big") + x + y
    body += (7).to_bytes(2, "big")
    block = bytes([62]) + (3 + len(body)).to_bytes(2, "big") + body
    (told,) = tracks_in(block, "", T_NS, SITE)
    enu_m = SITE.from_ecef(LocalFrame(told.latitude_deg, told.longitude_deg, 650.0).origin_ecef_m)
    assert enu_m[:2] == pytest.approx([1000.0, -500.0], abs=0.2)
    assert tracks_in(block, "", T_NS, None) == []


def test_sapient() -> None:
    from sapient_msg.bsi_flex_335_v2_0.location_pb2 import Location
    from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

    message = SapientMessage(node_id="a-node")
    message.timestamp.FromNanoseconds(T_NS // 1000 * 1000)
    report = message.detection_report
    report.object_id = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
    report.location.x, report.location.y, report.location.z = -3.5, 40.25, 700.0
    report.location.y_error = 1e-4
    report.location.coordinate_system = 1
    report.location.datum = 1
    report.enu_velocity.east_rate = 3.0
    report.enu_velocity.north_rate = -4.0
    for content_type in (SAPIENT, ""):
        (told,) = tracks_in(message.SerializeToString(), content_type, 0, None)
        assert (told.name, told.t_utc_ns) == (report.object_id, T_NS // 1000 * 1000)
        assert (told.latitude_deg, told.longitude_deg) == pytest.approx((40.25, -3.5))
        assert told.height_m == pytest.approx(700.0)
        assert told.velocity_enu_m_s[:2] == pytest.approx((3.0, -4.0))
        assert told.covariance_m2[1] ** 0.5 == pytest.approx(11.1, abs=0.1)
    report.location.datum = 2
    (told,) = tracks_in(message.SerializeToString(), SAPIENT, 0, None)
    assert told.height_m == pytest.approx(751.0, abs=3.0)  # sea level near Madrid
    report.location.coordinate_system = 5
    with pytest.raises(DecodeError, match="UTM"):
        tracks_in(message.SerializeToString(), SAPIENT, 0, None)
    report.location.CopyFrom(Location())
    assert tracks_in(message.SerializeToString(), SAPIENT, 0, None) == []


@pytest.mark.parametrize(
    ("payload", "why"),
    [
        (b"", "neither"),
        (b"{", "not JSON"),
        (b"[1]", "an object each"),
        (b'{"latitude_deg": 1, "longitude_deg": 2}', "track: expected"),
        (b'{"track": 1, "latitude_deg": "x", "longitude_deg": 2}', "latitude_deg: expected"),
        (b'{"track": 1, "latitude_deg": 1, "longitude_deg": 2, "time_utc": "noon"}', "time_utc"),
        (b'{"type": "Feature", "geometry": {"type": "Polygon"}}', "Point or a LineString"),
        (b'{"type": "Feature", "geometry": {"type": "Point", "coordinates": [1]}}', "a place is"),
        (
            b'{"type": "Feature", "geometry": {"type": "LineString", "coordinates": [[1, 2]]}}',
            "time",
        ),
        (b"<?xml version='1.0'?><a/>", "without an event"),
        (b"\x3e\x00\x02", "header"),
        (b"\xff" * 9, "neither"),
        (b" " * (1 << 20) + b"{", "at most"),
    ],
)
def test_what_is_no_track_is_refused(payload: bytes, why: str) -> None:
    with pytest.raises(DecodeError, match=why):
        tracks_in(payload, "", T_NS, SITE)


# Files.


def message(payload: bytes, topic: str, content_type: str, at_ns: int = T_NS) -> Recorded:
    return Recorded(
        topic=topic,
        payload=payload,
        log_time_ns=at_ns,
        publish_time_ns=at_ns,
        content_type=content_type,
    )


OF_062 = message(BLOCK, "tracker/out", asterix_content_type(62), T_NS + NS)


def are_those(read: TracksRead, received_ns: int = T_NS + NS) -> None:
    assert len(read.reports) == len(read.names) == len(TRACKS)
    assert read.reports.latitude_deg == pytest.approx(TRACKS.latitude_deg, abs=1e-5)
    assert (read.reports.received_utc_ns == received_ns).all()


def test_of_a_recording_what_a_tracker_published_is_taken(tmp_path: Path) -> None:
    """On the only topic that has any; what sensors handed to links, or is damaged, is none."""
    other = message(b"{}", "tracker/other", "application/json")
    damaged = OF_062._replace(payload=BLOCK[:-1])
    before = OF_062._replace(stage=Stage.BEFORE)
    read = read_tracks(written(tmp_path / "x.mcap", [before, OF_062, other, damaged, damaged]))
    are_those(read)
    assert read.source == "x.mcap: tracker/out"
    assert [*read.unreadable.values()] == [2]
    with pytest.raises(PlotfeedError, match="no tracks: expected ASTERIX 062"):
        read_tracks(written(tmp_path / "x.mcap", [other]))


def test_of_several_topics_one_is_chosen(tmp_path: Path) -> None:
    batch = message(track_batch(TRACKS, RADAR, 1, 0), "plotfeed/radar/tracks", BATCH, T_NS + NS)
    path = written(tmp_path / "x.mcap", [OF_062, batch])
    with pytest.raises(PlotfeedError, match=r"tracks are on 2 topics.*--topic"):
        read_tracks(path)
    are_those(read_tracks(path, topics=["tracker/#"]))
    assert read_tracks(path, topics=["+/radar/tracks"]).names[0].startswith("radar-")
    text = scene_text(sensors=radar()) + '[page]\ntracks_topic = "tracker/out"\n'
    are_those(read_tracks(path, load(scene_file(tmp_path, text))))
    assert len(read_tracks(path, topics=["nobody"]).reports) == 0


@pytest.mark.parametrize("name", ["x.pcap", "x.ast"])
def test_asterix_in_other_containers(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with path.open("wb") as file:
        writer = PcapWriter(file) if name.endswith("pcap") else RawWriter(file)
        sent = message(BLOCK, "udp/127.0.0.1/8600", asterix_content_type(62), T_NS + NS)
        assert writer.write(sent) is None
        writer.close()
    day_ns = 86_400 * NS
    read = read_tracks(path, date_utc_ns=T_NS // day_ns * day_ns)
    assert len(read.reports) == len(TRACKS)
    assert (np.abs(read.reports.t_utc_ns - T_NS) <= NS / 128).all()
    # A raw file tells when reports hold, and not when they came: that is no latency of 0.
    is_known = read.reports.received_utc_ns != UNKNOWN_NS
    assert is_known.all() == is_known.any() == name.endswith("pcap")


CSV = """\
track,time_utc,latitude_deg,longitude_deg,height_m,velocity_east_m_s,velocity_north_m_s,received_utc
7,2026-01-01T12:00:00Z,40.45,-3.73,700,1.5,-2,2026-01-01T12:00:00.25Z
7,2026-01-01T12:00:01Z,40.46,-3.73,,,,2026-01-01T12:00:01.25Z
eight,1767268802.5,40.47,-3.73,710,0,0,1767268802.75
7,noon,40.46,-3.73,,,,
"""


def test_a_table(tmp_path: Path) -> None:
    for text, name in ((CSV, "x.csv"), (CSV.replace(",", "\t"), "x.tsv")):
        path = tmp_path / name
        path.write_text("\ufeff" + text)
        read = read_tracks(path)
        assert list(read.names) == ["7", "eight"]
        assert read.reports.track.tolist() == [0, 0, 1]
        assert read.reports.t_utc_ns[2] == 1_767_268_802_500_000_000
        assert read.reports.received_utc_ns[0] == 1_767_268_800_250_000_000
        assert np.isnan(read.reports.height_m).tolist() == [False, True, False]
        assert sum(read.unreadable.values()) == 1


def test_cursor_on_target(tmp_path: Path) -> None:
    """What is written for TAK, and an event of others with a point of no height."""
    events = cot_events(TRACKS, RADAR)
    for payload in (events[0], b"\n".join(events)):
        found = tracks_in(payload, "", T_NS, None)
        assert found[0].latitude_deg == pytest.approx(TRACKS.latitude_deg[0], abs=1e-6)
        assert found[0].height_m == pytest.approx(TRACKS.height_m[0], abs=0.1)
        assert abs(found[0].t_utc_ns - T_NS) < 2_000_000
        assert math.hypot(*found[0].velocity_enu_m_s[:2]) == pytest.approx(
            math.hypot(TRACKS.velocity_east_m_s[0], TRACKS.velocity_north_m_s[0]), abs=0.1
        )
    path = tmp_path / "x.xml"
    path.write_text(
        '<?xml version="1.0"?><event uid="a&amp;b" time="2026-01-01T12:00:00Z" '
        "start='2026-01-01T12:00:00Z' stale='2026-01-01T12:00:09Z'>"
        '<point lat="40.5" lon="-3.7" hae="9999999" ce="10" le="9999999"/></event>'
    )
    read = read_tracks(path)
    assert list(read.names) == ["a&b"]
    assert np.isnan(read.reports.height_m).all()
    assert read.reports.covariance_m2[0, 0, 0] == 25.0
    assert not read.reports.ended.any()


JSON_OF_THE_PAGE = json.dumps(
    [
        {"track": 12, "latitude_deg": 40.46, "longitude_deg": -3.72, "velocity_east_m_s": 8.1,
         "velocity_north_m_s": -3.0, "time_utc": "2026-01-01T12:00:00.5Z", "tentative": True},
        {"track": "b", "latitude_deg": 40.46, "longitude_deg": -3.72, "height_m": 700,
         "speed_m_s": 5.0, "course_deg": 90.0, "sigma_east_m": 2.0, "sigma_north_m": 3.0,
         "ended": True},
    ]
).encode()  # fmt: skip


def test_json_of_the_page() -> None:
    one, other = tracks_in(JSON_OF_THE_PAGE, json_content_type("x"), T_NS, None)
    assert (one.name, one.t_utc_ns, one.tentative) == ("12", 1_767_268_800_500_000_000, True)
    assert one.velocity_enu_m_s[:2] == (8.1, -3.0)
    assert (other.name, other.t_utc_ns, other.ended) == ("b", None, True)
    assert other.velocity_enu_m_s[:2] == pytest.approx((5.0, 0.0), abs=1e-12)
    assert (*other.covariance_m2[:2], other.covariance_m2[3]) == (4.0, 9.0, 0.0)


LINE = (
    b'{"type": "Feature", "id": 7, "properties": {"coordTimes": ["2026-01-01T12:00:00Z", '
    b'"2026-01-01T12:00:01Z"]}, "geometry": {"type": "LineString", "coordinates": '
    b"[[-3.73, 40.45, 700], [-3.73, 40.46, 701]]}}"
)


@pytest.mark.parametrize(
    ("name", "octets", "heights"),
    [
        ("x.geojson", LINE, [700, 701]),
        (
            "x.geojson",
            b'{"type": "Feature", "properties": {"track": 7, "time": "2026-01-01T12:00:00Z"}, '
            b'"geometry": {"type": "Point", "coordinates": [-3.73, 40.45, 700]}}',
            [700],
        ),
        (
            "x.jsonl",
            b'{"id": "7", "time_utc": 1767268800, "latitude_deg": 40.45, "longitude_deg": -3.73, '
            b'"height_m": 700}\n{"id": "7", "time": "2026-01-01T12:00:01Z", "latitude_deg": 40.45, '
            b'"longitude_deg": -3.73, "height_m": 701}\n',
            [700, 701],
        ),
        (
            "x.csv",
            b"id,time,latitude_deg,longitude_deg,height_m\n7,2026-01-01T12:00:00Z,40.45,-3.73,700\n",
            [700],
        ),
    ],
)
def test_lines_and_points_as_others_write_them(
    tmp_path: Path, name: str, octets: bytes, heights: list[float]
) -> None:
    path = tmp_path / name
    path.write_bytes(octets)
    read = read_tracks(path)
    assert list(read.names) == ["7"]
    assert read.reports.height_m.tolist() == heights
    assert (read.reports.received_utc_ns == UNKNOWN_NS).all()
    assert read.reports.t_utc_ns[0] == 1_767_268_800 * NS
    assert not read.unreadable


def sapient() -> bytes:
    from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

    told = SapientMessage(node_id="n")
    told.timestamp.FromNanoseconds(T_NS // 1000 * 1000)
    told.detection_report.object_id = "7"
    place = told.detection_report.location
    place.x, place.y, place.coordinate_system, place.datum = -3.7, 40.5, 1, 1
    return bytes(told.SerializeToString())


ONE = b'{"id": 7, "time": 1767268800, "latitude_deg": 40.45, "longitude_deg": -3.73}'


@pytest.mark.parametrize(("octets", "kind"), [(ONE, JSON), (LINE, JSON), (None, SAPIENT)])
def test_what_others_publish_is_found_without_a_topic(
    tmp_path: Path, octets: bytes | None, kind: str
) -> None:
    """JSON need not name a `track`; what has no place is none, nor is what our sensors send."""
    others = message(octets or sapient(), "other/tracks", kind)
    beat = message(b'{"id": "tracker", "state": "well"}', "other/status", JSON)
    own = others._replace(topic="plotfeed/radar/own")
    scene = load(scene_file(tmp_path, scene_text(sensors=radar())))
    read = read_tracks(written(tmp_path / "x.mcap", [beat, others, own]), scene)
    assert (read.source, list(read.names)) == ("x.mcap: other/tracks", ["7"])


def test_an_entry_that_cannot_be_read_spoils_no_other(tmp_path: Path) -> None:
    both = message(b"[" + ONE + b', {"latitude_deg": 40.45}]', "tracker/out", JSON)
    read = read_tracks(written(tmp_path / "x.mcap", [both, both]), topics=["tracker/out"])
    assert len(read.reports) == 2
    assert read.unreadable == {"track: expected a number or a name": 2}


@pytest.mark.parametrize(
    ("name", "octets", "why"),
    [
        ("x.csv", bytes(range(256)) * 4, "expected columns track|line"),
        ("x.geojson", bytes(range(256)) * 4, "not JSON"),
        ("x.xml", bytes(range(256)) * 4, "not JSON"),
        ("x.jsonl", bytes(range(256)) * 4, "not JSON"),
        ("x.csv", b"", "expected columns"),
        ("x.csv", b"a,b\n1,2\n", "expected columns track"),
        ("x.geojson", b"{", "not JSON"),
        ("x.json", b"[1]", "an object each"),
        ("x.mcap", b"nothing", "no recording that is known|expected an MCAP"),
        ("x.txt", b"nothing at all", "no recording that is known"),
    ],
)
def test_a_file_that_is_none_is_refused_in_a_line(
    tmp_path: Path, name: str, octets: bytes, why: str
) -> None:
    path = tmp_path / name
    path.write_bytes(octets)
    with pytest.raises(PlotfeedError, match=why) as refused:
        read_tracks(path)
    assert "\n" not in str(refused.value)

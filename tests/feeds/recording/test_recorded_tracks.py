"""Tracks as every format tells them, from files of every kind, and what is none."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.ledgers import written
from support.recordings import block, message
from support.scene_files import radar, scene_file, scene_text
from support.told_tracks import NS, RADAR, T_NS, told_tracks

from plotfeed.feeds.formats.told_tracks import tracks_in
from plotfeed.feeds.recording.recorded_tracks import UNKNOWN_NS, TracksRead, read_tracks
from plotfeed.feeds.scene.scene import load
from plotfeed.models.frames import LocalFrame
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.content_types import (
    COT,
    GEOJSON,
    JSON,
    SAPIENT_MESSAGE,
    TRACK_BATCH,
    asterix_content_type,
    protobuf_content_type,
)
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.tracks.encode_tracks import cot_events, feature_collection, track_batch
from plotfeed.replay.asterix_files import RawWriter
from plotfeed.replay.pcap import PcapWriter
from plotfeed.replay.recorded import Recorded, Stage

TRACKS = told_tracks(5, np.random.default_rng(1))
SITE = LocalFrame(40.45, -3.73, 650.0)
OF_062, BATCH = asterix_content_type(62), protobuf_content_type(TRACK_BATCH)
SAPIENT = protobuf_content_type(SAPIENT_MESSAGE)
BLOCK = TrackEncoder062(25, 10).blocks(TRACKS)[0]
STATUS = bytes([65, 0, 7, 0xC0, 25, 10, 1])  # Of the tracker, in the same datagram
OURS = track_batch(TRACKS, RADAR, 1, 0)
EVENTS = b"\n".join(cot_events(TRACKS, RADAR))
NUMBER = TRACKS.track[0]
# Octets and how they are called; how exact places (degrees) and other values are; a name, and the
# index of a covariance with the standard deviation whose square it is, and how exact that is.
TOLD: dict[str, tuple[bytes, str, float, float, str, tuple[int, float, float] | None]] = {
    "062": (
        *(BLOCK, OF_062, 180 / 2**25, 1.0, f"25.10.{NUMBER}"),
        (0, TRACKS.sigma_east_m[0], 0.05),
    ),
    "062 behind 065": (STATUS + BLOCK, "", 180 / 2**25, 1.0, f"25.10.{NUMBER}", None),
    "protobuf": (*(OURS, BATCH, 1e-9, 1e-6, f"radar-{NUMBER}"), (2, TRACKS.sigma_up_m[0], 1e-6)),
    "protobuf without a word": (OURS, "", 1e-9, 1e-6, f"radar-{NUMBER}", None),
    "GeoJSON": (feature_collection(TRACKS, RADAR), GEOJSON, 1e-7, 0.01, "", None),
    "Cursor on Target": (
        *(EVENTS, COT, 1e-6, 0.1, f"radar-{NUMBER}"),
        (2, TRACKS.sigma_up_m[0], 1e-3),
    ),
}


@pytest.mark.parametrize("name", TOLD)
def test_tracks_are_those_that_were_told_each_as_exact_as_its_format(name: str) -> None:
    payload, content_type, place_deg, other, called, spread = TOLD[name]
    found = tracks_in(payload, content_type, T_NS + NS, SITE)
    assert len(found) == len(TRACKS)
    assert found[0].name.startswith(called)
    for row, told in enumerate(found):
        one = {name: column[row] for name, column in vars(TRACKS).items()}
        assert told.t_utc_ns is not None
        assert abs(told.t_utc_ns - T_NS) <= NS / 128
        place = (told.latitude_deg, told.longitude_deg)
        assert place == pytest.approx((one["latitude_deg"], one["longitude_deg"]), abs=place_deg)
        assert told.height_m == pytest.approx(one["height_m"], abs=other)
        *level, up_m_s = (one[n] for n in ("velocity_east_m_s", "velocity_north_m_s", "climb_m_s"))
        velocity = (*level, math.nan if content_type == COT else up_m_s)
        assert told.velocity_enu_m_s == pytest.approx(velocity, abs=0.2, nan_ok=True)
        assert told.ended == one["last"]
    if spread is not None:
        which, sigma_m, within = spread
        assert found[0].covariance_m2[which] == pytest.approx(sigma_m**2, rel=within)


def test_asterix_062_by_x_and_y_counts_from_the_site() -> None:
    """SAC 1, SIC 2, time, X 1000 m, Y -500 m, track 7: FSPEC 010, 070, 100 and 040."""
    of_062 = block(62, "9508", "0102", f"{43_200 * 128:06x}", f"{2000:06x}", "fffc18", "0007")
    (told,) = tracks_in(of_062, "", T_NS, SITE)
    enu_m = SITE.from_ecef(LocalFrame(told.latitude_deg, told.longitude_deg, 650.0).origin_ecef_m)
    assert enu_m[:2] == pytest.approx([1000.0, -500.0], abs=0.2)
    assert tracks_in(of_062, "", T_NS, None) == []


def sapient(**place: float) -> bytes:
    """A detection report, by angles above the ellipsoid unless its place says otherwise."""
    from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

    told = SapientMessage(node_id="a-node")
    told.timestamp.FromNanoseconds(T_NS // 1000 * 1000)
    report = told.detection_report
    report.object_id = "7"
    report.enu_velocity.east_rate, report.enu_velocity.north_rate = 3.0, -4.0
    where = {"x": -3.5, "y": 40.25, "z": 700.0, "y_error": 1e-4, "coordinate_system": 1, "datum": 1}
    for name, value in (where | place).items():
        setattr(report.location, name, value)
    return bytes(told.SerializeToString())


def test_sapient() -> None:
    for content_type in (SAPIENT, ""):
        (told,) = tracks_in(sapient(), content_type, 0, None)
        assert (told.name, told.t_utc_ns) == ("7", T_NS // 1000 * 1000)
        assert (told.latitude_deg, told.longitude_deg) == pytest.approx((40.25, -3.5))
        assert told.height_m == pytest.approx(700.0)
        assert told.velocity_enu_m_s[:2] == pytest.approx((3.0, -4.0))
        assert told.covariance_m2[1] ** 0.5 == pytest.approx(11.1, abs=0.1)
    (told,) = tracks_in(sapient(datum=2), SAPIENT, 0, None)
    assert told.height_m == pytest.approx(751.0, abs=3.0)  # sea level near Madrid
    with pytest.raises(DecodeError, match="UTM"):
        tracks_in(sapient(coordinate_system=5), SAPIENT, 0, None)
    assert tracks_in(sapient(coordinate_system=0), SAPIENT, 0, None) == []


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


# Recordings.


def heard(payload: bytes, topic: str, content_type: str) -> Recorded:
    return message(payload, T_NS + NS, topic=topic, content_type=content_type)


OF_A_TRACKER = heard(BLOCK, "tracker/out", OF_062)


def are_those(read: TracksRead) -> None:
    assert len(read.reports) == len(read.names) == len(TRACKS)
    assert read.reports.latitude_deg == pytest.approx(TRACKS.latitude_deg, abs=1e-5)
    assert (read.reports.received_utc_ns == T_NS + NS).all()


def test_of_a_recording_what_a_tracker_published_is_taken(tmp_path: Path) -> None:
    """On the only topic that has any; what sensors handed to links, or is damaged, is none."""
    path = tmp_path / "x.mcap"
    other = heard(b"{}", "tracker/other", JSON)
    damaged = OF_A_TRACKER._replace(payload=BLOCK[:-1])
    before = OF_A_TRACKER._replace(stage=Stage.BEFORE)
    read = read_tracks(written(path, [before, OF_A_TRACKER, other, damaged, damaged]))
    are_those(read)
    assert read.source == "x.mcap: tracker/out"
    assert [*read.unreadable.values()] == [2]
    with pytest.raises(PlotfeedError, match="no tracks: expected ASTERIX 062"):
        read_tracks(written(path, [other]))


def test_of_several_topics_one_is_chosen(tmp_path: Path) -> None:
    batch = heard(OURS, "plotfeed/radar/tracks", BATCH)
    path = written(tmp_path / "x.mcap", [OF_A_TRACKER, batch])
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
        assert writer.write(heard(BLOCK, "udp/127.0.0.1/8600", OF_062)) is None
        writer.close()
    day_ns = 86_400 * NS
    read = read_tracks(path, date_utc_ns=T_NS // day_ns * day_ns)
    assert len(read.reports) == len(TRACKS)
    assert (np.abs(read.reports.t_utc_ns - T_NS) <= NS / 128).all()
    # A raw file tells when reports hold, and not when they came: that is no latency of 0.
    is_known = read.reports.received_utc_ns != UNKNOWN_NS
    assert is_known.all() == is_known.any() == name.endswith("pcap")


ONE = b'{"id": 7, "time": 1767268800, "latitude_deg": 40.45, "longitude_deg": -3.73}'
LINE = (
    b'{"type": "Feature", "id": 7, "properties": {"coordTimes": ["2026-01-01T12:00:00Z", '
    b'"2026-01-01T12:00:01Z"]}, "geometry": {"type": "LineString", "coordinates": '
    b"[[-3.73, 40.45, 700], [-3.73, 40.46, 701]]}}"
)


@pytest.mark.parametrize(("octets", "kind"), [(ONE, JSON), (LINE, JSON), (None, SAPIENT)])
def test_what_others_publish_is_found_without_a_topic(
    tmp_path: Path, octets: bytes | None, kind: str
) -> None:
    """JSON need not name a `track`; what has no place is none, nor is what our sensors send."""
    others = heard(octets or sapient(), "other/tracks", kind)
    beat = heard(b'{"id": "tracker", "state": "well"}', "other/status", JSON)
    own = others._replace(topic="plotfeed/radar/own")
    scene = load(scene_file(tmp_path, scene_text(sensors=radar())))
    read = read_tracks(written(tmp_path / "x.mcap", [beat, others, own]), scene)
    assert (read.source, list(read.names)) == ("x.mcap: other/tracks", ["7"])


def test_an_entry_that_cannot_be_read_spoils_no_other(tmp_path: Path) -> None:
    both = heard(b"[" + ONE + b', {"latitude_deg": 40.45}]', "tracker/out", JSON)
    read = read_tracks(written(tmp_path / "x.mcap", [both, both]), topics=["tracker/out"])
    assert len(read.reports) == 2
    assert read.unreadable == {"track: expected a number or a name": 2}


# Tables and texts, as others write them.

NOON_NS, NAN = 1_767_268_800 * NS, math.nan
CSV = b"""\xef\xbb\xbf\
track,time_utc,latitude_deg,longitude_deg,height_m,velocity_east_m_s,velocity_north_m_s,received_utc
7,2026-01-01T12:00:00Z,40.45,-3.73,700,1.5,-2,2026-01-01T12:00:00.25Z
7,2026-01-01T12:00:01Z,40.46,-3.73,,,,2026-01-01T12:00:01.25Z
eight,1767268802.5,40.47,-3.73,710,0,0,1767268802.75
7,noon,40.46,-3.73,,,,
"""
OF_CSV = {
    "track": [0, 0, 1],
    "t_utc_ns": [NOON_NS, NOON_NS + NS, NOON_NS + 5 * NS // 2],
    "received_utc_ns": [NOON_NS + NS // 4, NOON_NS + 5 * NS // 4, NOON_NS + 11 * NS // 4],
    "height_m": [700, NAN, 710],
    "velocity_enu_m_s": [[1.5, -2, NAN], [NAN] * 3, [0, 0, NAN]],
}
JSON_OF_THE_PAGE = json.dumps(
    [
        {"track": 12, "latitude_deg": 40.46, "longitude_deg": -3.72, "velocity_east_m_s": 8.1,
         "velocity_north_m_s": -3.0, "time_utc": "2026-01-01T12:00:00.5Z", "tentative": True},
        {"track": "b", "latitude_deg": 40.46, "longitude_deg": -3.72, "height_m": 700,
         "speed_m_s": 5.0, "course_deg": 90.0, "sigma_east_m": 2.0, "sigma_north_m": 3.0,
         "ended": True},
    ]
).encode()  # fmt: skip
POINT = (
    b'{"type": "Feature", "properties": {"track": 7, "time": "2026-01-01T12:00:00Z"}, '
    b'"geometry": {"type": "Point", "coordinates": [-3.73, 40.45, 700]}}'
)
LINES = (
    b'{"id": "7", "time_utc": 1767268800, "latitude_deg": 40.45, "longitude_deg": -3.73, '
    b'"height_m": 700}\n{"id": "7", "time": "2026-01-01T12:00:01Z", "latitude_deg": 40.46, '
    b'"longitude_deg": -3.73, "height_m": 701}\n'
)
IDS = b"id,time,latitude_deg,longitude_deg,height_m\n7,2026-01-01T12:00:00Z,40.45,-3.73,700\n"
EVENT = (
    b'<?xml version="1.0"?><event uid="a&amp;b" time="2026-01-01T12:00:00Z" '
    b"start='2026-01-01T12:00:00Z' stale='2026-01-01T12:00:09Z'>"
    b'<point lat="40.5" lon="-3.7" hae="9999999" ce="10" le="9999999"/></event>'
)
OF_LINE = {"latitude_deg": [40.45, 40.46], "t_utc_ns": [NOON_NS, NOON_NS + NS],
           "height_m": [700, 701], "received_utc_ns": [UNKNOWN_NS] * 2}  # fmt: skip
OF_POINT = {name: values[:1] for name, values in OF_LINE.items()}


@pytest.mark.parametrize(
    ("name", "octets", "names", "columns"),
    [
        ("x.csv", CSV, ["7", "eight"], OF_CSV),
        ("x.tsv", CSV.replace(b",", b"\t"), ["7", "eight"], OF_CSV),
        ("x.csv", IDS, ["7"], OF_POINT),
        ("x.geojson", LINE, ["7"], OF_LINE),
        ("x.geojson", POINT, ["7"], OF_POINT),
        ("x.jsonl", LINES, ["7"], OF_LINE),
        (
            *("x.json", JSON_OF_THE_PAGE, ["12", "b"]),
            {
                "t_utc_ns": [NOON_NS + NS // 2, UNKNOWN_NS],
                "velocity_enu_m_s": [[8.1, -3.0, NAN], [5.0, 0.0, NAN]],
                "covariance_m2": [[[NAN] * 3] * 3, [[4, 0, 0], [0, 9, 0], [0, 0, NAN]]],
                "tentative": [True, False],
                "ended": [False, True],
            },
        ),
        (
            *("x.xml", EVENT, ["a&b"]),
            {
                "t_utc_ns": [NOON_NS],
                "height_m": [NAN],
                "covariance_m2": [[[100, 0, 0], [0, 100, 0], [0, 0, NAN]]],
                "ended": [False],
            },
        ),
    ],
)
def test_what_others_write_is_read_as_they_mean_it(
    tmp_path: Path, name: str, octets: bytes, names: list[str], columns: dict[str, Any]
) -> None:
    path = tmp_path / name
    path.write_bytes(octets)
    read = read_tracks(path)
    assert list(read.names) == names
    for column, values in columns.items():
        np.testing.assert_allclose(getattr(read.reports, column), values, rtol=0, atol=1e-12)
    assert sum(read.unreadable.values()) == (columns is OF_CSV)


@pytest.mark.parametrize(
    ("name", "octets", "why"),
    [
        ("x.csv", bytes(range(256)) * 4, "expected columns track|line"),
        ("x.geojson", bytes(range(256)) * 4, "not JSON"),
        ("x.xml", bytes(range(256)) * 4, "not JSON"),
        ("x.jsonl", bytes(range(256)) * 4, "not JSON"),
        ("x.csv", b"", "expected columns"),
        ("x.csv", b"a,b\n1,2\n", "expected columns track"),
        ("x.json", b"[1]", "an object each"),
        ("x.mcap", b"nothing", "no recording that is known|expected an MCAP"),
        ("x.txt", b"nothing at all", "no recording that is known"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, name: str, octets: bytes, why: str) -> None:
    path = tmp_path / name
    path.write_bytes(octets)
    with pytest.raises(PlotfeedError, match=why) as refused:
        read_tracks(path)
    assert "\n" not in str(refused.value)

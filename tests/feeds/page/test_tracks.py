from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.asterix_input import tracks
from support.page_updates import Frame, read_frame

from plotfeed import testing
from plotfeed.feeds.lab.track_reports import MAX_OCTETS, ToldTrack
from plotfeed.feeds.page.shown import MAX_TRACKS, ShownTracks, tracks_to_show
from plotfeed.feeds.page.updates import SectionKind, TrackFlag
from plotfeed.feeds.page.view import View
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.content_types import TRACK_BATCH, protobuf_content_type
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import DAY_NS

NOW_NS = testing.START_NS
HERE = {"track": 7, "latitude_deg": 40.46, "longitude_deg": -3.72}


def decoded(message: Any) -> list[ToldTrack]:
    return tracks_to_show(json.dumps(message).encode(), None, NOW_NS, testing.SITE)


def of_062(source: int = 1, **columns: Any) -> bytes:
    (block,) = TrackEncoder062(source, 2).blocks(tracks(**columns))
    return block


def shown(*payloads: bytes) -> Frame:
    """What the page is told of messages."""
    view = View()
    view.scene(testing.scene([testing.radar()], seed=1))
    view.update(NOW_NS, 0.0)
    for payload in payloads:
        view.tracks(tracks_to_show(payload, None, NOW_NS, testing.SITE))
    return read_frame(view.update(NOW_NS, 0.0).public)


def test_tracks_of_category_062_are_where_they_say() -> None:
    block = of_062(
        track=np.array([3, 4]),
        t_utc_ns=np.array([NOW_NS - 10**9, NOW_NS]),
        latitude_deg=40.5,
        longitude_deg=-3.7,
        velocity_east_m_s=np.array([10.0, -20.0]),
        velocity_north_m_s=5.0,
        tentative=np.array([True, False]),
        coasted=np.array([False, True]),
        last=np.array([False, True]),
    )
    frame = shown(block)
    assert frame.column(SectionKind.TRACKS, "track").tolist() == [3, 4]
    t_utc_ms = frame.column(SectionKind.TRACKS, "t_utc_ms")
    assert np.abs(t_utc_ms - [NOW_NS / 1e6 - 1e3, NOW_NS / 1e6]).max() < 10
    assert frame.column(SectionKind.TRACKS, "velocity_east_m_s").tolist() == [10.0, -20.0]
    flags = frame.column(SectionKind.TRACKS, "flags").tolist()
    assert flags == [TrackFlag.TENTATIVE, TrackFlag.COASTED | TrackFlag.ENDED]
    told = tracks_to_show(block, None, NOW_NS, testing.SITE)
    np.testing.assert_allclose([each.latitude_deg for each in told], 40.5, atol=1e-5)


@pytest.mark.parametrize("seconds", [-30.0, 30.0])
def test_times_of_day_are_of_the_nearest_day(seconds: float) -> None:
    midnight_ns = NOW_NS // DAY_NS * DAY_NS
    then_ns = midnight_ns - round(seconds * 1e9)
    (block,) = TrackEncoder062(1, 2).blocks(tracks(t_utc_ns=then_ns))
    (told,) = tracks_to_show(block, None, midnight_ns + round(seconds * 1e9), testing.SITE)
    assert abs((told.t_utc_ns or 0) - then_ns) < 10**7


def test_tracks_of_json_are_one_or_several() -> None:
    (here,) = decoded(HERE)
    assert here.t_utc_ns == NOW_NS
    assert np.isnan(here.velocity_enu_m_s[0])
    told = HERE | {"time_utc": "2023-11-14T22:13:19.5Z", "velocity_east_m_s": 3, "coasted": True}
    here, later = decoded([HERE, told])
    assert later.t_utc_ns == NOW_NS - 500_000_000
    assert later.velocity_enu_m_s[0] == 3.0
    assert (here.coasted, later.coasted) == (False, True)
    assert not any(each.tentative or each.ended for each in (here, later))
    assert decoded([]) == []


def test_tracks_are_shown_of_every_format_that_a_score_reads() -> None:
    from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

    place = {"type": "Point", "coordinates": [-3.72, 40.46]}
    feature = {"type": "Feature", "id": "hawk", "geometry": place, "properties": {}}
    geojson = json.dumps({"type": "FeatureCollection", "features": [feature]}).encode()
    batch = pb.TrackBatch(
        sensor="tower",
        tracks=[
            pb.Track(
                id="tower-9",
                number=9,
                time_utc_ns=NOW_NS,
                latitude_deg=40.46,
                longitude_deg=-3.72,
                coasted=True,
                last=True,
            )
        ],
    ).SerializeToString()
    message = SapientMessage(node_id="a-node")
    message.timestamp.FromNanoseconds(NOW_NS)
    report = message.detection_report
    report.object_id = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
    report.location.x, report.location.y = -3.72, 40.46
    report.location.coordinate_system = report.location.datum = 1
    sapient = message.SerializeToString()
    frame = shown(json.dumps(HERE).encode(), of_062(track=8), geojson, sapient, batch)
    numbers = frame.column(SectionKind.TRACKS, "track").tolist()
    assert numbers[:2] == [7, 8]
    names = {str(numbers[2]): "hawk", str(numbers[3]): report.object_id}
    assert frame.news["track_names"] == names, "tower-9 has ended"
    flags = frame.column(SectionKind.TRACKS, "flags").tolist()
    assert flags == [0, 0, 0, 0, TrackFlag.COASTED | TrackFlag.ENDED]
    by_type = tracks_to_show(batch, protobuf_content_type(TRACK_BATCH), NOW_NS, testing.SITE)
    assert [each.name for each in by_type] == ["tower-9"]


def test_one_number_of_two_sources_is_of_two_tracks() -> None:
    frame = shown(of_062(1, track=5), of_062(3, track=5), of_062(1, track=5))
    first, second, third = frame.column(SectionKind.TRACKS, "track").tolist()
    assert first == third == 5
    assert frame.news["track_names"] == {str(second): "3.2.5"}


@pytest.mark.parametrize("track", ["7", -1, 1 << 32, 10**400, "7" * 400, "\0\n", "T\u202e7"])
def test_any_name_is_of_a_track_that_has_a_number(track: int | str) -> None:
    frame = shown(json.dumps(HERE | {"track": track}).encode())
    assert len(frame.column(SectionKind.TRACKS, "track")) == 1
    assert all(len(name) <= 64 for name in frame.news.get("track_names", {}).values())


@pytest.mark.parametrize(
    ("message", "named"),
    [
        ({**HERE, "track": 7.5}, "track"),
        ({**HERE, "track": True}, "track"),
        ({**HERE, "track": None}, "track"),
        ({**HERE, "latitude_deg": 91}, "latitude_deg"),
        ({**HERE, "latitude_deg": True}, "latitude_deg"),
        ({**HERE, "longitude_deg": None}, "longitude_deg"),
        ({**HERE, "velocity_east_m_s": float("inf")}, "velocity_east_m_s"),
        ({**HERE, "velocity_north_m_s": 1e5}, "velocity_north_m_s"),
        ({**HERE, "height_m": float("inf")}, "height_m"),
        ({**HERE, "time_utc": "yesterday"}, "time_utc"),
        ({**HERE, "time_utc": True}, "time_utc"),
        ([7], "object"),
        ("text", "JSON"),
    ],
)
def test_what_is_no_track_is_refused_by_its_key(message: Any, named: str) -> None:
    with pytest.raises(DecodeError, match=named):
        decoded(message)


def test_what_is_too_long_is_not_read() -> None:
    with pytest.raises(DecodeError, match="at most"):
        tracks_to_show(b" " * (MAX_OCTETS + 1), None, NOW_NS, testing.SITE)
    with pytest.raises(DecodeError):
        tracks_to_show(b"[" * 100_000, None, NOW_NS, testing.SITE)


def test_tracks_are_placed_along_the_horizontal_of_the_site() -> None:
    enu_m = np.array([[3000.0, -4000.0, 120.0]])
    latitude_deg, longitude_deg, height_m = testing.SITE.to_geodetic(enu_m)
    place = {
        "latitude_deg": latitude_deg[0],
        "longitude_deg": longitude_deg[0],
        "height_m": height_m[0],
    }
    frame = shown(json.dumps({"track": 1} | place).encode())
    found_m = [frame.column(SectionKind.TRACKS, name)[0] for name in ("east_m", "north_m")]
    np.testing.assert_allclose(found_m, enu_m[0, :2], atol=1e-3)


def test_a_track_is_shown_until_it_ends_or_is_silent_for_long() -> None:
    view = View()
    view.scene(testing.scene([testing.radar()], seed=1))
    view.update(NOW_NS, 0.0)
    view.tracks(decoded([HERE, {**HERE, "track": 8}]))
    frame = read_frame(view.update(NOW_NS, 0.0).public)
    assert frame.column(SectionKind.TRACKS, "track").tolist() == [7, 8]
    view.tracks(decoded({**HERE, "ended": True}))
    frame = read_frame(view.update(NOW_NS, 0.0).public)
    assert frame.column(SectionKind.TRACKS, "flags").tolist() == [TrackFlag.ENDED]
    alive = read_frame(view.snapshot(NOW_NS).public).column(SectionKind.TRACKS, "track")
    assert alive.tolist() == [8]
    later_ns = NOW_NS + 61 * 10**9
    view.update(later_ns, 0.0)
    assert not read_frame(view.snapshot(later_ns).public).of(SectionKind.TRACKS)


def test_no_flood_of_tracks_takes_more_than_its_room() -> None:
    kept = ShownTracks(testing.SITE)
    (here,) = decoded(HERE)
    for start in range(0, 5 * MAX_TRACKS, 5000):
        kept.take([replace(here, name=f"{n:064}") for n in range(start, start + 5000)])
        if start % 10_000 == 0:
            kept.news(NOW_NS)
    assert len(kept.snapshot()) < 50 * MAX_TRACKS
    assert len(kept.names()) <= MAX_TRACKS
    kept.news(NOW_NS + 61 * 10**9)
    assert not kept.names()
    assert not kept.snapshot()

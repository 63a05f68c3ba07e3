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
from plotfeed.proto.utc import DAY_NS, NS

NOW_NS = testing.START_NS
HERE = {"track": 7, "latitude_deg": 40.46, "longitude_deg": -3.72}


def told_in(payload: bytes, content_type: str | None = None, at_ns: int = NOW_NS) -> Any:
    return tracks_to_show(payload, content_type, at_ns, testing.SITE)


def decoded(message: Any) -> list[ToldTrack]:
    found: list[ToldTrack] = told_in(json.dumps(message).encode())
    return found


def of_062(source: int = 1, **columns: Any) -> bytes:
    (block,) = TrackEncoder062(source, 2).blocks(tracks(**columns))
    return block


def fresh() -> View:
    view = View()
    view.scene(testing.scene([testing.radar()], seed=1))
    view.update(NOW_NS, 0.0)
    return view


def shown(*payloads: bytes) -> Frame:
    """What the page is told of messages."""
    view = fresh()
    for payload in payloads:
        view.tracks(told_in(payload))
    return read_frame(view.update(NOW_NS, 0.0).public)


def column(frame: Frame, name: str) -> list[Any]:
    return list(frame.column(SectionKind.TRACKS, name).tolist())


def test_tracks_of_category_062_are_where_and_when_they_say() -> None:
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
    assert column(frame, "track") == [3, 4]
    assert column(frame, "t_utc_ms") == pytest.approx([NOW_NS / 1e6 - 1e3, NOW_NS / 1e6], abs=10)
    assert column(frame, "velocity_east_m_s") == [10.0, -20.0]
    assert column(frame, "flags") == [TrackFlag.TENTATIVE, TrackFlag.COASTED | TrackFlag.ENDED]
    np.testing.assert_allclose([each.latitude_deg for each in told_in(block)], 40.5, atol=1e-5)
    midnight_ns = NOW_NS // DAY_NS * DAY_NS
    for later_ns in (-30 * NS, 30 * NS):  # a time of day is of the nearest day
        then_ns = midnight_ns - later_ns
        (told,) = told_in(of_062(t_utc_ns=then_ns), at_ns=midnight_ns + later_ns)
        assert told.t_utc_ns == pytest.approx(then_ns, abs=10**7)


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
    tower = pb.Track(id="tower-9", number=9, time_utc_ns=NOW_NS, coasted=True, last=True)
    tower.latitude_deg, tower.longitude_deg = 40.46, -3.72
    batch = pb.TrackBatch(sensor="tower", tracks=[tower]).SerializeToString()
    message = SapientMessage(node_id="a-node")
    message.timestamp.FromNanoseconds(NOW_NS)
    report = message.detection_report
    report.object_id = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
    report.location.x, report.location.y = -3.72, 40.46
    report.location.coordinate_system = report.location.datum = 1
    sapient = message.SerializeToString()
    frame = shown(json.dumps(HERE).encode(), of_062(track=8), geojson, sapient, batch)
    numbers = column(frame, "track")
    assert numbers[:2] == [7, 8]
    names = {str(numbers[2]): "hawk", str(numbers[3]): report.object_id}
    assert frame.news["track_names"] == names, "tower-9 has ended"
    assert column(frame, "flags") == [0, 0, 0, 0, TrackFlag.COASTED | TrackFlag.ENDED]
    by_type = told_in(batch, protobuf_content_type(TRACK_BATCH))
    assert [each.name for each in by_type] == ["tower-9"]


def test_a_track_has_a_number_whatever_its_name_and_source() -> None:
    frame = shown(of_062(1, track=5), of_062(3, track=5), of_062(1, track=5))
    first, second, third = column(frame, "track")
    assert first == third == 5
    assert frame.news["track_names"] == {str(second): "3.2.5"}
    for name in ("7", -1, 1 << 32, 10**400, "7" * 400, "\0\n", "T\u202e7"):
        frame = shown(json.dumps(HERE | {"track": name}).encode())
        assert len(column(frame, "track")) == 1, name
        assert all(len(name) <= 64 for name in frame.news.get("track_names", {}).values())


NO_TRACKS: list[tuple[Any, str]] = [
    *(({**HERE, "track": wrong}, "track") for wrong in (7.5, True, None)),
    *(({**HERE, "latitude_deg": wrong}, "latitude_deg") for wrong in (91, True)),
    ({**HERE, "longitude_deg": None}, "longitude_deg"),
    ({**HERE, "velocity_east_m_s": float("inf")}, "velocity_east_m_s"),
    ({**HERE, "velocity_north_m_s": 1e5}, "velocity_north_m_s"),
    ({**HERE, "height_m": float("inf")}, "height_m"),
    *(({**HERE, "time_utc": wrong}, "time_utc") for wrong in ("yesterday", True)),
    ([7], "object"),
    ("text", "JSON"),
]


def test_what_is_no_track_is_refused_by_its_key_and_what_is_too_long_not_read() -> None:
    for message, named in NO_TRACKS:
        with pytest.raises(DecodeError, match=named):
            decoded(message)
    with pytest.raises(DecodeError, match="at most"):
        told_in(b" " * (MAX_OCTETS + 1))
    with pytest.raises(DecodeError):
        told_in(b"[" * 100_000)


def test_tracks_are_placed_along_the_horizontal_of_the_site() -> None:
    enu_m = np.array([[3000.0, -4000.0, 120.0]])
    place = zip(
        ("latitude_deg", "longitude_deg", "height_m"), testing.SITE.to_geodetic(enu_m), strict=True
    )
    frame = shown(json.dumps({"track": 1, **{name: value[0] for name, value in place}}).encode())
    found_m = [*column(frame, "east_m"), *column(frame, "north_m")]
    np.testing.assert_allclose(found_m, enu_m[0, :2], atol=1e-3)


def test_a_track_is_shown_until_it_ends_or_is_silent_for_long() -> None:
    view = fresh()
    view.tracks(decoded([HERE, {**HERE, "track": 8}]))
    assert column(read_frame(view.update(NOW_NS, 0.0).public), "track") == [7, 8]
    view.tracks(decoded({**HERE, "ended": True}))
    assert column(read_frame(view.update(NOW_NS, 0.0).public), "flags") == [TrackFlag.ENDED]
    assert column(read_frame(view.snapshot(NOW_NS).public), "track") == [8]
    later_ns = NOW_NS + 61 * NS
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
    kept.news(NOW_NS + 61 * NS)
    assert not kept.names()
    assert not kept.snapshot()

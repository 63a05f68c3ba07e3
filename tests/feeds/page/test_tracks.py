from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.asterix_input import tracks
from support.page_updates import Frame, read_frame

from plotfeed import testing
from plotfeed.feeds.formats.told_tracks import ToldTrack
from plotfeed.feeds.page.shown import MAX_TRACKS, ShownTracks, tracks_to_show
from plotfeed.feeds.page.updates import SectionKind, TrackFlag
from plotfeed.feeds.page.view import View
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS

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


def test_tracks_without_time_or_height_are_of_now_and_at_the_site() -> None:
    (here,) = decoded(HERE)
    assert (here.t_utc_ns, here.height_m) == (NOW_NS, testing.SITE.height_m)
    told = HERE | {"time_utc": "2023-11-14T22:13:19.5Z", "height_m": 700}
    here, later = decoded([HERE, told])
    assert (later.t_utc_ns, later.height_m) == (NOW_NS - 500_000_000, 700.0)
    assert decoded([]) == []


def test_a_track_has_a_number_whatever_its_name_and_source() -> None:
    frame = shown(of_062(1, track=5), of_062(3, track=5), of_062(1, track=5))
    first, second, third = column(frame, "track")
    assert first == third == 5
    assert frame.news["track_names"] == {str(second): "3.2.5"}
    for name in ("7", -1, 1 << 32, 10**400, "7" * 400, "\0\n", "T\u202e7"):
        frame = shown(json.dumps(HERE | {"track": name}).encode())
        assert len(column(frame, "track")) == 1, name
        assert all(len(name) <= 64 for name in frame.news.get("track_names", {}).values())


def test_what_is_no_place_is_refused_by_its_key() -> None:
    """And what is no track at all, of which tests/feeds/lab has more."""
    for key, wrong in (
        ("track", None),
        ("latitude_deg", 91),
        ("longitude_deg", None),
        ("velocity_east_m_s", float("inf")),
        ("velocity_north_m_s", 1e5),
        ("height_m", float("inf")),
        ("time_utc", "yesterday"),
    ):
        with pytest.raises(DecodeError, match=key):
            decoded({**HERE, key: wrong})


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

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import road
from support.asterix_input import tracks
from support.page_updates import read_frame

from plotfeed.feeds.page.shown import MAX_TRACKS, ShownTracks
from plotfeed.feeds.page.tracker_tracks import (
    MAX_OCTETS,
    TrackNews,
    decode_tracks,
    east_north_m,
)
from plotfeed.feeds.page.updates import SectionKind, TrackFlag
from plotfeed.feeds.page.view import View
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import DAY_NS

NOW_NS = road.START_NS
HERE = {"track": 7, "latitude_deg": 40.46, "longitude_deg": -3.72}


def decoded(message: Any) -> TrackNews:
    return decode_tracks(json.dumps(message).encode(), NOW_NS, road.SITE)


def of_062(**columns: Any) -> TrackNews:
    (block,) = TrackEncoder062(1, 2).blocks(tracks(**columns))
    return decode_tracks(block, NOW_NS, road.SITE)


def test_tracks_of_category_062_are_where_they_say() -> None:
    news = of_062(
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
    assert news.track.tolist() == [3, 4]
    assert np.abs(news.t_utc_ns - [NOW_NS - 10**9, NOW_NS]).max() < 10**7
    assert news.velocity_east_m_s.tolist() == [10.0, -20.0]
    assert news.flags.tolist() == [TrackFlag.TENTATIVE, TrackFlag.COASTED | TrackFlag.ENDED]
    np.testing.assert_allclose(news.latitude_deg, 40.5, atol=1e-5)


@pytest.mark.parametrize("seconds", [-30.0, 30.0])
def test_times_of_day_are_of_the_nearest_day(seconds: float) -> None:
    midnight_ns = NOW_NS // DAY_NS * DAY_NS
    then_ns = midnight_ns - round(seconds * 1e9)
    (block,) = TrackEncoder062(1, 2).blocks(tracks(t_utc_ns=then_ns))
    news = decode_tracks(block, midnight_ns + round(seconds * 1e9), road.SITE)
    assert abs(int(news.t_utc_ns[0]) - then_ns) < 10**7


def test_tracks_of_json_are_one_or_several() -> None:
    news = decoded(HERE)
    assert (len(news), int(news.t_utc_ns[0])) == (1, NOW_NS)
    assert np.isnan(news.velocity_east_m_s[0])
    told = HERE | {"time_utc": "2023-11-14T22:13:19.5Z", "velocity_east_m_s": 3, "coasted": True}
    news = decoded([HERE, told])
    assert int(news.t_utc_ns[1]) == NOW_NS - 500_000_000
    assert news.velocity_east_m_s[1] == 3.0
    assert news.flags.tolist() == [0, TrackFlag.COASTED]
    assert len(decoded([])) == 0


@pytest.mark.parametrize(
    ("message", "named"),
    [
        ({**HERE, "track": "7"}, "track"),
        ({**HERE, "track": -1}, "track"),
        ({**HERE, "track": 1 << 32}, "track"),
        ({**HERE, "latitude_deg": 91}, "latitude_deg"),
        ({**HERE, "latitude_deg": True}, "latitude_deg"),
        ({**HERE, "longitude_deg": None}, "longitude_deg"),
        ({**HERE, "velocity_east_m_s": float("nan")}, "velocity_east_m_s"),
        ({**HERE, "height_m": float("inf")}, "height_m"),
        ({**HERE, "time_utc": "yesterday"}, "time_utc"),
        ({**HERE, "time_utc": 5}, "time_utc"),
        ([7], "object"),
        ("text", "object"),
    ],
)
def test_what_is_no_track_is_refused_by_its_key(message: Any, named: str) -> None:
    with pytest.raises(DecodeError, match=named):
        decoded(message)


@given(st.binary(max_size=200))
def test_any_octets_are_tracks_or_an_error(payload: bytes) -> None:
    for prefix in (b"", b">", b"{", b'[{"track":'):
        try:
            news = decode_tracks(prefix + payload, NOW_NS, road.SITE)
        except DecodeError:
            continue
        assert np.isfinite(news.latitude_deg).all()


def test_what_is_too_long_is_not_read() -> None:
    with pytest.raises(DecodeError, match="at most"):
        decode_tracks(b" " * (MAX_OCTETS + 1), NOW_NS, road.SITE)
    with pytest.raises(DecodeError):
        decode_tracks(b"[" * 100_000, NOW_NS, road.SITE)


def test_tracks_are_placed_along_the_horizontal_of_the_site() -> None:
    enu_m = np.array([[3000.0, -4000.0, 120.0]])
    latitude_deg, longitude_deg, height_m = road.SITE.to_geodetic(enu_m)
    news = decoded(
        {
            "track": 1,
            "latitude_deg": latitude_deg[0],
            "longitude_deg": longitude_deg[0],
            "height_m": height_m[0],
        }
    )
    east_m, north_m = east_north_m(news, road.SITE)
    np.testing.assert_allclose([east_m[0], north_m[0]], enu_m[0, :2], atol=1e-3)


def test_a_track_is_shown_until_it_ends_or_is_silent_for_long() -> None:
    view = View()
    view.scene(road.scene([road.radar()], seed=1))
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
    shown = ShownTracks(road.SITE)
    news = decoded([HERE] * 5000)
    for start in range(0, 5 * MAX_TRACKS, 5000):
        shown.take(replace(news, track=np.arange(start, start + 5000)))
        if start % 10_000 == 0:
            shown.news(NOW_NS)
    assert len(shown.snapshot()) < 50 * MAX_TRACKS

from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.feeds.telemetry.flights.srt import read_srt
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

S = 1_000_000_000
START = round(datetime(2022, 6, 21, 16, 6, 17, tzinfo=UTC).timestamp()) * S


def subtitles(lines: list[str], *, dated: bool = True) -> str:
    blocks = []
    for i, line in enumerate(lines):
        date = f"2022.06.21 16:06:{17 + i:02d}\n" if dated else ""
        blocks.append(f"{i + 1}\n00:00:{i:02d},000 --> 00:00:{i + 1:02d},000\n{date}{line}\n")
    return "\n".join(blocks)


def flown(text: str, **options: object) -> Flight:
    log = Log()
    read_srt(text, FlightOptions(**options), log)  # type: ignore[arg-type]
    return log.flight("a")


def positions(flight: Flight) -> list[tuple[float, float, float]]:
    return [(r.latitude_deg, r.longitude_deg, r.altitude_m) for r in flight.reports]


MATRICE = [f"GPS(36.61{i:02d},-6.1120,0.0M) BAROMETER:{i}.5M" for i in range(3)]
MAVIC_PRO = [
    f"HOME(-6.1120,36.6100) GPS(-6.1120,36.61{i:02d},16) BAROMETER:{i}.5" for i in range(3)
]
MINI = [
    f"F/2.8, SS 206, ISO 150, EV 0, GPS (-6.1120, 36.61{i:02d}, 15), D 2.36m, H {i}.50m, H.S 0.0m/s"
    for i in range(3)
]
BRACKETS = [
    f"[iso: 100] [latitude: 36.61{i:02d}] [longitude: -6.1120] [rel_alt: {i}.5 abs_alt: {i}.0]"
    for i in range(3)
]


@pytest.mark.parametrize("lines", [MATRICE, MAVIC_PRO, MINI, BRACKETS])
def test_every_dialect_gives_the_same_flight(lines: list[str]) -> None:
    flight = flown(subtitles(lines))
    expected = [pytest.approx((36.61 + i / 1e4, -6.112, i + 0.5)) for i in range(3)]
    assert positions(flight) == expected
    assert [r.t_utc_ns for r in flight.reports] == [START + i * S for i in range(3)]
    assert flight.reports[0].altitude_reference is AltitudeReference.ABOVE_TAKEOFF
    assert flight.skipped == ()


def test_the_misspelt_longitude_of_some_models_is_read() -> None:
    lines = ["[latitude : 1.5] [longtitude : -2.5] [rel_alt: 3.0 abs_alt: 9.0]"]
    assert positions(flown(subtitles(lines))) == [(1.5, -2.5, 3.0)]


def test_the_height_of_the_wanted_reference_is_taken_where_there_are_two() -> None:
    flight = flown(subtitles(BRACKETS), altitude_reference=AltitudeReference.MEAN_SEA_LEVEL)
    assert [r.altitude_m for r in flight.reports] == [0.0, 1.0, 2.0]
    assert flight.reports[0].altitude_reference is AltitudeReference.MEAN_SEA_LEVEL


def test_a_height_of_unknown_reference_must_be_explained() -> None:
    text = subtitles(["[latitude: 1.5] [longitude: 2.5] [altitude: 117.0]"])
    with pytest.raises(PlotfeedError, match="--set altitude_reference"):
        flown(text)
    flight = flown(text, altitude_reference=AltitudeReference.ELLIPSOID)
    assert positions(flight) == [(1.5, 2.5, 117.0)]


def test_a_value_beyond_90_tells_the_order_whatever_the_dialect() -> None:
    lines = ["GPS(149.02,-20.25,0.0M) BAROMETER:1.0M", "GPS(149.03,-20.25,0.0M) BAROMETER:1.0M"]
    assert positions(flown(subtitles(lines[:1]))) == [(-20.25, 149.02, 1.0)]
    assert positions(flown(subtitles(["GPS(-20.25,149.02,5) BAROMETER:1.0"]))) == [
        (-20.25, 149.02, 1.0)
    ]


def test_an_ambiguous_order_is_asked_for() -> None:
    text = subtitles(["GPS(36.6,-6.1,16) BAROMETER:1.0"])
    with pytest.raises(PlotfeedError, match="--set gps_order"):
        flown(text)
    assert positions(flown(text, gps_order="lat-lon")) == [(36.6, -6.1, 1.0)]
    assert positions(flown(text, gps_order="lon-lat")) == [(-6.1, 36.6, 1.0)]


def test_the_users_order_overrides_the_dialect() -> None:
    flight = flown(subtitles(MATRICE), gps_order="lon-lat")
    assert flight.reports[0].latitude_deg == -6.112


def test_local_time_is_shifted_by_its_offset() -> None:
    flight = flown(subtitles(MATRICE), utc_offset_h=2.0)
    assert flight.reports[0].t_utc_ns == START - 7200 * S
    assert any("+2 h" in line for line in flight.assumed)


def test_fractions_of_a_second_are_read_in_both_spellings() -> None:
    tail = "[latitude: 1.5] [longitude: 2.5] [rel_alt: 3.0 abs_alt: 9.0]\n\n"
    text = "".join(
        f"{i}\n00:00:00,000 --> 00:00:00,033\n<font>FrameCnt: 1\n2022-06-21 16:06:{when}\n{tail}"
        for i, when in enumerate(["17,774,808", "18.858"])
    )
    t = [r.t_utc_ns - START for r in flown(text).reports]
    assert t == [774_808_000, 1_858_000_000]


def test_without_dates_a_start_is_asked_for() -> None:
    text = subtitles(MINI, dated=False)
    with pytest.raises(PlotfeedError, match="start_utc_ns"):
        flown(text)
    flight = flown(text, start_utc_ns=START)
    assert [r.t_utc_ns for r in flight.reports] == [START + i * S for i in range(3)]


def test_subtitles_of_something_else_are_refused() -> None:
    with pytest.raises(PlotfeedError, match="no positions"):
        flown(subtitles(["Good evening."]))


def test_records_that_cannot_be_read_are_told_by_line() -> None:
    lines = [MATRICE[0], "GPS(n/a) BAROMETER:1.0M", "GPS(0.0,0.0,0.0M) BAROMETER:1.0M", MATRICE[2]]
    flight = flown(subtitles(lines))
    assert len(flight.reports) == 2
    assert [line.partition(":")[0] for line in flight.skipped] == ["line 7", "line 12"]


@given(st.data())
def test_a_file_cut_or_damaged_anywhere_gives_what_is_whole(data: st.DataObject) -> None:
    text = subtitles(data.draw(st.sampled_from([MATRICE, MAVIC_PRO, MINI, BRACKETS])))
    at = data.draw(st.integers(0, len(text)))
    text = text[:at] + data.draw(st.sampled_from(["", "\x00", "9" * 400, ")(-->", "\n\n\n"]))
    with suppress(PlotfeedError):
        assert 1 <= len(flown(text).reports) <= 3


def test_a_byte_order_mark_and_an_odd_suffix_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(b"\xef\xbb\xbf" + subtitles(MATRICE).replace("\n", "\r\n").encode())
    assert len(read(path).reports) == 3

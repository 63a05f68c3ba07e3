from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.file_times import parse_time_ns
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.feeds.telemetry.flights.table import read_table
from plotfeed.feeds.telemetry.position_report import UNKNOWN_VELOCITY
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

S = 1_000_000_000
START = round(datetime(2019, 12, 9, 10, 49, 35, tzinfo=UTC).timestamp()) * S
SEA = AltitudeReference.MEAN_SEA_LEVEL
TABLE = """\
time,lat,lon,altitude (m),Vx m/s,Vy m/s
2019-12-09 10:49:35,50.0,-30.0,708.0,1.5,-2.5
2019-12-09 10:49:36,50.0,-30.00002,709.0,1.5,-2.5
"""


def flown(text: str, **options: object) -> Flight:
    log = Log()
    options.setdefault("altitude_reference", SEA)
    read_table(text, FlightOptions(**options), log)  # type: ignore[arg-type]
    return log.flight("a")


@pytest.mark.parametrize(
    ("cell", "t_utc_ns"),
    [
        ("2019-12-09 10:49:35", START),
        ("2019-12-09T10:49:35Z", START),
        ("2019-12-09T12:49:35.5+02:00", START + S // 2),
        ("1575888575", START),
        ("1575888575.123456789", START + 123_456_789),
        ("1575888575123", START + 123_000_000),
        ("1575888575123456", START + 123_456_000),
        ("1575888575123456789", START + 123_456_789),
        ("1.575888575e9", START),
    ],
)
def test_times_are_exact_to_the_nanosecond(cell: str, t_utc_ns: int) -> None:
    assert parse_time_ns(cell, 0.0) == t_utc_ns


@pytest.mark.parametrize("cell", ["", "noon", "38975.0", "-5", "nan", "inf", "1e999999", "9" * 99])
def test_what_is_no_time_since_1970_is_none(cell: str) -> None:
    assert parse_time_ns(cell, 0.0) is None


@given(st.text(max_size=30), st.floats(-24, 24))
def test_any_cell_is_a_time_or_none(cell: str, offset_h: float) -> None:
    assert isinstance(parse_time_ns(cell, offset_h), int | None)


def test_times_without_a_zone_are_shifted_by_the_offset_and_others_are_not() -> None:
    assert parse_time_ns("2019-12-09 12:49:35", 2.0) == START
    assert parse_time_ns("2019-12-09 10:49:35Z", 2.0) == START
    assert parse_time_ns("1575888575", 2.0) == START


def test_known_names_are_found_by_themselves() -> None:
    flight = flown(TABLE)
    assert [r.altitude_m for r in flight.reports] == [708.0, 709.0]
    assert flight.reports[0].altitude_reference is SEA
    assert flight.reports[0].velocity_enu_m_s == UNKNOWN_VELOCITY


def test_columns_named_by_the_user_are_taken() -> None:
    columns = {"velocity_east_m_s": "Vx m/s", "velocity_north_m_s": "Vy m/s"}
    velocity = flown(TABLE, columns=columns).reports[0].velocity_enu_m_s
    assert repr(velocity) == "(1.5, -2.5, nan)"


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"latitude_deg": "breite"}, "breite.*columns are time, lat"),
        ({"colour": "lat"}, "colour.*expected one of time, latitude_deg"),
    ],
)
def test_a_wrong_column_is_named(columns: dict[str, str], message: str) -> None:
    with pytest.raises(PlotfeedError, match=message):
        flown(TABLE, columns=columns)


def test_a_missing_column_is_named_with_the_option() -> None:
    with pytest.raises(PlotfeedError, match=r"--set columns\.latitude_deg=NAME"):
        flown(TABLE.replace("lat", "breite"))


def test_an_unstated_altitude_reference_is_asked_for() -> None:
    with pytest.raises(PlotfeedError, match="--set altitude_reference"):
        flown(TABLE, altitude_reference=None)


def test_semicolons_comments_and_order_do_not_matter() -> None:
    text = "# drone 7\n\nlongitude;height;latitude;epoch\n-30;5;50;1575888575\n"
    (report,) = flown(text).reports
    assert (report.latitude_deg, report.longitude_deg, report.altitude_m) == (50.0, -30.0, 5.0)


def test_rows_that_cannot_be_read_are_told_by_line() -> None:
    text = TABLE + "yesterday,50,-30,700,0,0\n2019-12-09 10:49:38,x,-30,700\n"
    text += "2019-12-09 10:49:39,50\n2019-12-09 10:49:36,50,-30,700,0,0\n"
    text += "2019-12-09 10:49:35,50,-30,700,0,0\n2019-12-09 10:49:40,95,-30,700,0,0\n"
    flight = flown(text)
    assert len(flight.reports) == 2
    told = {line.partition(":")[0]: line for line in flight.skipped}
    assert sorted(told) == [f"line {n}" for n in range(4, 10)]
    assert "same time" in told["line 7"]
    assert "same time" in told["line 8"]
    assert "latitude_deg is 95" in told["line 9"]


@given(st.data())
def test_a_table_cut_or_damaged_anywhere_gives_what_is_whole(data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(TABLE)))
    junk = data.draw(st.sampled_from(["", '"', "\x00", ",,,,", "\n1e999999,nan,inf,-\n"]))
    with suppress(PlotfeedError):
        assert len(flown(TABLE[:at] + junk + TABLE[at:]).reports) <= 2


def test_a_file_is_read_by_its_suffix(tmp_path: Path) -> None:
    path = tmp_path / "flown.CSV"
    path.write_text(TABLE)
    flight = read(str(path), FlightOptions(altitude_reference=SEA))
    assert flight.name == "flown"
    assert len(flight.reports) == 2

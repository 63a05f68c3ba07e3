"""Tables of whatever exporter: columns, units and times are found, or asked for by name."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from golden.make_flights import GROUND_MSL_M
from hypothesis import given
from hypothesis import strategies as st
from support.given_files import GOLDEN
from support.given_flights import flown, places

from plotfeed.feeds.cli.inject import summary_lines
from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.file_times import (
    finer_times,
    is_day_first,
    midnight_ns,
    parse_time_ns,
    time_of_day_ns,
)
from plotfeed.feeds.telemetry.flights.flight import FlightOptions
from plotfeed.feeds.telemetry.position_report import UNKNOWN_VELOCITY
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

S = 1_000_000_000
START = round(datetime(2019, 12, 9, 10, 49, 35, tzinfo=UTC).timestamp()) * S
SEA = AltitudeReference.MEAN_SEA_LEVEL
FLIGHTS = GOLDEN / "flights"
TABLE = """\
time,lat,lon,altitude (m),Vx m/s,Vy m/s
2019-12-09 10:49:35,50.0,-30.0,708.0,1.5,-2.5
2019-12-09 10:49:36,50.0,-30.00002,709.0,1.5,-2.5
"""


@pytest.mark.parametrize(
    ("cell", "since_ns", "offset_h"),
    [
        ("2019-12-09 10:49:35", 0, 0.0),
        ("2019-12-09T10:49:35Z", 0, 2.0),
        ("2019-12-09 12:49:35", 0, 2.0),  # without a zone
        ("2019-12-09T12:49:35.5+02:00", S // 2, 0.0),
        ("1575888575", 0, 2.0),
        ("1575888575.123456789", 123_456_789, 0.0),
        ("1575888575123", 123_000_000, 0.0),
        ("1575888575123456", 123_456_000, 0.0),
        ("1575888575123456789", 123_456_789, 0.0),
        ("1.575888575e9", 0, 0.0),
    ],
)
def test_times_are_exact_to_the_nanosecond(cell: str, since_ns: int, offset_h: float) -> None:
    assert parse_time_ns(cell, offset_h) == START + since_ns


@given(st.text(max_size=30), st.floats(-24, 24))
def test_any_cell_is_a_time_or_none(cell: str, offset_h: float) -> None:
    assert isinstance(parse_time_ns(cell, offset_h), int | None)
    assert isinstance(time_of_day_ns(cell), int | None)


@pytest.mark.parametrize(
    ("cell", "since_s"),
    [
        ("11:24:29.64 AM", 41069.64),
        ("12:00:00 AM", 0.0),
        ("12:30:00 PM", 45000.0),
        ("1:02:03.5 p.m.", 46923.5),
        ("23:04:05", 83045.0),
    ],
)
def test_times_of_day_are_read_as_people_write_them(cell: str, since_s: float) -> None:
    assert time_of_day_ns(cell) == round(since_s * S)


def test_what_is_no_time_is_none() -> None:
    for cell in ("", "noon", "38975.0", "-5", "nan", "inf", "1e999999", "9" * 99):
        assert parse_time_ns(cell, 0.0) is None
    for cell in ("", "25:00:00", "13:00:00 PM", "0:00:00 AM", "noon", "1:2"):
        assert time_of_day_ns(cell) is None


def test_the_order_of_days_and_months_is_told_by_the_days_beyond_twelve() -> None:
    assert is_day_first(["1/2/2024", "13/2/2024"]) is True
    assert is_day_first(["1/2/2024", "2/13/2024"]) is False
    assert is_day_first(["1/2/2024"]) is None
    march = round(datetime(2024, 3, 1, tzinfo=UTC).timestamp()) * S
    assert midnight_ns("3/1/2024") == midnight_ns("2024-03-01") == march
    assert midnight_ns("1/3/2024", day_first=True) == march
    assert midnight_ns("2/30/2024") is midnight_ns("noon") is None


@given(
    interval_s=st.sampled_from([0.033, 0.1, 0.2, 0.5]),
    phase_s=st.floats(0, 0.999),
    missing=st.sets(st.integers(0, 99), max_size=30),
)
def test_a_count_makes_a_clock_of_whole_seconds_finer(
    interval_s: float, phase_s: float, missing: set[int]
) -> None:
    true_ns = [round((1_767_268_800 + phase_s + i * interval_s) * S) for i in range(100)]
    elapsed: list[int | None] = [round(i * interval_s * 1000) * 10**6 for i in range(100)]
    coarse = [None if i in missing else t // S * S for i, t in enumerate(true_ns)]
    found = finer_times(coarse, elapsed, start_ns=None)
    if len({c for c in coarse if c is not None}) > 1 and not missing:
        errors_s = np.array([f - t for f, t in zip(found, true_ns, strict=True)]) / S  # type: ignore[operator]
        assert np.abs(errors_s).max() <= interval_s + 0.002
    kept = [f for f in found if f is not None]
    assert all(a < b for a, b in pairwise(kept))


def test_a_film_that_is_slower_than_its_clock_goes_by_the_clock() -> None:
    """6 minutes of timecode in 43 of clock, such as of a time lapse."""
    coarse: list[int | None] = [1_767_268_800 * S + i * 7 * S for i in range(100)]
    elapsed: list[int | None] = [i * S for i in range(100)]
    assert finer_times(coarse, elapsed, start_ns=None) == coarse


def test_columns_are_found_by_their_names_or_named_by_the_user(tmp_path: Path) -> None:
    path = tmp_path / "flown.CSV"
    path.write_text(TABLE)
    flight = read(str(path), FlightOptions(altitude_reference=SEA))
    assert flight.name == "flown"
    assert [r.altitude_m for r in flight.reports] == [708.0, 709.0]
    assert flight.reports[0].altitude_reference is SEA
    assert flight.reports[0].velocity_enu_m_s == UNKNOWN_VELOCITY
    columns = {"velocity_east_m_s": "Vx m/s", "velocity_north_m_s": "Vy m/s"}
    flight = flown(".csv", TABLE, columns=columns, altitude_reference=SEA)
    assert repr(flight.reports[0].velocity_enu_m_s) == "(1.5, -2.5, nan)"
    text = "# drone 7\n\nlongitude;height;latitude;epoch\n-30;5;50;1575888575\n"
    assert places(flown(".csv", text, altitude_reference=SEA)) == [(50.0, -30.0, 5.0)]


def test_a_height_whose_name_says_above_what_it_is_comes_before_one_that_does_not() -> None:
    rows = "time,lat,lon,altitude (m),height_above_takeoff (m)\n1575888575,50,-30,700,5\n"
    (report,) = flown(".csv", rows).reports
    assert (report.altitude_m, report.altitude_reference) == (5.0, AltitudeReference.ABOVE_TAKEOFF)


def test_velocities_and_accuracies_come_in_the_units_of_their_columns() -> None:
    factors = {"m/s": 1.0, "km/h": 1 / 3.6, "kt": 1852 / 3600, "ft/s": 0.3048, "mph": 0.44704}
    for unit, m_s in factors.items():
        head = f"time,lat,lon,altitude_msl (ft),velocity_east ({unit}),hacc (ft)"
        (report,) = flown(".csv", f"{head}\n1575888575,50,-30,100,36,10\n").reports
        assert report.velocity_enu_m_s[0] == pytest.approx(36 * m_s)
        assert (report.altitude_m, report.horizontal_accuracy_m) == pytest.approx((30.48, 3.048))


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (TABLE, {"columns": {"latitude_deg": "breite"}}, "breite.*columns are time, lat"),
        (TABLE, {"columns": {"colour": "lat"}}, "colour.*expected one of time, latitude_deg"),
        (TABLE.replace("lat", "breite"), {}, r"--set columns\.latitude_deg=NAME"),
        (TABLE, {"altitude_reference": None}, "--set altitude_reference"),
        (
            TABLE.replace("altitude", "x"),
            {},
            r"columns\.altitude_m=NAME.*or give .* --set height_m",
        ),
        (TABLE.replace("time", "x"), {}, r"no column found for time"),
        (TABLE.replace("time", "elapsed (s)").replace("2019-12-09 10:49:", ""), {}, "start_utc_ns"),
        ("# nothing\n", {}, "empty table"),
        (
            TABLE.replace("(m)", "(furlong)"),
            {"columns": {"altitude_m": "altitude (furlong)"}},
            "no",
        ),
    ],
)
def test_what_a_table_does_not_say_is_asked_for_by_name(
    text: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(PlotfeedError, match=message):
        flown(".csv", text, **{"altitude_reference": SEA, **options})


def test_rows_that_cannot_be_read_are_told_by_line() -> None:
    text = TABLE + "yesterday,50,-30,700,0,0\n2019-12-09 10:49:38,x,-30,700\n"
    text += "2019-12-09 10:49:39,50\n2019-12-09 10:49:36,50,-30,700,0,0\n"
    text += "2019-12-09 10:49:35,50,-30,700,0,0\n2019-12-09 10:49:40,95,-30,700,0,0\n\n,,\n"
    flight = flown(".csv", text, altitude_reference=SEA)
    assert len(flight.reports) == 2
    told = {line.partition(":")[0]: line for line in flight.skipped}
    assert sorted(told) == [f"line {n}" for n in range(4, 10)]
    assert "same time" in told["line 7"]
    assert "same time" in told["line 8"]
    assert "latitude_deg is 95" in told["line 9"]


def test_units_references_and_what_was_assumed_are_said_back() -> None:
    text = (FLIGHTS / "airdata.csv").read_text()
    flight = flown(".csv", text)
    told = "\n".join(summary_lines(flight))
    assert "height in feet, above take-off: column 'height_above_takeoff(feet)'" in told
    assert "rate       10 Hz, without gaps" in told
    other = flown(".csv", text, altitude_reference=SEA)
    assert "above mean sea level: column 'altitude_above_seaLevel(feet)'" in "\n".join(other.stated)
    above_m = other.reports[0].altitude_m - flight.reports[0].altitude_m
    assert above_m == pytest.approx(GROUND_MSL_M, abs=0.01)
    text = (FLIGHTS / "phantomhelp.csv").read_text()
    assert "times are +0 h from UTC (utc_offset_h)" in flown(".csv", text).assumed
    told_not = flown(".csv", text.replace("5/14/2024", "5/4/2024")).assumed
    assert "dates such as 5/4/2024 have the month first" in told_not


def test_gaps_and_what_was_dropped_are_summed_up() -> None:
    rows = [f"{1767268800 + t},40.0,-3.7,{90 if t < 30 else 91},12" for t in range(60)]
    rows[5] = rows[6] = "1767268806,0,0,90,12"
    del rows[20:35]
    text = "time,lat,lon,altitude_msl,x\n" + "\n".join(rows)
    told = list(summary_lines(flown(".csv", text)))
    assert "1 gap, the longest 16 s" in told[-2]
    assert told[-1] == "dropped    2 of 45 records: position …, …: no GPS fix 2"

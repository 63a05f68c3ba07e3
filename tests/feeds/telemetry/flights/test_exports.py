"""What exporters, autopilots and receivers write is read in its units, and said back."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from golden.make_flights import GROUND_MSL_M, PART_S, PHASE_S, START, geodetic
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.cli.inject import summary_lines
from plotfeed.feeds.telemetry.flights import BY_SUFFIX, read
from plotfeed.feeds.telemetry.flights.file_times import (
    finer_times,
    is_day_first,
    midnight_ns,
    time_of_day_ns,
)
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.feeds.telemetry.flights.nmea import read_nmea
from plotfeed.feeds.telemetry.flights.table import read_table
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

NS = 1_000_000_000
FLIGHTS = Path(__file__).parents[3] / "golden" / "flights"
ABOVE, SEA = AltitudeReference.ABOVE_TAKEOFF, AltitudeReference.MEAN_SEA_LEVEL
WHOLE = PART_S[1] - PART_S[0]
CASES = {
    # file: options, records, first, what altitudes are above, error of time, degrees and height
    "airdata.csv": ({}, WHOLE * 10, 0.0, ABOVE, (0.1, 1e-9, 0.002)),
    "litchi.csv": ({}, WHOLE * 5, 0.0, ABOVE, (1e-9, 1e-8, 0.051)),
    "phantomhelp.csv": ({"utc_offset_h": 2.0}, WHOLE * 5, 0.0, ABOVE, (1e-9, 1e-8, 0.016)),
    "old.srt": ({}, WHOLE, 0.0, ABOVE, (1e-9, 1e-6, 0.051)),
    "part.ulg": ({}, WHOLE * 5 - 15, 3.0, SEA, (1e-5, 1e-9, 1e-4)),
    "part.kml": ({}, WHOLE - 1, 0.0, SEA, (1e-9, 1e-8, 0.0051)),
    "part.nmea": ({}, WHOLE * 5 - 2, 0.4, SEA, (1e-9, 1e-7, 0.0051)),
}


@pytest.mark.parametrize("name", CASES)
def test_each_layout_gives_the_path_that_was_flown(name: str) -> None:
    options, records, first_s, above, (time_s, degrees, metres) = CASES[name]
    if name.endswith(".ulg"):
        pytest.importorskip("pyulog")
    flight = read(FLIGHTS / name, FlightOptions(**options))  # type: ignore[arg-type]
    assert len(flight.reports) == records
    phase_s = PHASE_S if name == "airdata.csv" else 0.0
    began_ns = round((START.timestamp() + PART_S[0] + phase_s) * NS)
    times_s = np.array([r.t_utc_ns - began_ns for r in flight.reports]) / NS
    assert times_s[0] == pytest.approx(first_s, abs=time_s)
    for report, t_s in zip(flight.reports, times_s - times_s[0] + first_s, strict=True):
        latitude_deg, longitude_deg, up_m = geodetic(PART_S[0] + t_s)
        assert report.latitude_deg == pytest.approx(latitude_deg, abs=degrees * 1.1)
        assert report.longitude_deg == pytest.approx(longitude_deg, abs=degrees * 1.1)
        height_m = up_m + (GROUND_MSL_M if above is SEA else 0.0)
        assert report.altitude_m == pytest.approx(height_m, abs=metres)
        assert report.altitude_reference is above


@pytest.mark.parametrize(("version", "details"), [(1, 4000), (8, 500), (14, 4000), (14, 0)])
def test_a_binary_record_of_a_dji_app_is_refused_with_what_reads_it(
    version: int, details: int, tmp_path: Path
) -> None:
    path = tmp_path / "DJIFlightRecord.txt"
    head = details.to_bytes(8, "little") + b"\x10\x01" + bytes([version, 0])
    path.write_bytes(head + bytes(range(256)) * 20)
    with pytest.raises(PlotfeedError, match=rf"version {version}, which plotfeed .*Airdata"):
        read(path)


def test_a_film_without_heights_flies_at_the_one_that_is_given() -> None:
    with pytest.raises(PlotfeedError, match="--set height_m"):
        read(FLIGHTS / "frames.srt")
    flight = read(FLIGHTS / "frames.srt", FlightOptions(height_m=60.0))
    assert len(flight.reports) == WHOLE * 5  # of dates alone one in five would be left
    steps_s = np.diff([r.t_utc_ns for r in flight.reports]) / NS
    assert steps_s == pytest.approx([0.2] * len(steps_s))
    assert {(r.altitude_m, r.altitude_reference) for r in flight.reports} == {(60.0, ABOVE)}


def test_the_satellites_of_old_subtitles_are_no_height() -> None:
    assert not any(r.altitude_m == 16.0 for r in read(FLIGHTS / "old.srt").reports)
    text = (FLIGHTS / "old.srt").read_text().replace(" Hs:0.0 Hb:", " Hx:")
    with pytest.raises(PlotfeedError, match="no heights: expected BAROMETER, Hb"):
        _srt(text)


def _srt(text: str, **options: object) -> Flight:
    from plotfeed.feeds.telemetry.flights.srt import read_srt

    log = Log()
    read_srt(text, FlightOptions(**options), log)  # type: ignore[arg-type]
    return log.flight("a")


def test_units_and_references_are_said_back() -> None:
    told = "\n".join(summary_lines(read(FLIGHTS / "airdata.csv")))
    assert "height in feet, above take-off: column 'height_above_takeoff(feet)'" in told
    assert "rate       10 Hz, without gaps" in told
    other = read(FLIGHTS / "airdata.csv", FlightOptions(altitude_reference=SEA))
    assert "above mean sea level: column 'altitude_above_seaLevel(feet)'" in "\n".join(other.stated)
    assert other.reports[0].altitude_m == pytest.approx(
        read(FLIGHTS / "airdata.csv").reports[0].altitude_m + GROUND_MSL_M, abs=0.01
    )


def test_gaps_and_what_was_dropped_are_summed_up() -> None:
    rows = [f"{1767268800 + t},40.0,-3.7,{90 if t < 30 else 91},12" for t in range(60)]
    rows[5] = rows[6] = "1767268806,0,0,90,12"
    del rows[20:35]
    text = "time,lat,lon,altitude_msl,x\n" + "\n".join(rows)
    log = Log()
    read_table(text, FlightOptions(), log)
    told = list(summary_lines(log.flight("a")))
    assert "1 gap, the longest 16 s" in told[-2]
    assert told[-1] == "dropped    2 of 45 records: position …, …: no GPS fix 2"


@given(
    interval_s=st.sampled_from([0.033, 0.1, 0.2, 0.5]),
    phase_s=st.floats(0, 0.999),
    missing=st.sets(st.integers(0, 99), max_size=30),
)
def test_a_count_makes_a_clock_of_whole_seconds_finer(
    interval_s: float, phase_s: float, missing: set[int]
) -> None:
    true_ns = [round((1_767_268_800 + phase_s + i * interval_s) * NS) for i in range(100)]
    elapsed: list[int | None] = [round(i * interval_s * 1000) * 10**6 for i in range(100)]
    coarse = [None if i in missing else t // NS * NS for i, t in enumerate(true_ns)]
    found = finer_times(coarse, elapsed, start_ns=None)
    if len({c for c in coarse if c is not None}) > 1 and not missing:
        errors_s = np.array([f - t for f, t in zip(found, true_ns, strict=True)]) / NS  # type: ignore[operator]
        assert np.abs(errors_s).max() <= interval_s + 0.002
    kept = [f for f in found if f is not None]
    assert all(a < b for a, b in pairwise(kept))


def test_a_film_that_is_slower_than_its_clock_goes_by_the_clock() -> None:
    """6 minutes of timecode in 43 of clock, such as of a time lapse."""
    coarse: list[int | None] = [1_767_268_800 * NS + i * 7 * NS for i in range(100)]
    elapsed: list[int | None] = [i * NS for i in range(100)]
    assert finer_times(coarse, elapsed, start_ns=None) == coarse


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
    assert time_of_day_ns(cell) == round(since_s * NS)


@pytest.mark.parametrize("cell", ["", "25:00:00", "13:00:00 PM", "0:00:00 AM", "noon", "1:2"])
def test_what_is_no_time_of_day_is_none(cell: str) -> None:
    assert time_of_day_ns(cell) is None


def test_the_order_of_days_and_months_is_told_by_the_days_beyond_twelve() -> None:
    assert is_day_first(["1/2/2024", "13/2/2024"]) is True
    assert is_day_first(["1/2/2024", "2/13/2024"]) is False
    assert is_day_first(["1/2/2024"]) is None
    march = round(datetime(2024, 3, 1, tzinfo=UTC).timestamp()) * NS
    assert midnight_ns("3/1/2024") == midnight_ns("2024-03-01") == march
    assert midnight_ns("1/3/2024", day_first=True) == march
    assert midnight_ns("2/30/2024") is None


def test_a_month_that_nobody_tells_is_assumed_aloud() -> None:
    flight = read(FLIGHTS / "phantomhelp.csv")
    assert "times are +0 h from UTC (utc_offset_h)" in flight.assumed
    log = Log()
    text = (FLIGHTS / "phantomhelp.csv").read_text().replace("5/14/2024", "5/4/2024")
    read_table(text, FlightOptions(), log)
    assert "dates such as 5/4/2024 have the month first" in log.assumed


def test_a_track_without_heights_says_so() -> None:
    text = (FLIGHTS / "part.kml").read_text()
    flat = text.replace("<altitudeMode>absolute</altitudeMode>", "")
    assert flat != text
    with pytest.raises(PlotfeedError, match="no height: altitudeMode is clampToGround"):
        _kml(flat)
    assert {r.altitude_m for r in _kml(flat, height_m=80.0).reports} == {80.0}
    relative = _kml(text.replace("absolute", "relativeToGround"))
    assert relative.reports[0].altitude_reference is ABOVE
    assert any("above the ground are taken" in line for line in relative.assumed)
    with pytest.raises(PlotfeedError, match="a LineString says where and not when"):
        _kml("<kml><Placemark><LineString/></Placemark></kml>")
    with pytest.raises(PlotfeedError, match="no document type"):
        _kml('<!DOCTYPE k [<!ENTITY a "b">]><kml>&a;</kml>')


def _kml(text: str, **options: object) -> Flight:
    from plotfeed.feeds.telemetry.flights.markup import read_kml

    log = Log()
    read_kml(text, FlightOptions(**options), log)  # type: ignore[arg-type]
    return log.flight("a")


def _nmea(text: str) -> Flight:
    log = Log()
    read_nmea(text, FlightOptions(), log)
    return log.flight("a")


def test_sentences_that_are_damaged_cost_themselves() -> None:
    lines = (FLIGHTS / "part.nmea").read_text().splitlines()
    whole = _nmea("\n".join(lines))
    lines[9] = lines[9].replace(",1,14,", ",1,15,")
    damaged = _nmea("\n".join(lines))
    assert len(damaged.reports) == len(whole.reports) - 1
    assert damaged.dropped == {"no fix": 2, "damaged: its checksum is wrong": 1}


def test_midnight_is_passed_between_two_dates() -> None:
    place = "4318.000000,N,00554.000000,W"
    rows = [f"$GNRMC,235958.00,A,{place},1.0,0.0,311225,,,A"]
    clocks = ("235959.00", "000000.00", "000001.00")
    rows += [f"$GNGGA,{clock},{place},1,14,0.7,100.0,M,52.0,M,," for clock in clocks]
    times = [r.t_utc_ns for r in _nmea("\n".join(rows)).reports]
    new_year = round(datetime(2026, 1, 1, tzinfo=UTC).timestamp()) * NS
    assert times == [new_year - NS, new_year, new_year + NS]


@given(st.data())
def test_logs_that_are_cut_or_damaged_anywhere_give_what_is_whole_or_a_clear_error(
    data: st.DataObject,
) -> None:
    name = data.draw(st.sampled_from(list(CASES)))
    if name == "part.ulg":
        pytest.importorskip("pyulog")
    octets = bytearray((FLIGHTS / name).read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(octets)))
        octets[at : at + data.draw(st.integers(0, 30))] = data.draw(st.binary(max_size=10))
    log = Log()
    try:
        BY_SUFFIX[Path(name).suffix](bytes(octets), FlightOptions(), log)
        flight = log.flight("a")
    except PlotfeedError as error:
        assert len(str(error)) < 1000
    else:
        assert list(summary_lines(flight))


def test_a_log_reads_as_the_library_of_px4_reads_it() -> None:
    pyulog = pytest.importorskip("pyulog")
    path = FLIGHTS / "part.ulg"
    (topic,) = (d for d in pyulog.ULog(str(path)).data_list if d.name == "vehicle_global_position")
    latitudes = [r.latitude_deg for r in read(path).reports]
    assert latitudes == topic.data["lat"][-len(latitudes) :].tolist()

"""Logs of every kind: records, columns, units and times are found, or asked for by name.

DataFlash, .tlog, ULog and NMEA have records among others; DJI's subtitles come in dialects; GPX,
KML and tables come from whatever exporter.
"""

from __future__ import annotations

import re
import struct
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from golden.make_flights import GROUND_MSL_M, geodetic
from hypothesis import given
from hypothesis import strategies as st
from support.given_files import GOLDEN
from support.given_flights import flown, places

from plotfeed.feeds.cli.inject import summary_lines
from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.autopilot_logs import gps_to_utc_ns, looks_like_tlog
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
ABOVE, SEA, GLOBE = (
    AltitudeReference.ABOVE_TAKEOFF,
    AltitudeReference.MEAN_SEA_LEVEL,
    AltitudeReference.ELLIPSOID,
)
FLIGHTS = GOLDEN / "flights"


def utc_ns(*when: int) -> int:
    return round(datetime(*when, tzinfo=UTC).timestamp()) * S  # type: ignore[misc]


# ArduPilot's DataFlash.

GPS = struct.Struct("<QBBIHBHiiifff")
GPS_COLUMNS = b"TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ"


def fmt(kind: int, octets: int, name: bytes, codes: bytes, columns: bytes) -> bytes:
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, octets, name, codes, columns)


def gps(i: int, *, status: int = 3, hdop: int = 120, alt_cm: int = 59000, **more: int) -> bytes:
    lat = -353623714 + i * 100
    satellites, receiver = more.get("satellites", 9), more.get("receiver", 0)
    values = (i * 200_000, receiver, status, 603_882_400 + i * 200, 1871, satellites, hdop)
    return b"\xa3\x95\x82" + GPS.pack(*values, lat, 1491658533, alt_cm, 5.0, 90.0, -1.5)


RECORDS = fmt(0x82, GPS.size + 3, b"GPS", b"QBBIHBcLLefff", GPS_COLUMNS)
RECORDS += fmt(0x83, 7, b"OTHR", b"I", b"Value")
OTHER = b"\xa3\x95\x83" + b"\xa3\x95\x82\x00"  # a value that looks like a record's head


def test_records_of_dataflash_are_found_among_others_and_come_in_units() -> None:
    flight = flown(".bin", RECORDS + OTHER + gps(0) + OTHER + OTHER + gps(1))
    first, second = flight.reports
    assert places(flight)[0] == pytest.approx((-35.3623714, 149.1658533, 590.0), abs=1e-12)
    assert first.altitude_reference is SEA
    assert first.velocity_enu_m_s == pytest.approx((5.0, 0.0, 1.5))
    assert second.t_utc_ns - first.t_utc_ns == 200_000_000
    assert flight.skipped == ()


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (gps(1, status=1), "GPS status 1"),
        (gps(1, hdop=9999), "HDOP 99.99"),
        (gps(1, satellites=3), "3 satellites"),
        (gps(1, receiver=1), "not the first receiver"),
        (gps(1, alt_cm=189_269), "implausible"),
        (b"garbage", "7 octets that are no known record"),
    ],
)
def test_fixes_that_cannot_be_relied_on_are_told(bad: bytes, why: str) -> None:
    flight = flown(".bin", RECORDS + gps(0) + bad + gps(2) + gps(3))
    assert len(flight.reports) == 3
    (line,) = flight.skipped
    assert line.startswith(f"offset {len(RECORDS + gps(0))}: {why}")


def test_gps_time_becomes_utc_by_the_leap_seconds_of_its_day() -> None:
    # 17 leap seconds in 2015, 18 from 2017 on.
    assert gps_to_utc_ns(1871, 603_882_400) == utc_ns(2015, 11, 21, 23, 44, 25) + 400_000_000
    assert gps_to_utc_ns(1930, 18_000) == utc_ns(2017, 1, 1)
    assert gps_to_utc_ns(1930, 16_999) == utc_ns(2017, 1, 1) - 1_000_000


def test_a_format_without_length_cannot_stall_the_reader() -> None:
    with pytest.raises(PlotfeedError):
        flown(".bin", fmt(0x90, 0, b"ZERO", b"", b"") + b"\xa3\x95\x90" * 1000)
    with pytest.raises(PlotfeedError, match="GPS record lacks Lat, Lng, Alt or Status"):
        flown(".bin", fmt(0x90, 7, b"GPS", b"I", b"TimeUS") + b"\xa3\x95\x90" + bytes(4))


# MAVLink's .tlog, PX4's ULog, and NMEA.

START_US = 1_600_000_000_000_000


def stamped(i: int, name: str, *values: int, system: int = 1, v1: bool = False) -> bytes:
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    mav = common.MAVLink(None, srcSystem=system, srcComponent=1)
    frame = getattr(mav, f"{name}_encode")(*values).pack(mav, force_mavlink1=v1)
    return (START_US + i * 200_000).to_bytes(8, "big") + bytes(frame)


def at(i: int, *, place: tuple[int, int] = (501234567, -31234567), **how: Any) -> bytes:
    more = (place[0] + 10 * i, place[1], 100_000, 5_000, 100, -200, -50, 0)
    return stamped(i, "global_position_int", i * 200, *more, **how)


@pytest.mark.parametrize("v1", [False, True])
def test_positions_of_mavlink_bear_the_stamps_of_the_log(v1: bool) -> None:
    beats = [stamped(i, "heartbeat", 2, 3, 0, 0, 0) for i in range(2)]
    data = beats[0] + at(1, v1=v1) + beats[1] + at(2, v1=v1)
    assert looks_like_tlog(data)
    flight = flown(".tlog", data)
    first, second = flight.reports
    assert first.t_utc_ns == START_US * 1000 + 200_000_000
    assert second.t_utc_ns - first.t_utc_ns == 200_000_000
    assert places(flight)[0] == pytest.approx((50.1234577, -3.1234567, 100.0), abs=1e-12)
    assert first.altitude_reference is SEA
    assert first.velocity_enu_m_s == pytest.approx((-2.0, 1.0, 0.5))
    assert flight.skipped == ()


def test_other_vehicles_zero_positions_damage_and_junk_are_told() -> None:
    damaged = bytearray(at(3))
    damaged[25] ^= 0xFF
    zero = at(4, place=(-40, 0))
    flight = flown(".tlog", at(1) + at(2, system=7) + damaged + zero + b"junk" + at(5))
    told = " ".join(flight.skipped)
    assert len(flight.reports) == 2
    for why in ("from system 7", "damaged", "no GPS fix", "4 octets that are no frame"):
        assert why in told
    like_a_frame = bytes(8) + b"\xfd\x50\x00" + bytes(10)
    assert len(flown(".tlog", at(1) + like_a_frame + at(2) + at(3)).reports) == 3


def test_a_ulog_reads_as_the_library_of_px4_reads_it() -> None:
    pyulog = pytest.importorskip("pyulog")
    path = FLIGHTS / "part.ulg"
    (topic,) = (d for d in pyulog.ULog(str(path)).data_list if d.name == "vehicle_global_position")
    latitudes = [r.latitude_deg for r in read(path).reports]
    assert latitudes == topic.data["lat"][-len(latitudes) :].tolist()
    alone = path.read_bytes().replace(b"vehicle_gps_position", b"vehicle_gps_polition")
    with pytest.raises(PlotfeedError, match="no UTC in this log"):
        flown(".ulg", alone)
    assert flown(".ulg", alone, start_utc_ns=S).reports[0].t_utc_ns > S
    with pytest.raises(PlotfeedError, match="no positions: neither vehicle_global_position nor"):
        flown(".ulg", alone.replace(b"vehicle_global_position", b"vehicle_global_polition"))


def test_sentences_of_nmea_that_are_damaged_cost_themselves_and_midnight_is_passed() -> None:
    lines = (FLIGHTS / "part.nmea").read_text().splitlines()
    whole = flown(".nmea", "\n".join(lines))
    lines[9] = lines[9].replace(",1,14,", ",1,15,")
    damaged = flown(".nmea", "\n".join(lines))
    assert len(damaged.reports) == len(whole.reports) - 1
    assert damaged.dropped == {"no fix": 2, "damaged: its checksum is wrong": 1}
    place = "4318.000000,N,00554.000000,W"
    rows = [f"$GNRMC,235958.00,A,{place},1.0,0.0,311225,,,A"]
    clocks = ("235959.00", "000000.00", "000001.00")
    rows += [f"$GNGGA,{clock},{place},1,14,0.7,100.0,M,52.0,M,," for clock in clocks]
    times = [r.t_utc_ns for r in flown(".nmea", "\n".join(rows)).reports]
    new_year = utc_ns(2026, 1, 1)
    assert times == [new_year - S, new_year, new_year + S]


# DJI's subtitles.

FILMED = utc_ns(2022, 6, 21, 16, 6, 17)


def subtitles(*lines: str, dated: bool = True) -> str:
    blocks = []
    for i, line in enumerate(lines):
        date = f"2022.06.21 16:06:{17 + i:02d}\n" if dated else ""
        blocks.append(f"{i + 1}\n00:00:{i:02d},000 --> 00:00:{i + 1:02d},000\n{date}{line}\n")
    return "\n".join(blocks)


DIALECTS = {
    "Matrice 300": "GPS(36.61{i:02d},-6.1120,0.0M) BAROMETER:{i}.5M",
    "Mavic Pro": "HOME(-6.1120,36.6100) GPS(-6.1120,36.61{i:02d},16) BAROMETER:{i}.5",
    "Mavic Mini": "F/2.8, SS 206, ISO 150, EV 0, GPS (-6.1120, 36.61{i:02d}, 15), D 2.36m, "
    "H {i}.50m, H.S 0.0m/s",
    "brackets": "[iso: 100] [latitude: 36.61{i:02d}] [longitude: -6.1120] "
    "[rel_alt: {i}.5 abs_alt: {i}.0]",
}
FILMS = {name: [line.format(i=i) for i in range(3)] for name, line in DIALECTS.items()}
MATRICE = subtitles(*FILMS["Matrice 300"])


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("dated", [True, False])
def test_every_dialect_gives_the_same_flight(dialect: str, dated: bool) -> None:
    text = subtitles(*FILMS[dialect], dated=dated)
    if not dated:
        with pytest.raises(PlotfeedError, match="start_utc_ns"):
            flown(".srt", text)
    flight = flown(".srt", text, start_utc_ns=None if dated else FILMED)
    assert places(flight) == [pytest.approx((36.61 + i / 1e4, -6.112, i + 0.5)) for i in range(3)]
    assert [r.t_utc_ns for r in flight.reports] == [FILMED + i * S for i in range(3)]
    assert flight.reports[0].altitude_reference is ABOVE
    assert flight.skipped == ()


@pytest.mark.parametrize(
    ("line", "options", "expected"),
    [
        # "longtitude" as some have it.
        ("[latitude : 1.5] [longtitude : -2.5] [rel_alt: 3.0]", {}, (1.5, -2.5, 3.0, ABOVE)),
        (FILMS["brackets"][1], {"altitude_reference": SEA}, (36.6101, -6.112, 1.0, SEA)),
        (
            "[latitude: 1.5] [longitude: 2.5] [altitude: 117.0]",
            {"altitude_reference": GLOBE},
            (1.5, 2.5, 117.0, GLOBE),
        ),
        # A value beyond 90 tells the order, whatever the dialect.
        ("GPS(149.02,-20.25,0.0M) BAROMETER:1.0M", {}, (-20.25, 149.02, 1.0, ABOVE)),
        ("GPS(-20.25,149.02,5) BAROMETER:1.0", {}, (-20.25, 149.02, 1.0, ABOVE)),
        ("GPS(36.6,-6.1,16) BAROMETER:1.0", {"gps_order": "lat-lon"}, (36.6, -6.1, 1.0, ABOVE)),
        ("GPS(36.6,-6.1,16) BAROMETER:1.0", {"gps_order": "lon-lat"}, (-6.1, 36.6, 1.0, ABOVE)),
        (FILMS["Matrice 300"][0], {"gps_order": "lon-lat"}, (-6.112, 36.61, 0.5, ABOVE)),
    ],
)
def test_places_and_heights_are_what_the_film_says_or_else_the_user(
    line: str, options: dict[str, Any], expected: tuple[Any, ...]
) -> None:
    flight = flown(".srt", subtitles(line), **options)
    assert (*places(flight)[0], flight.reports[0].altitude_reference) == expected


def test_times_of_films_are_shifted_and_read_to_the_microsecond_in_both_spellings() -> None:
    flight = flown(".srt", MATRICE, utc_offset_h=2.0)
    assert flight.reports[0].t_utc_ns == FILMED - 7200 * S
    assert any("+2 h" in line for line in flight.assumed)
    tail = "[latitude: 1.5] [longitude: 2.5] [rel_alt: 3.0 abs_alt: 9.0]\n\n"
    text = "".join(
        f"{i}\n00:00:00,000 --> 00:00:00,033\n<font>FrameCnt: 1\n2022-06-21 16:06:{when}\n{tail}"
        for i, when in enumerate(["17,774,808", "18.858"])
    )
    t = [r.t_utc_ns - FILMED for r in flown(".srt", text).reports]
    assert t == [774_808_000, 1_858_000_000]


def test_records_of_films_that_cannot_be_read_are_told_by_line() -> None:
    first, _, last = FILMS["Matrice 300"]
    lines = [first, "GPS(n/a) BAROMETER:1.0M", "GPS(0.0,0.0,0.0M) BAROMETER:1.0M", last]
    lines.append("GPS(36.6104,-6.1120,0.0M)")
    flight = flown(".srt", subtitles(*lines))
    assert len(flight.reports) == 2
    assert [line.partition(":")[0] for line in flight.skipped] == ["line 7", "line 12", "line 22"]
    assert flight.skipped[-1].endswith("no BAROMETER, which other blocks have")


def test_a_byte_order_mark_and_an_odd_suffix_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(b"\xef\xbb\xbf" + MATRICE.replace("\n", "\r\n").encode())
    assert len(read(path).reports) == 3


# GPX and KML, and what such files may not do to their reader.

POINTS = [
    f'<trkpt lat="50.0" lon="{3 + i / 1e5}"><ele>{100 + i}</ele>'
    f"<time>2022-05-01T00:00:0{i}Z</time></trkpt>"
    for i in range(4)
]


def gpx(*points: str) -> str:
    head = '<gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1">'
    return f'<?xml version="1.0"?>{head}<trk><trkseg>{"".join(points)}</trkseg></trk></gpx>'


def test_track_points_are_above_sea_level_unless_told_and_those_that_are_not_whole_are_told() -> (
    None
):
    flight = flown(".gpx", gpx(*POINTS))
    assert [r.altitude_m for r in flight.reports] == [100.0, 101.0, 102.0, 103.0]
    assert flight.reports[0].t_utc_ns == utc_ns(2022, 5, 1)
    assert flight.reports[0].altitude_reference is SEA
    assert any("mean sea level" in line for line in flight.assumed)
    told = flown(".gpx", gpx(*POINTS), altitude_reference=GLOBE)
    assert told.reports[0].altitude_reference is GLOBE
    assert told.assumed == ()
    bare = '<trkpt lat="50" lon="3"></trkpt>'
    no_elevation = '<trkpt lat="50" lon="3"><time>2022-05-01T00:00:09Z</time></trkpt>'
    noon = POINTS[0].replace("2022-05-01T00:00:00Z", "noon")
    flight = flown(".gpx", gpx(*POINTS, bare, no_elevation, noon))
    assert len(flight.reports) == 4
    assert flight.skipped == (
        "track point 5: no time",
        "track point 6: no elevation",
        "track point 7: no time, position or elevation that can be read",
    )
    text = gpx(*POINTS)
    flight = flown(".gpx", text[: text.index(POINTS[2]) + 30])
    assert len(flight.reports) == 2
    assert "cut short" in flight.skipped[0]


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "utf-7", "cp037"]
)
def test_no_encoding_hides_a_document_type(tmp_path: Path, encoding: str) -> None:
    levels = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    bomb = f'<!DOCTYPE g [<!ENTITY e0 "1234567890">{levels}]>'
    text = gpx(*POINTS).replace("<gpx", bomb + "<gpx").replace("<ele>", "<name>&e9;</name><ele>")
    text = re.sub("<[?]xml.*?[?]>", "", text)
    path = tmp_path / "a.gpx"
    path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>{text}'.encode(encoding))
    with pytest.raises(PlotfeedError) as refused:
        read(path)
    assert len(str(refused.value)) < 500
    assert encoding != "utf-8" or "document type" in str(refused.value)


def test_a_track_of_kml_without_heights_says_so_and_placemarks_are_read() -> None:
    text = (FLIGHTS / "part.kml").read_text()
    flat = text.replace("<altitudeMode>absolute</altitudeMode>", "")
    assert flat != text
    with pytest.raises(PlotfeedError, match="no height: altitudeMode is clampToGround"):
        flown(".kml", flat)
    assert {r.altitude_m for r in flown(".kml", flat, height_m=80.0).reports} == {80.0}
    relative = flown(".kml", text.replace("absolute", "relativeToGround"))
    assert relative.reports[0].altitude_reference is ABOVE
    assert any("above the ground are taken" in line for line in relative.assumed)
    told = flown(".kml", text, altitude_reference=GLOBE)
    assert told.reports[0].altitude_reference is GLOBE
    with pytest.raises(PlotfeedError, match="a LineString says where and not when"):
        flown(".kml", "<kml><Placemark><LineString/></Placemark></kml>")
    mark = (
        "<Placemark><TimeStamp><when>2024-05-14T09:30:20Z</when></TimeStamp><Point><altitudeMode>"
        "absolute</altitudeMode><coordinates>{1:.7f},{0:.7f},9</coordinates></Point></Placemark>"
    ).format(*geodetic(20.0))
    uneven = "<Track><when>x</when><when>y</when><coord>1 2 3</coord></Track>"
    flight = flown(".kml", f"<kml>{mark}{uneven}</kml>")
    assert [r.altitude_m for r in flight.reports] == [9.0]
    assert flight.skipped[0] == "point 2: 2 times of 1 coordinates"


# Tables.

TABLE = """\
time,lat,lon,altitude (m),Vx m/s,Vy m/s
2019-12-09 10:49:35,50.0,-30.0,708.0,1.5,-2.5
2019-12-09 10:49:36,50.0,-30.00002,709.0,1.5,-2.5
"""
VX = {"velocity_east_m_s": "Vx m/s", "velocity_north_m_s": "Vy m/s"}


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
    assert parse_time_ns(cell, offset_h) == utc_ns(2019, 12, 9, 10, 49, 35) + since_ns


def test_times_of_day_and_dates_are_read_as_people_write_them() -> None:
    for cell, since_s in (
        ("11:24:29.64 AM", 41069.64),
        ("12:00:00 AM", 0.0),
        ("12:30:00 PM", 45000.0),
        ("1:02:03.5 p.m.", 46923.5),
        ("23:04:05", 83045.0),
    ):
        assert time_of_day_ns(cell) == round(since_s * S)
    assert is_day_first(["1/2/2024", "13/2/2024"]) is True
    assert is_day_first(["1/2/2024", "2/13/2024"]) is False
    assert is_day_first(["1/2/2024"]) is None
    march = utc_ns(2024, 3, 1)
    assert midnight_ns("3/1/2024") == midnight_ns("2024-03-01") == march
    assert midnight_ns("1/3/2024", day_first=True) == march


def test_what_is_no_time_is_none() -> None:
    for cell in ("", "noon", "38975.0", "-5", "nan", "inf", "1e999999", "9" * 99):
        assert parse_time_ns(cell, 0.0) is None
    for cell in ("", "25:00:00", "13:00:00 PM", "0:00:00 AM", "noon", "1:2"):
        assert time_of_day_ns(cell) is None
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
    flight = flown(".csv", TABLE, columns=VX, altitude_reference=SEA)
    assert repr(flight.reports[0].velocity_enu_m_s) == "(1.5, -2.5, nan)"
    text = "# drone 7\n\nlongitude;height;latitude;epoch\n-30;5;50;1575888575\n"
    assert places(flown(".csv", text, altitude_reference=SEA)) == [(50.0, -30.0, 5.0)]
    # A height whose name says above what it is comes before one that does not.
    rows = "time,lat,lon,altitude (m),height_above_takeoff (m)\n1575888575,50,-30,700,5\n"
    (report,) = flown(".csv", rows).reports
    assert (report.altitude_m, report.altitude_reference) == (5.0, ABOVE)


def test_velocities_and_accuracies_come_in_the_units_of_their_columns() -> None:
    factors = {"m/s": 1.0, "km/h": 1 / 3.6, "kt": 1852 / 3600, "ft/s": 0.3048, "mph": 0.44704}
    for unit, m_s in factors.items():
        head = f"time,lat,lon,altitude_msl (ft),velocity_east ({unit}),hacc (ft)"
        (report,) = flown(".csv", f"{head}\n1575888575,50,-30,100,36,10\n").reports
        assert report.velocity_enu_m_s[0] == pytest.approx(36 * m_s)
        assert (report.altitude_m, report.horizontal_accuracy_m) == pytest.approx((30.48, 3.048))


COUNTED = TABLE.replace("time", "elapsed (s)").replace("2019-12-09 10:49:", "")
FURLONGS = {"altitude_m": "altitude (furlong)"}


@pytest.mark.parametrize(
    ("suffix", "text", "options", "asks"),
    [
        (".srt", "[latitude: 1.5] [longitude: 2.5] [altitude: 117.0]", {}, "--set altitude_ref"),
        (".srt", "GPS(36.6,-6.1,16) BAROMETER:1.0", {}, "--set gps_order"),
        (".srt", "GPS(-6.1,36.61,16) HOME(-6.1,36.6) Hx:1.0", {}, "no heights: expected BAROM.*Hb"),
        (".srt", "Good evening.", {}, "no positions"),
        (".csv", TABLE, {"columns": {"latitude_deg": "breite"}}, "breite.*columns are time, lat"),
        (".csv", TABLE, {"columns": {"colour": "lat"}}, "colour.*expected one of time, latitude_d"),
        (".csv", TABLE.replace("lat", "breite"), {}, r"--set columns\.latitude_deg=NAME"),
        (".csv", TABLE, {}, "--set altitude_reference"),
        (".csv", TABLE.replace("altitude", "x"), {}, r"columns\.altitude_m=NAME.*--set height_m"),
        (".csv", TABLE.replace("time", "x"), {"altitude_reference": SEA}, "no column.*for time"),
        (".csv", COUNTED, {"altitude_reference": SEA}, "start_utc_ns"),
        (".csv", "# nothing\n", {}, "empty table"),
        (".csv", TABLE.replace("(m)", "(furlong)"), {"columns": FURLONGS}, "no"),
    ],
)
def test_what_a_log_does_not_say_is_asked_for_by_name(
    suffix: str, text: str, options: dict[str, object], asks: str
) -> None:
    with pytest.raises(PlotfeedError, match=asks):
        flown(suffix, subtitles(text) if suffix == ".srt" else text, **options)


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
    counts = ("39", "-1", "nan", "1e999", "1000000.1", "1e6", "noon")
    text = COUNTED + "".join(f"{count},50,-30,700,0,0\n" for count in counts)
    flight = flown(".csv", text, altitude_reference=SEA, start_utc_ns=S)
    assert [r.t_utc_ns // S for r in flight.reports][-2:] == [40, 1_000_001]
    assert [line.partition(":")[0] for line in flight.skipped] == [
        f"line {n}" for n in (5, 6, 7, 8, 10)
    ]


def test_what_was_understood_assumed_and_dropped_is_said_back() -> None:
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
    rows = [f"{1767268800 + t},40.0,-3.7,{90 if t < 30 else 91},12" for t in range(60)]
    rows[5] = rows[6] = "1767268806,0,0,90,12"
    del rows[20:35]
    lines = list(summary_lines(flown(".csv", "\n".join(["time,lat,lon,altitude_msl,x", *rows]))))
    assert "1 gap, the longest 16 s" in lines[-2]
    assert lines[-1] == "dropped    2 of 45 records: position …, …: no GPS fix 2"

from __future__ import annotations

import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.flights.autopilot_logs import gps_to_utc_ns, read_dataflash
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

GPS = struct.Struct("<QBBIHBHiiifff")
GPS_COLUMNS = b"TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ"
GPS_CODES = b"QBBIHBcLLefff"


def fmt(kind: int, octets: int, name: bytes, codes: bytes, columns: bytes) -> bytes:
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, octets, name, codes, columns)


def gps(i: int, *, status: int = 3, hdop: int = 120, alt_cm: int = 59000, **more: int) -> bytes:
    lat = -353623714 + i * 100
    satellites, receiver = more.get("satellites", 9), more.get("receiver", 0)
    values = (i * 200_000, receiver, status, 603_882_400 + i * 200, 1871, satellites, hdop)
    return b"\xa3\x95\x82" + GPS.pack(*values, lat, 1491658533, alt_cm, 5.0, 90.0, -1.5)


HEAD = fmt(0x82, GPS.size + 3, b"GPS", GPS_CODES, GPS_COLUMNS) + fmt(
    0x83, 7, b"OTHR", b"I", b"Value"
)
OTHER = b"\xa3\x95\x83" + b"\xa3\x95\x82\x00"  # a value that looks like a record's head


def flown(data: bytes) -> Flight:
    log = Log()
    read_dataflash(data, FlightOptions(), log)
    return log.flight("a")


def test_records_are_found_among_others_and_come_in_units() -> None:
    flight = flown(HEAD + OTHER + gps(0) + OTHER + OTHER + gps(1))
    first, second = flight.reports
    assert first.latitude_deg == pytest.approx(-35.3623714, abs=1e-12)
    assert first.longitude_deg == pytest.approx(149.1658533, abs=1e-12)
    assert first.altitude_m == 590.0
    assert first.altitude_reference is AltitudeReference.MEAN_SEA_LEVEL
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
    flight = flown(HEAD + gps(0) + bad + gps(2) + gps(3))
    assert len(flight.reports) == 3
    (line,) = flight.skipped
    assert line.startswith(f"offset {len(HEAD + gps(0))}: {why}")


def test_first_fixes_at_a_wrong_height_are_left_out() -> None:
    wrong = [gps(i, alt_cm=130_000 + 2000 * i) for i in range(3)]
    flight = flown(HEAD + b"".join(wrong) + b"".join(gps(i) for i in range(3, 20)))
    assert len(flight.reports) == 17
    assert len(flight.skipped) == 3
    assert {r.altitude_m for r in flight.reports} == {590.0}


def test_gps_time_becomes_utc_by_the_leap_seconds_of_its_day() -> None:
    # 2015-11-21 23:44:25.4 UTC: 17 leap seconds; 2017-01-01 00:00:00 UTC: 18.
    assert gps_to_utc_ns(1871, 603_882_400) == 1_448_149_465_400_000_000
    assert gps_to_utc_ns(1930, 18_000) == 1_483_228_800_000_000_000
    assert gps_to_utc_ns(1930, 16_999) == 1_483_228_799_999_000_000


@given(st.integers(0, 400), st.binary(max_size=40), st.integers(0, 40))
def test_a_log_cut_or_damaged_anywhere_gives_what_is_whole(at: int, junk: bytes, lost: int) -> None:
    whole = HEAD + b"".join(gps(i) + OTHER for i in range(5))
    with suppress(PlotfeedError):
        flight = flown(whole[:at] + junk + whole[at + lost :])
        times = [r.t_utc_ns for r in flight.reports]
        assert times == sorted(set(times))


def test_a_format_without_length_cannot_stall_the_reader() -> None:
    with pytest.raises(PlotfeedError):
        flown(fmt(0x90, 0, b"ZERO", b"", b"") + b"\xa3\x95\x90" * 1000)

"""DataFlash, .tlog and NMEA: records among others, in their units, and what cannot be relied on."""

from __future__ import annotations

import struct
from datetime import UTC, datetime
from typing import Any

import pytest
from support.given_files import GOLDEN
from support.given_flights import flown, places

from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.autopilot_logs import gps_to_utc_ns, looks_like_tlog
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

NS = 1_000_000_000
SEA = AltitudeReference.MEAN_SEA_LEVEL
GPS = struct.Struct("<QBBIHBHiiifff")
GPS_COLUMNS = b"TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ"


def fmt(kind: int, octets: int, name: bytes, codes: bytes, columns: bytes) -> bytes:
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, octets, name, codes, columns)


def gps(i: int, *, status: int = 3, hdop: int = 120, alt_cm: int = 59000, **more: int) -> bytes:
    lat = -353623714 + i * 100
    satellites, receiver = more.get("satellites", 9), more.get("receiver", 0)
    values = (i * 200_000, receiver, status, 603_882_400 + i * 200, 1871, satellites, hdop)
    return b"\xa3\x95\x82" + GPS.pack(*values, lat, 1491658533, alt_cm, 5.0, 90.0, -1.5)


HEAD = fmt(0x82, GPS.size + 3, b"GPS", b"QBBIHBcLLefff", GPS_COLUMNS)
HEAD += fmt(0x83, 7, b"OTHR", b"I", b"Value")
OTHER = b"\xa3\x95\x83" + b"\xa3\x95\x82\x00"  # a value that looks like a record's head


def test_records_of_dataflash_are_found_among_others_and_come_in_units() -> None:
    flight = flown(".bin", HEAD + OTHER + gps(0) + OTHER + OTHER + gps(1))
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
    flight = flown(".bin", HEAD + gps(0) + bad + gps(2) + gps(3))
    assert len(flight.reports) == 3
    (line,) = flight.skipped
    assert line.startswith(f"offset {len(HEAD + gps(0))}: {why}")


def test_first_fixes_at_a_wrong_height_are_left_out() -> None:
    wrong = [gps(i, alt_cm=130_000 + 2000 * i) for i in range(3)]
    flight = flown(".bin", HEAD + b"".join(wrong) + b"".join(gps(i) for i in range(3, 20)))
    assert (len(flight.reports), len(flight.skipped)) == (17, 3)
    assert {r.altitude_m for r in flight.reports} == {590.0}


def test_gps_time_becomes_utc_by_the_leap_seconds_of_its_day() -> None:
    # 2015-11-21 23:44:25.4 UTC: 17 leap seconds; 2017-01-01 00:00:00 UTC: 18.
    assert gps_to_utc_ns(1871, 603_882_400) == 1_448_149_465_400_000_000
    assert gps_to_utc_ns(1930, 18_000) == 1_483_228_800_000_000_000
    assert gps_to_utc_ns(1930, 16_999) == 1_483_228_799_999_000_000


def test_a_format_without_length_cannot_stall_the_reader() -> None:
    with pytest.raises(PlotfeedError):
        flown(".bin", fmt(0x90, 0, b"ZERO", b"", b"") + b"\xa3\x95\x90" * 1000)
    with pytest.raises(PlotfeedError, match="GPS record lacks Lat, Lng, Alt or Status"):
        flown(".bin", fmt(0x90, 7, b"GPS", b"I", b"TimeUS") + b"\xa3\x95\x90" + bytes(4))


START_US = 1_600_000_000_000_000


def vehicle(system: int = 1) -> Any:
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    return common.MAVLink(None, srcSystem=system, srcComponent=1)


def at(i: int, *, system: int = 1, v1: bool = False, place: Any = (501234567, -31234567)) -> bytes:
    mav = vehicle(system)
    more = (place[0] + 10 * i, place[1], 100_000, 5_000, 100, -200, -50, 0)
    return stamped(i, mav.global_position_int_encode(i * 200, *more).pack(mav, force_mavlink1=v1))


def heartbeat(i: int) -> bytes:
    mav = vehicle()
    return stamped(i, mav.heartbeat_encode(2, 3, 0, 0, 0).pack(mav))


def stamped(i: int, frame: bytes) -> bytes:
    return (START_US + i * 200_000).to_bytes(8, "big") + frame


@pytest.mark.parametrize("v1", [False, True])
def test_positions_of_mavlink_bear_the_stamps_of_the_log(v1: bool) -> None:
    data = heartbeat(0) + at(1, v1=v1) + heartbeat(1) + at(2, v1=v1)
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


def test_sentences_of_nmea_that_are_damaged_cost_themselves() -> None:
    lines = (GOLDEN / "flights" / "part.nmea").read_text().splitlines()
    whole = flown(".nmea", "\n".join(lines))
    lines[9] = lines[9].replace(",1,14,", ",1,15,")
    damaged = flown(".nmea", "\n".join(lines))
    assert len(damaged.reports) == len(whole.reports) - 1
    assert damaged.dropped == {"no fix": 2, "damaged: its checksum is wrong": 1}


def test_midnight_is_passed_between_two_dates_of_nmea() -> None:
    place = "4318.000000,N,00554.000000,W"
    rows = [f"$GNRMC,235958.00,A,{place},1.0,0.0,311225,,,A"]
    clocks = ("235959.00", "000000.00", "000001.00")
    rows += [f"$GNGGA,{clock},{place},1,14,0.7,100.0,M,52.0,M,," for clock in clocks]
    times = [r.t_utc_ns for r in flown(".nmea", "\n".join(rows)).reports]
    new_year = round(datetime(2026, 1, 1, tzinfo=UTC).timestamp()) * NS
    assert times == [new_year - NS, new_year, new_year + NS]


def test_a_ulog_reads_as_the_library_of_px4_reads_it() -> None:
    pyulog = pytest.importorskip("pyulog")
    path = GOLDEN / "flights" / "part.ulg"
    (topic,) = (d for d in pyulog.ULog(str(path)).data_list if d.name == "vehicle_global_position")
    latitudes = [r.latitude_deg for r in read(path).reports]
    assert latitudes == topic.data["lat"][-len(latitudes) :].tolist()
    alone = path.read_bytes().replace(b"vehicle_gps_position", b"vehicle_gps_polition")
    with pytest.raises(PlotfeedError, match="no UTC in this log"):
        flown(".ulg", alone)
    assert flown(".ulg", alone, start_utc_ns=NS).reports[0].t_utc_ns > NS
    with pytest.raises(PlotfeedError, match="no positions: neither vehicle_global_position nor"):
        flown(".ulg", alone.replace(b"vehicle_global_position", b"vehicle_global_polition"))

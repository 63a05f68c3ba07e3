from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.flights.autopilot_logs import looks_like_tlog, read_tlog
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.models.state import AltitudeReference

common = pytest.importorskip("pymavlink.dialects.v20.common")
START_US = 1_600_000_000_000_000


def record(
    i: int, *, system: int = 1, v1: bool = False, lat: int = 501234567, lon: int = -31234567
) -> bytes:
    mav: Any = common.MAVLink(None, srcSystem=system, srcComponent=1)
    position = (lat + 10 * i, lon, 100_000, 5_000)
    message = mav.global_position_int_encode(i * 200, *position, 100, -200, -50, 0)
    return stamped(i, message.pack(mav, force_mavlink1=v1))


def heartbeat(i: int) -> bytes:
    mav: Any = common.MAVLink(None, srcSystem=1, srcComponent=1)
    return stamped(i, mav.heartbeat_encode(2, 3, 0, 0, 0).pack(mav))


def stamped(i: int, frame: bytes) -> bytes:
    return (START_US + i * 200_000).to_bytes(8, "big") + frame


def flown(data: bytes) -> Flight:
    log = Log()
    read_tlog(data, FlightOptions(), log)
    return log.flight("a")


@pytest.mark.parametrize("v1", [False, True])
def test_positions_bear_the_stamps_of_the_log(v1: bool) -> None:
    data = heartbeat(0) + record(1, v1=v1) + heartbeat(1) + record(2, v1=v1)
    assert looks_like_tlog(data)
    flight = flown(data)
    first, second = flight.reports
    assert first.t_utc_ns == START_US * 1000 + 200_000_000
    assert second.t_utc_ns - first.t_utc_ns == 200_000_000
    assert first.latitude_deg == pytest.approx(50.1234577, abs=1e-12)
    assert first.altitude_m == 100.0
    assert first.altitude_reference is AltitudeReference.MEAN_SEA_LEVEL
    assert first.velocity_enu_m_s == pytest.approx((-2.0, 1.0, 0.5))
    assert flight.skipped == ()


def test_other_vehicles_zero_positions_and_damage_are_told() -> None:
    damaged = bytearray(record(3))
    damaged[25] ^= 0xFF
    zero = record(4, lat=-40, lon=0)
    data = record(1) + record(2, system=7) + damaged + zero + b"junk" + record(5)
    flight = flown(data)
    told = " ".join(flight.skipped)
    assert len(flight.reports) == 2
    assert "from system 7" in told
    assert "damaged" in told
    assert "no GPS fix" in told
    assert "4 octets that are no frame" in told


def test_junk_that_looks_like_a_frame_swallows_no_real_one() -> None:
    junk = bytes(8) + b"\xfd\x50\x00" + bytes(10)
    assert len(flown(record(1) + junk + record(2) + record(3)).reports) == 3


@given(st.integers(0, 250), st.binary(max_size=40), st.integers(0, 40))
def test_a_log_cut_or_damaged_anywhere_gives_what_is_whole(at: int, junk: bytes, lost: int) -> None:
    whole = b"".join(record(i) + heartbeat(i) for i in range(4))
    flight = flown(whole[:at] + junk + whole[at + lost :])
    assert 1 <= len(flight.reports) <= 4

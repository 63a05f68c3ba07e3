"""What receivers of ADS-B hand on becomes reports of aircraft, each with its height and echo."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from plotfeed.feeds.telemetry.live.aircraft import (
    GLIDER,
    HEAVY,
    LIGHT,
    OF_EMITTER_MAVLINK,
    ROTORCRAFT,
    AircraftReports,
)
from plotfeed.feeds.telemetry.live.heard import HeardReport
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.asterix.decode_cooperative import read_021

S = 1_000_000_000
NOW = 1_767_225_600 * S
EVEN, ODD, VELOCITY = (
    bytes.fromhex(text)
    for text in (
        "8D40621D58C382D690C8AC2863A7",
        "8D40621D58C386435CC412692AD6",
        "8D485020994409940838175B284F",
    )
)

# Of half a second past midnight, as libasterix writes it.
A_BLOCK = bytes.fromhex("1500160319400e666666feaf385348441200004003e8")
# Likewise, in edition 0.26.
AN_OLD_BLOCK = bytes.fromhex("150022bd21c180010200004000733333fff579be48441203e80320ff9c03e840000d")


def beast(message: bytes) -> bytes:
    return b"\x1a3" + (bytes(7) + message).replace(b"\x1a", b"\x1a\x1a")


def hear(listener: AircraftReports, data: bytes, now_ns: int = NOW) -> list[HeardReport]:
    return list(listener.hear("1.2.3.4:5", data, now_ns))


def report(heard: list[HeardReport]) -> PositionReport:
    (only,) = heard
    assert isinstance(only.said, PositionReport)
    return only.said


def refused(heard: list[HeardReport]) -> Refused:
    (only,) = heard
    assert isinstance(only.said, Refused)
    return only.said


def line(kind: int, **cells: object) -> bytes:
    row = ["MSG", str(kind), "1", "1", "484412", "1", *["x"] * 4, *[""] * 12]
    for name, value in cells.items():
        row[int(name[1:])] = str(value)
    return ",".join(row).encode() + b"\r\n"


def test_lines_of_sbs_1_are_put_together() -> None:
    listener = AircraftReports("sbs1", "{callsign}")
    said = line(1, c10="KLM1023 ") + line(4, c12=100, c13=90, c16=-640) + b"\r\n"
    assert hear(listener, said) == []
    place = line(3, c11=10_000, c14=52.25, c15=3.9)
    heard = hear(listener, place[:20]) + hear(listener, place[20:], NOW + S)
    found = report(heard)
    assert heard[0].drone == "KLM1023"
    assert (found.latitude_deg, found.longitude_deg) == (52.25, 3.9)
    assert found.altitude_m == pytest.approx(3048)
    assert found.altitude_reference is AltitudeReference.MEAN_SEA_LEVEL
    assert found.velocity_enu_m_s == pytest.approx((51.444, 0, -3.2512), abs=1e-3)
    assert found.t_utc_ns == NOW + S
    old = report(hear(listener, place, NOW + 60 * S))
    assert np.isnan(old.velocity_enu_m_s).all()


def test_an_aircraft_without_an_altitude_or_a_place_is_not_taken() -> None:
    listener = AircraftReports("sbs1", "{icao}")
    assert hear(listener, line(3, c11=1000)) == []
    heard = hear(listener, line(3, c14=52.0, c15=3.0))
    assert (heard[0].drone, refused(heard).reason) == ("484412", Reason.ALTITUDE)
    assert refused(hear(listener, b"HTTP/1.1 200 OK\r\n")).reason is Reason.UNDECODABLE


def test_the_pressure_of_the_day_makes_altitudes_above_the_sea() -> None:
    place = line(3, c11=1000, c14=52.0, c15=3.0)
    usual, high = (
        report(hear(AircraftReports("sbs1", "a", qnh), place)).altitude_m for qnh in (None, 1030.0)
    )
    assert high - usual == pytest.approx(16.75 * 8.23)


def test_two_halves_make_a_place_if_they_are_near_in_time_and_one_then_keeps_it() -> None:
    listener = AircraftReports("beast", "{icao}")
    assert hear(listener, beast(ODD)) == []
    assert hear(listener, beast(EVEN), NOW + 11 * S) == []
    found = report(hear(listener, beast(ODD), NOW + 12 * S))
    assert (found.latitude_deg, found.longitude_deg) == pytest.approx((52.2658, 3.9389), abs=1e-4)
    assert found.altitude_m == pytest.approx(38_000 * 0.3048)
    again = report(hear(listener, beast(EVEN), NOW + 23 * S))
    assert (again.latitude_deg, again.longitude_deg) == pytest.approx((52.2572021, 3.9193725))


def test_where_gnss_and_pressure_are_told_apart_the_height_is_over_the_ellipsoid() -> None:
    listener = AircraftReports("beast", "{icao}")
    hear(listener, beast(VELOCITY))
    aircraft = listener._of("485020")
    assert aircraft.geometric_less_pressure_m == pytest.approx(550 * 0.3048)
    assert math.hypot(*aircraft.velocity[:2]) == pytest.approx(159.2 * 0.51444, abs=0.1)
    listener._aircraft["40621d"] = aircraft
    hear(listener, beast(ODD))
    found = report(hear(listener, beast(EVEN), NOW + S))
    assert found.altitude_reference is AltitudeReference.ELLIPSOID
    assert found.altitude_m == pytest.approx(38_550 * 0.3048)


def test_blocks_of_021_are_taken_from_datagrams_and_streams_unless_laid_out_otherwise() -> None:
    listener = AircraftReports("asterix-021", "{icao}")
    heard = hear(listener, A_BLOCK[:9]) + hear(listener, A_BLOCK[9:] + b"\x15")
    found = report(heard)
    assert found.altitude_reference is AltitudeReference.ELLIPSOID
    assert found.t_utc_ns == NOW + S // 2
    other = refused(hear(AircraftReports("asterix-021", "{icao}"), AN_OLD_BLOCK))
    assert "no ASTERIX 021 of editions 2.1 to 2.7: octet" in other.detail


@pytest.mark.parametrize(
    ("emitter", "of_sensors"),
    [
        (0, (2.0, 14.6, "aircraft")),  # says nothing
        (1, (1.0, 11.0, "aircraft")),
        (5, (100.0, 60.9, "aircraft")),
        (13, (math.nan, math.nan, "")),  # unmanned
    ],
)
def test_an_aircraft_is_to_sensors_what_its_category_says(
    emitter: int, of_sensors: tuple[float, float, str]
) -> None:
    listener = AircraftReports("asterix-021", "{icao}")
    said = replace(read_021(A_BLOCK)[0], emitter=emitter)
    found = report([listener._of_block(said, NOW)])
    assert (found.rcs_m2, found.size_m, found.target_class) == of_sensors


def test_sets_a_and_b_are_counted_through_in_mavlink() -> None:
    # ADSB_EMITTER_TYPE of MAVLink: LIGHT 1, HEAVY 5, ROTOCRAFT 7, GLIDER 9, ULTRA_LIGHT 12, UAV 14.
    expected = {1: LIGHT, 5: HEAVY, 7: ROTORCRAFT, 9: GLIDER, 12: GLIDER, 14: None}
    assert expected.items() <= dict(OF_EMITTER_MAVLINK).items()

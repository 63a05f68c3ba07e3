"""Extended squitters are read as another decoder reads them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.proto.mode_s import (
    CprPosition,
    GroundVelocity,
    Identification,
    global_position,
    is_whole,
    local_position,
    longitude_zones,
    read_squitter,
)

rs1090 = pytest.importorskip("rs1090")
EVEN = bytes.fromhex("8D40621D58C382D690C8AC2863A7")
ODD = bytes.fromhex("8D40621D58C386435CC412692AD6")
VELOCITY = bytes.fromhex("8D485020994409940838175B284F")
CALLSIGN = bytes.fromhex("8D4840D6202CC371C32CE0576098")


def with_parity(first: bytes) -> bytes:
    """88 bits and the 24 that make the message whole."""
    value = int.from_bytes(first, "big") << 24
    for shift in range(87, -1, -1):
        if value >> (shift + 24) & 1:
            value ^= 0x1FFF409 << shift
    return first + value.to_bytes(3, "big")


def half(latitude_deg: float, longitude_deg: float, *, odd: bool) -> CprPosition:
    """As an aircraft encodes where it is: DO-260B, A.1.7.3."""
    zone_deg = 360 / (60 - odd)
    across = round((1 << 17) * (latitude_deg % zone_deg) / zone_deg)
    seen_deg = zone_deg * (across / (1 << 17) + math.floor(latitude_deg / zone_deg))
    part_deg = 360 / max(longitude_zones(seen_deg) - odd, 1)
    along = round((1 << 17) * (longitude_deg % part_deg) / part_deg)
    whole = 1 << 17
    return CprPosition(odd, across % whole / whole, along % whole / whole, 1000.0, False)


def test_known_messages_say_what_they_are_known_to_say() -> None:
    found = [read_squitter(m) for m in (EVEN, ODD, VELOCITY, CALLSIGN)]
    (icao, even), (_, odd), (_, velocity), (_, who) = (each or ("", None) for each in found)
    assert icao == "40621d"
    assert isinstance(even, CprPosition)
    assert isinstance(odd, CprPosition)
    assert even.altitude_ft == 38_000
    assert global_position(even, odd, latest_is_odd=False) == pytest.approx((52.2572021, 3.9193725))
    theirs = rs1090.decode([EVEN.hex(), ODD.hex()], timestamp=[1.0, 2.0])[-1]
    expected = theirs["latitude"], theirs["longitude"]
    assert global_position(even, odd, latest_is_odd=True) == pytest.approx(expected)
    assert isinstance(velocity, GroundVelocity)
    told = rs1090.decode(VELOCITY.hex())
    speed_kt = math.hypot(velocity.east_kt, velocity.north_kt)
    assert speed_kt == pytest.approx(told["groundspeed"])
    assert math.degrees(math.atan2(velocity.east_kt, velocity.north_kt)) % 360 == pytest.approx(
        told["track"]
    )
    assert velocity.climb_ft_min == told["vertical_rate"] == -832
    assert velocity.geometric_less_pressure_ft == told["geo_minus_baro"] == 550
    assert who == Identification("KLM1023", "A0")


@given(st.integers(0, 2**56 - 1), st.sampled_from([9, 11, 18, 19, 20, 22]))
def test_any_message_says_what_another_decoder_reads(field: int, kind: int) -> None:
    field = field & ((1 << 51) - 1) | kind << 51
    message = with_parity(b"\x8d\x40\x62\x1d" + field.to_bytes(7, "big"))
    assert is_whole(message)
    found, theirs = read_squitter(message), rs1090.decode(message.hex()) or {}
    if found is None:
        return
    said = found[1]
    if isinstance(said, CprPosition) and "lat_cpr" in theirs:
        assert round(said.latitude * (1 << 17)) == theirs["lat_cpr"]
        assert round(said.longitude * (1 << 17)) == theirs["lon_cpr"]
        assert theirs["parity"] == ("odd" if said.is_odd else "even")
        if not math.isnan(said.altitude_ft) and not said.is_geometric and said.altitude_ft >= 0:
            assert theirs["altitude"] == said.altitude_ft
    if isinstance(said, GroundVelocity) and "groundspeed" in theirs:
        speed_kt = math.hypot(said.east_kt, said.north_kt)
        # Of subtype 2 a step is of 4 knots (DO-260B, 2.2.3.2.6.1); the other decoder counts one.
        step_kt = 4 if field >> 48 & 7 == 2 else 1
        assert speed_kt == pytest.approx(step_kt * theirs["groundspeed"])


@given(st.floats(-86, 86), st.floats(-180, 179.99), st.booleans())
def test_a_place_comes_back_from_its_halves(lat: float, lon: float, latest_is_odd: bool) -> None:
    even, odd = half(lat, lon, odd=False), half(lat, lon, odd=True)
    found = global_position(even, odd, latest_is_odd=latest_is_odd)
    near = local_position(odd if latest_is_odd else even, (lat + 0.05, lon))
    for place in (found, near):
        if place is not None:  # where the halves are of different numbers of zones
            assert place[0] == pytest.approx(lat, abs=1e-4)
            apart_deg = (place[1] - lon + 180) % 360 - 180
            assert abs(apart_deg) * math.cos(math.radians(lat)) < 3e-3 * (abs(lat) > 80) + 2e-4


@given(st.integers(0, 111))
def test_a_message_with_a_wrong_bit_is_none(bit: int) -> None:
    damaged = (int.from_bytes(EVEN, "big") ^ 1 << bit).to_bytes(14, "big")
    assert read_squitter(damaged) is None

"""Open Drone ID messages are read as the standard writes them; others are errors of one kind."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.open_drone_id import OdidIdentity, OdidLocation, messages_in

# As opendroneid-core-c encodes it.
AIRBORNE = bytes.fromhex("12222364fe595e1c18b3ddc6fd600dc30d48084b33aa470200")


def location(octets: bytes) -> OdidLocation:
    (found,) = messages_in(bytes(octets))
    assert isinstance(found, OdidLocation)
    return found


def test_a_location_is_read_as_its_encoder_was_given_it() -> None:
    found = location(AIRBORNE)
    assert found.latitude_deg == pytest.approx(40.4512345, abs=1e-9)
    assert found.longitude_deg == pytest.approx(-3.7298765, abs=1e-9)
    values = found.pressure_altitude_m, found.ellipsoid_height_m, found.height_m
    assert values == (712.0, 761.5, 60.0)
    assert (found.course_deg, found.speed_m_s, found.climb_m_s) == (215.0, 25.0, -1.0)
    assert found.past_hour_s == 1834.6
    assert not found.is_over_ground
    # 3 m, 10 m and 1 m/s hold 95 % of errors
    assert found.horizontal_accuracy_m == pytest.approx(3 / 2.4477, rel=1e-4)
    assert found.vertical_accuracy_m == pytest.approx(10 / 1.95996, rel=1e-4)
    assert found.speed_accuracy_m_s == pytest.approx(1 / 1.95996, rel=1e-4)


def test_what_the_drone_does_not_know_is_nan() -> None:
    unknown = bytearray(AIRBORNE)
    unknown[1:5] = bytes([0x23, 181, 255, 126])  # 361 degrees, 255 and 63 m/s
    unknown[5:19] = bytes(14)
    unknown[19:23] = b"\x00\x00\xff\xff"
    found = location(unknown)
    numbers = [getattr(found, name) for name in OdidLocation.__slots__ if name != "is_over_ground"]
    assert all(map(math.isnan, numbers))


def test_a_pack_holds_an_identity_and_a_location() -> None:
    basic_id = b"\x02\x12" + b"1581F4XF".ljust(20, b"\0") + bytes(3)
    pack = b"\xf2\x19\x02" + basic_id + AIRBORNE
    assert [*messages_in(pack)] == [OdidIdentity(1, "1581F4XF"), location(AIRBORNE)]


@pytest.mark.parametrize(
    "octets",
    [b"", AIRBORNE[:-1], AIRBORNE * 2, b"\xf2\x19\x0a" + AIRBORNE * 10, b"\xf2\x18\x01" + AIRBORNE],
)
def test_what_is_neither_is_an_error(octets: bytes) -> None:
    with pytest.raises(DecodeError):
        list(messages_in(octets))


@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 255), st.booleans())
def test_numbers_are_what_their_octets_say(latitude: int, direction: int, east: bool) -> None:
    octets = bytearray(AIRBORNE)
    octets[5:9] = struct.pack("<i", latitude)
    octets[2], octets[1] = direction, 0x22 if east else 0x20
    found = location(octets)
    assert found.latitude_deg == pytest.approx(latitude * 1e-7)
    expected = direction + 180 * east
    assert math.isnan(found.course_deg) if expected > 360 else found.course_deg == expected


def test_a_fast_one_counts_in_coarser_steps() -> None:
    fast = AIRBORNE[:1] + b"\x23" + AIRBORNE[2:3] + bytes([100]) + AIRBORNE[4:]
    assert location(fast).speed_m_s == 100 * 0.75 + 63.75

"""Open Drone ID messages of ASTM F3411-22a, as drones broadcast them: 25 octets, or packs of them.

Octet 0 is the type << 4 | the version of the protocol. Numbers are little-endian.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from plotfeed.proto.errors import DecodeError

MESSAGE_OCTETS = 25
PACK_HEADER_OCTETS = 3
MAX_IN_PACK = 9
BASIC_ID, LOCATION, PACK = 0x0, 0x1, 0xF
ID_OCTETS = 20
HORIZONTAL_CLASSES_M = {
    "HAUnknown": math.nan,
    "HA10NM": 18520.0,
    "HA4NM": 7408.0,
    "HA2NM": 3704.0,
    "HA1NM": 1852.0,
    "HA05NM": 926.0,
    "HA03NM": 555.6,
    "HA01NM": 185.2,
    "HA005NM": 92.6,
    "HA30m": 30.0,
    "HA10m": 10.0,
    "HA3m": 3.0,
    "HA1m": 1.0,
}
VERTICAL_CLASSES_M = {
    "VAUnknown": math.nan,
    "VA150m": 150.0,
    "VA45m": 45.0,
    "VA25m": 25.0,
    "VA10m": 10.0,
    "VA3m": 3.0,
    "VA1m": 1.0,
}
# Bounds of 95 % of errors, by the name of the class, in the order of their numbers.
SPEED_CLASSES_M_S = {
    "SAUnknown": math.nan,
    "SA10mps": 10.0,
    "SA3mps": 3.0,
    "SA1mps": 1.0,
    "SA03mps": 0.3,
}
HORIZONTAL_M, VERTICAL_M, SPEED_M_S = (
    tuple(classes.values())
    for classes in (HORIZONTAL_CLASSES_M, VERTICAL_CLASSES_M, SPEED_CLASSES_M_S)
)
# Radius, and distance either way, within which 95 % of normal errors are, standard deviations.
RADIUS_95, EDGE_95 = math.sqrt(-2 * math.log(0.05)), 1.959964
UNKNOWN_ALTITUDE_M, UNKNOWN_DIRECTION_DEG = -1000.0, 361.0
UNKNOWN_SPEED_M_S, UNKNOWN_CLIMB_M_S = 255.0, 63.0
HOUR_TENTHS = 36_000
_LOCATION = struct.Struct("<BBBBbiiHHHBBHBB")


@dataclass(frozen=True, slots=True, kw_only=True)
class OdidLocation:
    """Position and velocity of an aircraft, NaN for what it does not know; WGS-84 degrees.

    Accuracies are one standard deviation; `past_hour_s` counts from the last full hour of UTC.
    """

    latitude_deg: float
    longitude_deg: float
    ellipsoid_height_m: float
    pressure_altitude_m: float
    height_m: float
    is_over_ground: bool  # Whether that height is over the ground, and not over where it took off
    course_deg: float
    speed_m_s: float
    climb_m_s: float
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_m_s: float
    past_hour_s: float


@dataclass(frozen=True, slots=True)
class OdidIdentity:
    """Identity of an aircraft and what kind it is of: 1 is a serial number."""

    kind: int
    identity: str


def messages_in(data: bytes) -> Iterator[OdidLocation | OdidIdentity]:
    """The locations and identities in a message or a pack; raises `DecodeError`.

    Other messages, of the operator and of authentication, are passed over.
    """
    if len(data) >= PACK_HEADER_OCTETS and data[0] >> 4 == PACK:
        _, size, number = data[:PACK_HEADER_OCTETS]
        if size != MESSAGE_OCTETS or not 1 <= number <= MAX_IN_PACK:
            detail = f"a pack of {number} messages of {size} octets; expected 1 to {MAX_IN_PACK}"
            raise DecodeError(f"{detail} of {MESSAGE_OCTETS}", at_octet=1)
        if len(data) < PACK_HEADER_OCTETS + number * size:
            raise DecodeError("a pack that is cut short", at_octet=len(data))
        starts = range(PACK_HEADER_OCTETS, PACK_HEADER_OCTETS + number * size, size)
    elif len(data) == MESSAGE_OCTETS:
        starts = range(1)
    else:
        detail = f"{len(data)} octets; expected a message of {MESSAGE_OCTETS} or a pack of them"
        raise DecodeError(detail, at_octet=0)
    for start in starts:
        message = data[start : start + MESSAGE_OCTETS]
        if message[0] >> 4 == LOCATION:
            yield _location(message)
        elif message[0] >> 4 == BASIC_ID:
            yield OdidIdentity(message[1] >> 4, identity_text(message[2 : 2 + ID_OCTETS]))


def identity_text(octets: bytes) -> str:
    """An identity as text: up to the first zero, in hexadecimal where it is not printable ASCII."""
    text = octets.split(b"\0", 1)[0]
    if text.isascii() and text.decode().isprintable():
        return text.decode().strip()
    return octets.rstrip(b"\0").hex()


def known(value: float, unknown: float) -> float:
    """The value, or NaN where it is the one that stands for "unknown"."""
    return math.nan if value == unknown else value


def accuracy(bounds: tuple[float, ...], number: int, scale: float) -> float:
    """Standard deviation of a class of accuracy; NaN for one that is unknown or not defined."""
    return bounds[number] / scale if number < len(bounds) else math.nan


def _location(message: bytes) -> OdidLocation:
    _, flags, direction, speed, climb, latitude, longitude, *more = _LOCATION.unpack(message)
    pressure, ellipsoid, height, accuracies, more_accuracies, tenths, _, _ = more
    course_deg = direction + 180.0 * bool(flags & 0x02)
    speed_m_s = speed * 0.75 + 63.75 if flags & 0x01 else speed * 0.25
    is_fixed = (latitude, longitude) != (0, 0)
    return OdidLocation(
        latitude_deg=latitude * 1e-7 if is_fixed else math.nan,
        longitude_deg=longitude * 1e-7 if is_fixed else math.nan,
        ellipsoid_height_m=known(ellipsoid * 0.5 - 1000, UNKNOWN_ALTITUDE_M),
        pressure_altitude_m=known(pressure * 0.5 - 1000, UNKNOWN_ALTITUDE_M),
        height_m=known(height * 0.5 - 1000, UNKNOWN_ALTITUDE_M),
        is_over_ground=bool(flags & 0x04),
        course_deg=course_deg if course_deg <= 360 else math.nan,
        speed_m_s=known(speed_m_s, UNKNOWN_SPEED_M_S),
        climb_m_s=known(climb * 0.5, UNKNOWN_CLIMB_M_S),
        horizontal_accuracy_m=accuracy(HORIZONTAL_M, accuracies & 0xF, RADIUS_95),
        vertical_accuracy_m=accuracy(VERTICAL_M, accuracies >> 4, EDGE_95),
        speed_accuracy_m_s=accuracy(SPEED_M_S, more_accuracies & 0xF, EDGE_95),
        past_hour_s=tenths / 10 if tenths <= HOUR_TENTHS else math.nan,
    )

"""ADS-B in Mode S extended squitters (DO-260B): frames of Beast, parity, positions and velocities.

Bits of a message are counted from 1, as the standard does. Feet and knots stay as they were sent.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from plotfeed.proto.units import FOOT_M

BEAST_HEAD_OCTETS = 7  # Of a frame behind its type: 6 octets of time and 1 of signal
# A frame by its mark 1A and its type, which tells how many octets it has; within it, and where no
# frame is, 1A stands twice. The last is a frame that has begun and is not whole yet.
BEAST_FRAME = re.compile(
    rb"\x1a\x1a|\x1a(?:1(?:[^\x1a]|\x1a\x1a){9}|2(?:[^\x1a]|\x1a\x1a){14}"
    rb"|3(?:[^\x1a]|\x1a\x1a){21})|(?P<begun>\x1a(?:[123](?:[^\x1a]|\x1a\x1a)*\x1a?)?\Z)",
    re.DOTALL,
)
LONG_OCTETS = 14
SQUITTERS = (17, 18)  # Downlink formats: of transponders, and of others that say the same
GENERATOR = 0x1FFF409  # Of the parity, 25 bits; ICAO Annex 10 volume IV, 3.1.2.3.3
ZONES = 15  # Latitude zones between equator and pole
CPR = 1 << 17
CALLSIGN = "#ABCDEFGHIJKLMNOPQRSTUVWXYZ##### ###############0123456789######"
_DIVISORS = [GENERATOR << shift for shift in range(88)]


class BeastSplitter:
    """Messages in a stream of Beast, in which 1A stands twice where it is no beginning."""

    def __init__(self) -> None:
        self._left = b""
        self.damaged = 0  # Octets so far that belonged to no frame

    def split(self, data: bytes) -> Iterator[bytes]:
        """The messages, of 2, 7 or 14 octets, that end in these octets."""
        buffer, at = self._left + data, 0
        self._left = b""
        for found in BEAST_FRAME.finditer(buffer):
            if found["begun"]:
                self._left, buffer = found["begun"], buffer[: found.start()]
            elif found.end() > found.start() + 2:
                self.damaged += found.start() - at
                at = found.end()
                yield found[0][2:].replace(b"\x1a\x1a", b"\x1a")[BEAST_HEAD_OCTETS:]
        self.damaged += len(buffer) - at


def is_whole(message: bytes) -> bool:
    """Whether the parity of an extended squitter is right."""
    value = int.from_bytes(message, "big")
    for shift in range(len(message) * 8 - 25, -1, -1):
        if value >> (shift + 24) & 1:
            value ^= _DIVISORS[shift]
    return value == 0


@dataclass(frozen=True, slots=True)
class CprPosition:
    """Half of a position: two fractions of a zone, of an even or an odd message."""

    is_odd: bool
    latitude: float
    longitude: float
    # NaN where it is not told, or in steps of 100 feet, which aircraft of today do not send.
    altitude_ft: float
    is_geometric: bool  # Whether that is over the ellipsoid, and not by pressure


@dataclass(frozen=True, slots=True)
class GroundVelocity:
    """Velocity over ground, knots, feet a minute; `geometric_less_pressure_ft` may be NaN."""

    east_kt: float
    north_kt: float
    climb_ft_min: float
    geometric_less_pressure_ft: float


@dataclass(frozen=True, slots=True)
class Identification:
    """Callsign and category of an aircraft: A1 is light, A7 a rotorcraft, B6 unmanned."""

    callsign: str
    category: str


Said = CprPosition | GroundVelocity | Identification


def read_squitter(message: bytes) -> tuple[str, Said] | None:
    """Who says what in a message of 14 octets; None if it is damaged, or says something else."""
    if len(message) != LONG_OCTETS or message[0] >> 3 not in SQUITTERS or not is_whole(message):
        return None
    if message[0] >> 3 == 18 and message[0] & 7 > 1:  # of ground stations, and in other layouts
        return None
    said = _said(int.from_bytes(message[4:11], "big"))
    return None if said is None else (message[1:4].hex(), said)


def _bits(field: int, first: int, last: int) -> int:
    """Bits of 56, counted from 1."""
    return field >> (56 - last) & ((1 << (last - first + 1)) - 1)


def _said(field: int) -> Said | None:
    kind = _bits(field, 1, 5)
    if 1 <= kind <= 4:
        letters = "".join(CALLSIGN[_bits(field, 9 + 6 * n, 14 + 6 * n)] for n in range(8))
        return Identification(letters.strip(" #"), f"{'DCBA'[kind - 1]}{_bits(field, 6, 8)}")
    if 9 <= kind <= 18 or 20 <= kind <= 22:
        return CprPosition(
            is_odd=bool(_bits(field, 22, 22)),
            latitude=_bits(field, 23, 39) / CPR,
            longitude=_bits(field, 40, 56) / CPR,
            altitude_ft=_altitude_ft(_bits(field, 9, 20), is_geometric=kind >= 20),
            is_geometric=kind >= 20,
        )
    if kind == 19 and _bits(field, 6, 8) in (1, 2):
        return _velocity(field)
    return None


def _altitude_ft(code: int, *, is_geometric: bool) -> float:
    if is_geometric:
        return code / FOOT_M if code else math.nan  # in metres
    if not code & 0x10:
        return math.nan
    return ((code >> 5) << 4 | code & 0xF) * 25.0 - 1000.0


def _signed(field: int, sign: int, last: int, step: float) -> float:
    """A number behind the bit of its sign; NaN for 0, which says that it is not known."""
    size = _bits(field, sign + 1, last)
    return (size - 1) * step * (-1 if _bits(field, sign, sign) else 1) if size else math.nan


def _velocity(field: int) -> GroundVelocity | None:
    step_kt = 4.0 if _bits(field, 6, 8) == 2 else 1.0
    east_kt, north_kt = _signed(field, 14, 24, step_kt), _signed(field, 25, 35, step_kt)
    if math.isnan(east_kt + north_kt):
        return None
    return GroundVelocity(
        east_kt, north_kt, _signed(field, 37, 46, 64.0), _signed(field, 49, 56, 25.0)
    )


def longitude_zones(latitude_deg: float) -> int:
    """Number of longitude zones at a latitude, 1 to 59; DO-260B A.1.7.2."""
    across = math.cos(math.radians(latitude_deg)) ** 2
    if across < 1e-12:
        return 1
    share = 1 - (1 - math.cos(math.pi / (2 * ZONES))) / across
    return 1 if share <= -1 else math.floor(2 * math.pi / math.acos(share))


def global_position(
    even: CprPosition, odd: CprPosition, *, latest_is_odd: bool
) -> tuple[float, float] | None:
    """Latitude and longitude, degrees, of the later of two halves; None if they do not fit."""
    zone = math.floor(59 * even.latitude - 60 * odd.latitude + 0.5)
    latitudes = (
        _half_turn(6.0 * (zone % 60 + even.latitude)),
        _half_turn(360 / 59 * (zone % 59 + odd.latitude)),
    )
    if max(map(abs, latitudes)) > 90:
        return None
    zones = longitude_zones(latitudes[0])
    if zones != longitude_zones(latitudes[1]):
        return None
    number = max(zones - latest_is_odd, 1)
    m = math.floor(even.longitude * (zones - 1) - odd.longitude * zones + 0.5)
    latest = odd if latest_is_odd else even
    longitude_deg = 360 / number * (m % number + latest.longitude)
    return latitudes[latest_is_odd], _half_turn(longitude_deg)


def local_position(half: CprPosition, near: tuple[float, float]) -> tuple[float, float]:
    """Latitude and longitude, degrees, of the place nearest to one that is known."""
    latitude_deg = _nearest(half.latitude, 360 / (60 - half.is_odd), near[0])
    number = max(longitude_zones(latitude_deg) - half.is_odd, 1)
    return latitude_deg, _half_turn(_nearest(half.longitude, 360 / number, near[1]))


def _nearest(part: float, zone_deg: float, near_deg: float) -> float:
    return zone_deg * (round(near_deg / zone_deg - part) + part)


def _half_turn(angle_deg: float) -> float:
    return (angle_deg + 180) % 360 - 180

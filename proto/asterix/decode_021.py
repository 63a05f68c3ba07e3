"""ADS-B target reports of category 021, editions 2.1 to 2.7: where aircraft are, and who.

Editions to 0.26 have another order of items, and nothing in a block tells which it is of.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from plotfeed.proto.asterix.codec.decode import Record, Value, decode
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.units import FOOT_M, NM_M

CAT021 = OTHER_CATEGORIES[21]
DAY_S = 86_400
TIMES = ("I021/073", "I021/071", "I021/075", "I021/077")
"""Items of time, by how near they are to when the position was measured."""
POSITIONS_DEG = {"I021/131": 180 / 2**30, "I021/130": 180 / 2**23}
"""Items of position and their least significant bits, the finest first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AircraftReport:
    """Who is where, and when since midnight UTC; "" and NaN for what was not sent.

    Height is above the ellipsoid, flight level by pressure, metres.
    """

    icao: str
    callsign: str
    emitter: int
    """Emitter category: 1 light, 5 heavy, 10 a rotorcraft, 13 unmanned; 0 if unknown."""
    t_of_day_s: float
    latitude_deg: float
    longitude_deg: float
    height_m: float
    flight_level_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    climb_m_s: float


def read_021(data: bytes) -> list[AircraftReport]:
    """The reports with a position and an address in data blocks, of which all must be of 021.

    Raises `DecodeError` for what is none of these editions.
    """
    records = decode(data, {CAT021.number: CAT021})
    for record in records:
        if record.category != CAT021.number:
            raise DecodeError(f"category {record.category}, not 21", at_octet=record.at_octet)
    return [report for report in map(_report, records) if report is not None]


def _report(record: Record) -> AircraftReport | None:
    items = record.items
    named = next((name for name in POSITIONS_DEG if name in items), None)
    address = _octets(items, "I021/080")
    if not address or named is None:
        return None
    place, lsb_deg = _octets(items, named), POSITIONS_DEG[named]
    half = len(place) // 2
    latitude_deg, longitude_deg = (_signed(p) * lsb_deg for p in (place[:half], place[half:]))
    time_s = next((items[name] for name in TIMES if name in items), None)
    east, north = _over_ground(_octets(items, "I021/160"))
    return AircraftReport(
        icao=address.hex(),
        callsign=_callsign(_octets(items, "I021/170")),
        emitter=int.from_bytes(_octets(items, "I021/020"), "big"),
        t_of_day_s=time_s if isinstance(time_s, float) and time_s <= DAY_S else math.nan,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=_scaled(_octets(items, "I021/140"), 6.25 * FOOT_M),
        flight_level_m=_scaled(_octets(items, "I021/145"), 25 * FOOT_M),
        velocity_east_m_s=east,
        velocity_north_m_s=north,
        climb_m_s=_climb_m_s(_octets(items, "I021/157") or _octets(items, "I021/155")),
    )


def _octets(items: Mapping[str, Value], name: str) -> bytes:
    """The octets of an item; none if it is not there."""
    value = items.get(name, b"")
    return value if isinstance(value, bytes) else b""


def _signed(octets: bytes) -> int:
    return int.from_bytes(octets, "big", signed=True)


def _scaled(octets: bytes, lsb: float) -> float:
    return _signed(octets) * lsb if octets else math.nan


def _over_ground(octets: bytes) -> tuple[float, float]:
    """East and north, m/s, of ground speed in NM/s and track angle; the first bit is "exceeded"."""
    if not octets:
        return math.nan, math.nan
    speed_m_s = (int.from_bytes(octets[:2], "big") & 0x7FFF) * 2**-14 * NM_M
    track = math.radians(int.from_bytes(octets[2:], "big") * 360 / 2**16)
    return speed_m_s * math.sin(track), speed_m_s * math.cos(track)


def _climb_m_s(octets: bytes) -> float:
    """Vertical rate of 15 bits behind "exceeded", 6.25 feet a minute each."""
    if not octets:
        return math.nan
    value = int.from_bytes(octets, "big") & 0x7FFF
    return (value - (value >> 14 << 15)) * 6.25 * FOOT_M / 60


def _callsign(octets: bytes) -> str:
    """Eight characters of six bits, as in Mode S."""
    value = int.from_bytes(octets, "big")
    codes = [value >> shift & 0x3F for shift in range(42, -1, -6)]
    letters = (chr(c + 64) if 1 <= c <= 26 else chr(c) if 48 <= c <= 57 else " " for c in codes)
    return "".join(letters).strip()

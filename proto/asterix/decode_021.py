"""ADS-B target reports of category 021, editions 0.23 to 2.7: where aircraft are, and who.

Editions from 2.1 on have one order of items, those to 0.26 another: nothing in a block tells which.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.units import FOOT_M, NM_M

AIRCRAFT_CATEGORY = 21
DAY_UNITS = 86_400 * 128
Edition021 = Literal[
    "0.23", "0.24", "0.25", "0.26", "2.1", "2.2", "2.3", "2.4", "2.5", "2.6", "2.7"
]
NEWEST: Edition021 = "2.7"


@dataclass(frozen=True, slots=True)
class _Layout:
    """How records of some editions are laid out."""

    order: tuple[str, ...]
    """Items by their places in the field specification."""
    octets: Mapping[str, int]
    """Of the items whose length is fixed."""
    extended: frozenset[str]
    """Items of which each octet says whether another follows."""
    with_length: frozenset[int]
    """Places of the fields whose first octet is their length."""
    times: tuple[str, ...]
    """Items of time, by how near they are to when the position was measured."""
    positions_deg: Mapping[str, float]
    """Items of position and their least significant bits, the finest first."""


_SINCE_2_1 = _Layout(
    order=(
        "010", "040", "161", "015", "071", "130", "131",
        "072", "150", "151", "080", "073", "074", "075",
        "076", "140", "090", "210", "070", "230", "145",
        "152", "200", "155", "157", "160", "165", "077",
        "170", "020", "220", "146", "148", "110", "016",
        "008", "271", "132", "250", "260", "400", "295",
    ),
    octets={
        "010": 2, "161": 2, "015": 1, "071": 3, "130": 6, "131": 8, "072": 3, "150": 2, "151": 2,
        "080": 3, "073": 3, "074": 4, "075": 3, "076": 4, "140": 2, "210": 1, "070": 2, "230": 2,
        "145": 2, "152": 2, "200": 1, "155": 2, "157": 2, "160": 4, "165": 2, "077": 3, "170": 6,
        "020": 1, "146": 2, "148": 2, "016": 1, "008": 1, "132": 1, "260": 7, "400": 1,
    },
    extended=frozenset({"040", "090", "271"}),
    with_length=frozenset({48, 49}),
    times=("073", "071", "075", "077"),
    positions_deg={"131": 180 / 2**30, "130": 180 / 2**23},
)  # fmt: skip
_0_26 = _Layout(
    order=(
        "010", "040", "030", "130", "080", "140", "090",
        "210", "230", "145", "150", "151", "152", "155",
        "157", "160", "165", "170", "095", "032", "200",
        "020", "220", "146", "148", "110", "070", "131",
    ),
    octets={
        "010": 2, "040": 2, "030": 3, "130": 8, "080": 3, "140": 2, "090": 2, "210": 1, "230": 2,
        "145": 2, "150": 2, "151": 2, "152": 2, "155": 2, "157": 2, "160": 4, "170": 6, "095": 1,
        "032": 1, "200": 1, "020": 1, "146": 2, "148": 2, "070": 2, "131": 1,
    },
    extended=frozenset({"165"}),
    with_length=frozenset({34, 35}),
    times=("030",),
    positions_deg={"130": 180 / 2**25},
)  # fmt: skip
_0_25 = replace(_0_26, order=_0_26.order[:26])
_0_23 = replace(_0_25, octets={**_0_26.octets, "130": 6}, positions_deg={"130": 180 / 2**23})
_LAYOUTS = {"0.23": _0_23, "0.24": _0_25, "0.25": _0_25, "0.26": _0_26}


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


def read_021(data: bytes, edition: Edition021 = NEWEST) -> list[AircraftReport]:
    """The reports with a position and an address in data blocks, of which all must be of 021.

    Raises `DecodeError` for what is none of that edition.
    """
    layout = _LAYOUTS.get(edition, _SINCE_2_1)
    reports, at = list[AircraftReport](), 0
    while at < len(data):
        octets = int.from_bytes(data[at + 1 : at + HEADER_OCTETS], "big")
        if data[at] != AIRCRAFT_CATEGORY:
            raise DecodeError(f"category {data[at]}, not 21", at_octet=at)
        if octets <= HEADER_OCTETS or at + octets > len(data):
            raise DecodeError("a data block that is cut short", at_octet=at)
        start, end = at + HEADER_OCTETS, at + octets
        while start < end:
            items, start = _record(data[:end], start, layout)
            report = _report(items, layout)
            if report is not None:
                reports.append(report)
        at = end
    return reports


def _record(data: bytes, at: int, layout: _Layout) -> tuple[dict[str, bytes], int]:
    """The items of a record by name, and where it ends."""
    places, n = list[int](), 0
    while True:
        octet = _octet(data, at)
        places += [n * 7 + bit + 1 for bit in range(7) if octet << bit & 0x80]
        at, n = at + 1, n + 1
        if not octet & 1:
            break
        if n > 7:
            raise DecodeError("a field specification without end", at_octet=at)
    items: dict[str, bytes] = {}
    for place in places:
        name = layout.order[place - 1] if place <= len(layout.order) else ""
        end = at + _length(layout, name, place, data, at)
        if end > len(data):
            raise DecodeError("a record that is cut short", at_octet=at)
        items[name] = data[at:end]
        at = end
    return items, at


def _octet(data: bytes, at: int) -> int:
    if at >= len(data):
        raise DecodeError("a record that is cut short", at_octet=at)
    return data[at]


def _length(layout: _Layout, name: str, place: int, data: bytes, at: int) -> int:
    """Octets of the item that starts there."""
    if name in layout.octets:
        return layout.octets[name]
    if name in layout.extended:
        return _extended(data, at)
    if name == "250":
        return 1 + 8 * _octet(data, at)
    if name in ("220", "295", "110"):
        return _compound(name, data, at)
    if place in layout.with_length:
        return max(1, _octet(data, at))
    raise DecodeError(f"field {place}, which this edition has not", at_octet=at)


def _extended(data: bytes, at: int) -> int:
    octets = 1
    while _octet(data, at + octets - 1) & 1:
        octets += 1
    return octets


def _compound(name: str, data: bytes, at: int) -> int:
    """Octets of an item whose first ones say which parts follow."""
    head = _extended(data, at)
    parts = [
        7 * n + bit for n in range(head) for bit in range(7) if _octet(data, at + n) << bit & 0x80
    ]
    end = at + head
    lengths: dict[int, Callable[[int], int]] = {}
    if name == "220":
        lengths = {3: lambda _at: 1}
    elif name == "110":
        lengths = {0: lambda at: _extended(data, at), 1: lambda at: 1 + 15 * _octet(data, at)}
    usual = 2 if name == "220" else 1
    for part in parts:
        end += lengths[part](end) if part in lengths else usual
    return end - at


def _report(items: dict[str, bytes], layout: _Layout) -> AircraftReport | None:
    named = next((name for name in layout.positions_deg if name in items), None)
    if "080" not in items or named is None:
        return None
    place, lsb_deg = items[named], layout.positions_deg[named]
    half = len(place) // 2
    latitude_deg, longitude_deg = (_signed(p) * lsb_deg for p in (place[:half], place[half:]))
    time = next((items[name] for name in layout.times if name in items), None)
    units = math.nan if time is None else int.from_bytes(time, "big")
    east, north = _over_ground(items.get("160"))
    return AircraftReport(
        icao=items["080"].hex(),
        callsign=_callsign(items.get("170", b"")),
        emitter=items["020"][0] if "020" in items else 0,
        t_of_day_s=units / 128 if units <= DAY_UNITS else math.nan,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=_scaled(items.get("140"), 6.25 * FOOT_M),
        flight_level_m=_scaled(items.get("145"), 25 * FOOT_M),
        velocity_east_m_s=east,
        velocity_north_m_s=north,
        climb_m_s=_climb_m_s(items.get("157") or items.get("155")),
    )


def _signed(octets: bytes) -> int:
    return int.from_bytes(octets, "big", signed=True)


def _scaled(octets: bytes | None, lsb: float) -> float:
    return math.nan if octets is None else _signed(octets) * lsb


def _over_ground(octets: bytes | None) -> tuple[float, float]:
    """East and north, m/s, of ground speed in NM/s and track angle; the first bit is "exceeded"."""
    if octets is None:
        return math.nan, math.nan
    speed_m_s = (int.from_bytes(octets[:2], "big") & 0x7FFF) * 2**-14 * NM_M
    track = math.radians(int.from_bytes(octets[2:], "big") * 360 / 2**16)
    return speed_m_s * math.sin(track), speed_m_s * math.cos(track)


def _climb_m_s(octets: bytes | None) -> float:
    """Vertical rate of 15 bits behind "exceeded", 6.25 feet a minute each."""
    if octets is None:
        return math.nan
    value = int.from_bytes(octets, "big") & 0x7FFF
    return (value - (value >> 14 << 15)) * 6.25 * FOOT_M / 60


def _callsign(octets: bytes) -> str:
    """Eight characters of six bits, as in Mode S."""
    value = int.from_bytes(octets, "big")
    codes = [value >> shift & 0x3F for shift in range(42, -1, -6)]
    letters = (chr(c + 64) if 1 <= c <= 26 else chr(c) if 48 <= c <= 57 else " " for c in codes)
    return "".join(letters).strip()

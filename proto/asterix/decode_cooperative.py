"""Aircraft that say where they are, and who: ADS-B in category 021, unmanned ones in category 129.

021 is of editions 2.1 to 2.7. Editions to 0.26 have another order of items, and nothing in a block
tells which it is of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

from plotfeed.proto.asterix.cat129 import CAT129
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, category
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.units import FOOT_M, NM_M

# Its other items are octets.
CAT021 = category(
    21,
    """
FRN  item      octets  parts: bits, LSB and unit
6    I021/130  6       LAT ±24: 180/2^23 deg, LON ±24: 180/2^23 deg
7    I021/131  8       LAT ±32: 180/2^30 deg, LON ±32: 180/2^30 deg
11   I021/080  3       ADDRESS 24
16   I021/140  2       HEIGHT ±16: 6.25 ft
21   I021/145  2       FL ±16: 1/4 FL
24   I021/155  2       RE, RATE ±15: 6.25 ft/min
25   I021/157  2       RE, RATE ±15: 6.25 ft/min
26   I021/160  4       RE, SPEED 15: 2^-14 NM/s, TRACK 16: 360/2^16 deg
29   I021/170  6       IDENT 8x6
30   I021/020  1       EMITTER 8
""",
    base=OTHER_CATEGORIES[21],
)
DAY_S = 86_400
# Items of time, by how near they are to when the position was measured.
TIMES = ("I021/073", "I021/071", "I021/075", "I021/077")
POSITIONS = ("I021/131", "I021/130")  # Items of position, the finer first


@dataclass(frozen=True, slots=True, kw_only=True)
class AircraftReport:
    """Who is where, and when since midnight UTC; "" and NaN for what was not sent.

    Height is above the ellipsoid, flight level by pressure, metres.
    """

    icao: str
    callsign: str
    emitter: int  # Emitter category: 1 light, 5 heavy, 10 a rotorcraft, 13 unmanned; 0 if unknown
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
    return [report for report in map(_aircraft, records) if report is not None]


def _number(record: Record, *paths: str) -> float:
    """The first of the numbers that was sent."""
    found = (value for path in paths if isinstance(value := record.get(path), float))
    return next(found, math.nan)


def _aircraft(record: Record) -> AircraftReport | None:
    number = partial(_number, record)
    address, emitter, callsign = map(record.get, ("I021/080", "I021/020", "I021/170"))
    latitude_deg, longitude_deg = (
        number(*(f"{position}/{name}" for position in POSITIONS)) for name in ("LAT", "LON")
    )
    if not isinstance(address, int) or math.isnan(latitude_deg):
        return None
    time_s = number(*TIMES)
    speed_m_s, track = number("I021/160/SPEED") * NM_M, math.radians(number("I021/160/TRACK"))
    return AircraftReport(
        icao=f"{address:06x}",
        callsign=callsign.replace("?", " ").strip() if isinstance(callsign, str) else "",
        emitter=emitter if isinstance(emitter, int) else 0,
        t_of_day_s=time_s if time_s <= DAY_S else math.nan,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=number("I021/140") * FOOT_M,
        flight_level_m=number("I021/145") * 100 * FOOT_M,
        velocity_east_m_s=speed_m_s * math.sin(track),
        velocity_north_m_s=speed_m_s * math.cos(track),
        climb_m_s=number("I021/157/RATE", "I021/155/RATE") * FOOT_M / 60,
    )


CATEGORY = CAT129.number


@dataclass(frozen=True, slots=True, kw_only=True)
class UasReport:
    """Who is where, and when since midnight UTC; "" and NaN for what was not sent.

    Altitude is above mean sea level, height above ground. `accuracy_m` is the radius that holds
    half of the positions.
    """

    serial: str
    manufacturer: str
    model: str
    country: str
    t_of_day_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    height_m: float
    accuracy_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    climb_m_s: float

    @property
    def identity(self) -> str:
        """The serial number, or whatever else was sent of its name."""
        others = (self.country, self.manufacturer, self.model)
        return self.serial or "-".join(filter(None, others))


def is_block_129(payload: bytes) -> bool:
    """Whether octets look like one data block of the category, and nothing else."""
    return (
        len(payload) > HEADER_OCTETS
        and payload[0] == CATEGORY
        and int.from_bytes(payload[1:HEADER_OCTETS], "big") == len(payload)
    )


def read_129(data: bytes) -> list[UasReport]:
    """The reports in data blocks, of which all must be of category 129.

    A name that is not printable ASCII, whose encoding the standard leaves open, is in hexadecimal.
    One without a time of the day or a position on the globe is a DecodeError.
    """
    return [_unmanned(record) for record in decode(data)]


def _unmanned(record: Record) -> UasReport:
    number = partial(_number, record)

    def text(path: str) -> str:
        value = record.get(path)
        if not isinstance(value, str):
            return ""
        name = value.rstrip(" \0")
        readable = name.isascii() and name.isprintable()
        return name if readable else value.encode("latin-1").hex()

    if record.category != CATEGORY:
        raise DecodeError(f"category {record.category}, not 129", at_octet=record.at_octet)
    for path in ("I129/070", "I129/080/LAT"):
        if record.get(path) is None:
            raise DecodeError(f"a report without {path[:8]}", at_octet=record.at_octet)
    if number("I129/070") > DAY_S:  # a day's whole length is what a sender without modulo sends
        raise DecodeError("a time beyond midnight", at_octet=record.at_octet)
    report = UasReport(
        serial=text("I129/040"),
        manufacturer=text("I129/020"),
        model=text("I129/030"),
        country=text("I129/050"),
        t_of_day_s=number("I129/070") % DAY_S,
        latitude_deg=number("I129/080/LAT"),
        longitude_deg=number("I129/080/LON"),
        altitude_m=number("I129/090"),
        height_m=number("I129/100"),
        accuracy_m=number("I129/110") or math.nan,
        velocity_east_m_s=number("I129/185/VX"),
        velocity_north_m_s=number("I129/185/VY"),
        climb_m_s=number("I129/220"),
    )
    if abs(report.latitude_deg) > 90 or abs(report.longitude_deg) > 180:
        raise DecodeError("a position off the globe", at_octet=record.at_octet)
    return report

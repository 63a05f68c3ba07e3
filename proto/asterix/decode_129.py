"""Unmanned aircraft that say where they are, read from data blocks of category 129."""

from __future__ import annotations

import math
from dataclasses import dataclass

from plotfeed.proto.asterix.cat129 import CAT129
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS
from plotfeed.proto.errors import DecodeError

CATEGORY = 129
DAY_S = 86_400


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
    return [_report(record) for record in decode(data)]


def _report(record: Record) -> UasReport:
    def number(path: str) -> float:
        value = record.get(path)
        return value if isinstance(value, float) else math.nan

    def text(path: str) -> str:
        value = record.get(path)
        if not isinstance(value, str):
            return ""
        name = value.rstrip(" \0")
        readable = name.isascii() and name.isprintable()
        return name if readable else value.encode("latin-1").hex()

    if record.category != CAT129.number:
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

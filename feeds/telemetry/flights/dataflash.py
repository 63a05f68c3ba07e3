"""ArduPilot's DataFlash logs (.bin), which describe their own records.

A record is A3 95, its type, and fields packed little-endian. Records of type 80 (FMT) give the
length, name, field types and field names of the others:
https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html
"""

from __future__ import annotations

import math
import struct
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.models.state import AltitudeReference

MAGIC = b"\xa3\x95"
_FMT_TYPE = 0x80
_FMT = struct.Struct("<BB4s16s64s")
_HEADER_OCTETS = 3
_FIELD_CODES = {
    "a": "64s", "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d",
    "g": "e", "n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I",
    "L": "i", "M": "B", "q": "q", "Q": "Q",
}  # fmt: skip
_FIELD_SCALES = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}

FIX_3D = 3
MIN_SATELLITES = 5
MAX_HDOP = 5.0
"""A fix of worse geometry is off by tens of metres."""

GPS_EPOCH_S = 315_964_800  # 1980-01-06 in seconds of UTC since 1970
_LEAP_SECONDS = [
    (datetime(2006, 1, 1, tzinfo=UTC), 14),
    (datetime(2009, 1, 1, tzinfo=UTC), 15),
    (datetime(2012, 7, 1, tzinfo=UTC), 16),
    (datetime(2015, 7, 1, tzinfo=UTC), 17),
    (datetime(2017, 1, 1, tzinfo=UTC), 18),
]
"""GPS less UTC, seconds, from that day on; IERS Bulletin C. No later one is announced."""

Record = dict[str, float]


def gps_to_utc_ns(week: int, ms: int) -> int:
    """UTC, nanoseconds since 1970, of a GPS week and milliseconds of it; from 2006 on."""
    gps_ms = GPS_EPOCH_S * 1000 + week * 604_800_000 + ms
    starts_ms = [(day.timestamp() + leap) * 1000 for day, leap in _LEAP_SECONDS]
    leap_s = _LEAP_SECONDS[max(bisect_right(starts_ms, gps_ms) - 1, 0)][1]
    return (gps_ms - leap_s * 1000) * 1_000_000


def read_dataflash(data: bytes, options: FlightOptions, log: Log) -> None:
    """Take every GPS record with a good fix."""
    reference = options.altitude_reference or AltitudeReference.MEAN_SEA_LEVEL
    for offset, record in _gps_records(data, log):
        where = f"offset {offset}"
        why_not = _unusable(record)
        if why_not:
            log.skip(where, why_not)
            continue
        week, ms = _first(record, "GWk", "Week"), _first(record, "GMS", "TimeMS")
        log.take(
            where,
            t_utc_ns=gps_to_utc_ns(int(week), int(ms)),
            latitude_deg=record["Lat"],
            longitude_deg=record["Lng"],
            altitude_m=record["Alt"],
            altitude_reference=reference,
            velocity_enu_m_s=_velocity_enu_m_s(record),
        )


def _first(record: Record, *names: str) -> float:
    """The value under the first of those names that the record has; NaN if none."""
    return next((record[name] for name in names if name in record), math.nan)


def _unusable(record: Record) -> str | None:
    """Why a GPS record is no fix to rely on; None if it is one."""
    if not {"Lat", "Lng", "Alt", "Status"} <= record.keys():
        return "GPS record lacks Lat, Lng, Alt or Status"
    week, ms = _first(record, "GWk", "Week"), _first(record, "GMS", "TimeMS")
    satellites, hdop = record.get("NSats", MIN_SATELLITES), record.get("HDop", 0.0)
    complaints = {
        "not the first receiver": record.get("I", 0) != 0,
        f"GPS status {record['Status']:.0f}; expected {FIX_3D} or more": record["Status"] < FIX_3D,
        "no GPS time": not (0 < week < 10_000 and 0 <= ms <= 604_800_000),
        f"{satellites:.0f} satellites; expected {MIN_SATELLITES} or more": (
            satellites < MIN_SATELLITES
        ),
        f"HDOP {hdop:g}; expected {MAX_HDOP:g} or less": not hdop <= MAX_HDOP,
    }
    return next((why for why, holds in complaints.items() if holds), None)


def _velocity_enu_m_s(record: Record) -> tuple[float, float, float] | None:
    """Velocity of a record's ground speed, course over ground and velocity down."""
    if "Spd" not in record or "GCrs" not in record:
        return None
    course = math.radians(record["GCrs"])
    up_m_s = -record.get("VZ", math.nan)
    return record["Spd"] * math.sin(course), record["Spd"] * math.cos(course), up_m_s


@dataclass(frozen=True, slots=True)
class _Format:
    """How the records of one type are laid out."""

    octets: int
    name: str
    layout: struct.Struct
    columns: tuple[str, ...]
    scales: tuple[float, ...]

    def unpack(self, data: bytes, offset: int) -> Record:
        """The numbers of the record at that offset, in units."""
        values = self.layout.unpack_from(data, offset + _HEADER_OCTETS)
        named = zip(self.columns, values, self.scales, strict=False)
        return {name: float(v) * scale for name, v, scale in named if not isinstance(v, bytes)}


def _format(body: tuple[int, int, bytes, bytes, bytes]) -> _Format | None:
    """The format that an FMT record describes; None if it contradicts itself."""
    _, octets, name, codes_z, columns_z = body
    codes = _text(codes_z)
    if not codes or not set(codes) <= _FIELD_CODES.keys():
        return None
    layout = struct.Struct("<" + "".join(_FIELD_CODES[c] for c in codes))
    if layout.size + _HEADER_OCTETS != octets:
        return None
    scales = tuple(_FIELD_SCALES.get(c, 1.0) for c in codes)
    return _Format(octets, _text(name), layout, tuple(_text(columns_z).split(",")), scales)


def _text(padded: bytes) -> str:
    return padded.partition(b"\0")[0].decode("latin-1")


_FMT_ITSELF = _Format(_FMT.size + _HEADER_OCTETS, "FMT", _FMT, (), ())


def _gps_records(data: bytes, log: Log) -> Iterator[tuple[int, Record]]:
    """Offset and values of every GPS record; what is no record is passed over and told."""
    formats = {_FMT_TYPE: _FMT_ITSELF}
    offset = bad_from = 0
    while (offset := data.find(MAGIC, offset)) >= 0 and offset + _HEADER_OCTETS <= len(data):
        layout = formats.get(data[offset + 2])
        if layout is None or offset + layout.octets > len(data):
            offset += 1
            continue
        _tell_damage(bad_from, offset, log)
        if layout is _FMT_ITSELF:
            body = _FMT.unpack_from(data, offset + _HEADER_OCTETS)
            described = _format(body)
            if described is not None and body[0] != _FMT_TYPE:
                formats[body[0]] = described
        elif layout.name == "GPS":
            yield offset, layout.unpack(data, offset)
        offset = bad_from = offset + layout.octets
    _tell_damage(bad_from, len(data), log)


def _tell_damage(start: int, end: int, log: Log) -> None:
    if end > start:
        log.skip(f"offset {start}", f"{end - start} octets that are no known record")

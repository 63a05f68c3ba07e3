"""Binary logs of autopilots: ArduPilot's DataFlash (.bin), MAVLink's .tlog, PX4's ULog (.ulg).

A DataFlash log describes its own records. A record is A3 95, its type, and fields packed little-
endian. Records of type 80 (FMT) give the length, name, field types and field names of the others:
https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html

A .tlog has microseconds of UTC, big-endian, before every MAVLink frame. Of a ULog the positions of
the estimator are taken, or of the receiver where it logged no others.
"""

from __future__ import annotations

import math
import struct
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.feeds.telemetry.foreign_files import ESTIMATE, OLD_PLACE, RECEIVERS, read_apart
from plotfeed.feeds.telemetry.position_report import UNKNOWN_VELOCITY, over_ground
from plotfeed.models.state import AltitudeReference, Floats
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.mavlink_frames import (
    FRAME_START,
    MAGIC_V1,
    MAGIC_V2,
    frame_octets,
    message_id,
    sender,
)

RECORD_START = b"\xa3\x95"
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
MAX_HDOP = 5.0  # A fix of worse geometry is off by tens of metres

GPS_EPOCH_S = 315_964_800  # 1980-01-06 in seconds of UTC since 1970
# GPS less UTC, seconds, from that day on; IERS Bulletin C. No later one is announced.
_LEAP_SECONDS = [
    (datetime(2006, 1, 1, tzinfo=UTC), 14),
    (datetime(2009, 1, 1, tzinfo=UTC), 15),
    (datetime(2012, 7, 1, tzinfo=UTC), 16),
    (datetime(2015, 7, 1, tzinfo=UTC), 17),
    (datetime(2017, 1, 1, tzinfo=UTC), 18),
]

STAMP_OCTETS = 8
US_NS = 1000
_GLOBAL_POSITION_INT = 33

Record = dict[str, float]
Decode = Callable[[bytes | bytearray], Any | None]


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
            gps_to_utc_ns(int(week), int(ms)),
            (record["Lat"], record["Lng"]),
            (record["Alt"], reference),
            velocity_enu_m_s=over_ground(record["Spd"], record["GCrs"], -record.get("VZ", math.nan))
            if {"Spd", "GCrs"} <= record.keys()
            else UNKNOWN_VELOCITY,
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
    while (offset := data.find(RECORD_START, offset)) >= 0 and offset + _HEADER_OCTETS <= len(data):
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


def read_tlog(data: bytes, options: FlightOptions, log: Log) -> None:
    """Take every GLOBAL_POSITION_INT of the vehicle that sent most of them."""
    reference = options.altitude_reference or AltitudeReference.MEAN_SEA_LEVEL
    decode = mavlink_decoder()
    found = [f for f in _frames(data, decode, log) if message_id(f[2]) == _GLOBAL_POSITION_INT]
    senders = Counter(sender(frame) for _, _, frame in found).most_common(1)
    for offset, t_utc_ns, frame in found:
        where, whose = f"offset {offset}", sender(frame)
        if whose != senders[0][0]:
            log.skip(where, f"from system {whose[0]}, not the one with most positions")
        elif (message := decode(frame)) is None:
            log.skip(where, "damaged: its checksum is wrong")
        else:
            log.take(
                where,
                t_utc_ns,
                (message.lat * 1e-7, message.lon * 1e-7),
                (message.alt * 1e-3, reference),
                # vx is north, vy east, vz down, cm/s
                velocity_enu_m_s=(message.vy * 0.01, message.vx * 0.01, -message.vz * 0.01),
            )


def mavlink_decoder() -> Decode:
    """A function from a frame to its message, or to None where no checksum proves it one."""
    need_extra("pymavlink.dialects.v20.common", "MAVLink", "mavlink")
    from pymavlink.dialects.v20 import common

    mavlink = common.MAVLink(None)

    def decode(frame: bytes | bytearray) -> Any | None:
        try:
            message = mavlink.decode(bytearray(frame))
        except Exception:  # noqa: BLE001 - pymavlink raises what it likes at damaged frames
            return None
        return None if isinstance(message, common.MAVLink_unknown) else message

    return decode


def _frames(data: bytes, decode: Decode, log: Log) -> Iterator[tuple[int, int, bytes]]:
    """Where each stamp is, its UTC, nanoseconds, and its frame; what is none is told."""
    bad_from = search_from = 0
    while (found := FRAME_START.search(data, search_from + STAMP_OCTETS)) is not None:
        offset = found.start() - STAMP_OCTETS
        octets = _whole_frame_octets(data, found.start())
        frame = data[found.start() : found.start() + (octets or 0)]
        # Where the last frame ended the next is expected; elsewhere only a checksum tells.
        expected = octets and offset == bad_from and _followed(data, found.start() + octets)
        if octets is None or not (expected or decode(frame)):
            search_from = offset + 1
            continue
        if offset > bad_from:
            log.skip(f"offset {bad_from}", f"{offset - bad_from} octets that are no frame")
        stamp_us = int.from_bytes(data[offset : found.start()], "big")
        yield offset, stamp_us * US_NS, frame
        search_from = bad_from = found.start() + octets
    if len(data) > bad_from:
        log.skip(f"offset {bad_from}", f"{len(data) - bad_from} octets that are no frame")


def _followed(data: bytes, end: int) -> bool:
    """Whether another stamped frame seems to begin there, or the file ends."""
    if end + STAMP_OCTETS >= len(data):
        return end == len(data)
    return data[end + STAMP_OCTETS] in (MAGIC_V1, MAGIC_V2)


def _whole_frame_octets(data: bytes, start: int) -> int | None:
    """Length of the frame that starts there and is whole; None if none does."""
    octets = frame_octets(data, start)
    return octets if octets is not None and start + octets <= len(data) else None


def looks_like_tlog(data: bytes) -> bool:
    """Whether a stamped frame stands at the start, and another after it or the end."""
    octets = _whole_frame_octets(data, STAMP_OCTETS) if len(data) > STAMP_OCTETS else None
    if octets is None:
        return False
    after = STAMP_OCTETS + octets + STAMP_OCTETS
    return after >= len(data) or data[after] in (MAGIC_V1, MAGIC_V2)


# 2001: a receiver that has no time yet says 0, or the beginning of its own.
EARLIEST_UTC_US = 10**15

Rows = dict[str, Any]  # Columns of a topic, by name; arrays (n,)


def read_ulog(data: bytes, options: FlightOptions, log: Log) -> None:
    """Take every position from the first three-dimensional fix on."""
    need_extra("pyulog", "ULog", "ulog", load=False)
    found = read_apart("ULog", data)
    topics: dict[str, Rows] = found["topics"]
    if found["end"] < len(data):
        octets = len(data) - found["end"]
        log.skip(f"offset {found['end']}", f"{octets} octets that are no whole message")
    receiver = next((topics[name] for name in RECEIVERS if name in topics), None)
    estimate = topics.get(ESTIMATE)
    rows = receiver if estimate is None else estimate
    if rows is None:
        raise PlotfeedError(f"no positions: neither {ESTIMATE} nor {' or '.join(RECEIVERS)}")
    name = next(name for name, each in topics.items() if each is rows)
    reference = options.altitude_reference or AltitudeReference.MEAN_SEA_LEVEL
    log.state(f"height in metres, above mean sea level: topic {name}")
    offset_ns, fixed_us = _clock_ns(receiver, options, log), 0
    if receiver is not None and "fix_type" in receiver:  # when it first had three dimensions
        fixed = receiver["timestamp"][receiver["fix_type"] >= FIX_3D]
        fixed_us = int(fixed[0]) if len(fixed) else 2**63
    times_us = rows["timestamp"]
    latitude, longitude, altitude = _positions(rows)
    velocity, accuracies = _velocity(rows), _accuracies(rows)
    fix = rows.get("fix_type")
    for i, t_us in enumerate(times_us.tolist()):
        where = f"{name} {i + 1}"
        if t_us < fixed_us or (fix is not None and fix[i] < FIX_3D):
            log.skip(where, "no three-dimensional fix yet")
        else:
            log.take(
                where,
                t_us * US_NS + offset_ns,
                (float(latitude[i]), float(longitude[i])),
                (float(altitude[i]), reference),
                velocity_enu_m_s=tuple(velocity[i].tolist()),
                **{key: float(column[i]) for key, column in accuracies.items()},
            )


def _positions(rows: Rows) -> tuple[Floats, Floats, Floats]:
    """Latitude, longitude and altitude; of old receivers' topics in 1e-7 degrees and mm."""
    if "latitude_deg" in rows:
        return rows["latitude_deg"], rows["longitude_deg"], rows["altitude_msl_m"]
    latitude, longitude, altitude = (rows[name] for name in OLD_PLACE)
    if np.issubdtype(latitude.dtype, np.integer):
        return latitude * 1e-7, longitude * 1e-7, altitude * 1e-3
    return latitude, longitude, altitude


def _velocity(rows: Rows) -> Floats:
    """East, north and up, of columns north, east and down; (n, 3), NaN without these."""
    for north, east, down in (("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"), ("vel_n", "vel_e", "vel_d")):
        if {north, east, down} <= rows.keys():
            return np.stack([rows[east], rows[north], -rows[down]], axis=-1).astype(np.float64)
    return np.full((len(rows["timestamp"]), 3), np.nan)


def _accuracies(rows: Rows) -> dict[str, Floats]:
    """Standard deviations as the log states them; NaN for what is none."""
    names = {
        "horizontal_accuracy_m": "eph",
        "vertical_accuracy_m": "epv",
        "velocity_accuracy_m_s": "s_variance_m_s",
    }
    stated = {ours: rows[theirs] for ours, theirs in names.items() if theirs in rows}
    return {name: np.where((v >= 0) & (v < np.inf), v, np.nan) for name, v in stated.items()}


def _clock_ns(receiver: Rows | None, options: FlightOptions, log: Log) -> int:
    """UTC less the log's time since boot, by the receiver; else the log begins when it is told."""
    if receiver is not None and "time_utc_usec" in receiver:
        utc_us, boot_us = receiver["time_utc_usec"], receiver["timestamp"]
        good = utc_us.astype(np.float64) >= EARLIEST_UTC_US
        if good.any():
            apart_us = utc_us[good].astype(np.int64) - boot_us[good].astype(np.int64)
            log.state("time: the receiver's UTC")
            return int(np.median(apart_us)) * US_NS
    if options.start_utc_ns is None:
        raise PlotfeedError(
            "no UTC in this log: the time of its start must be given (start_utc_ns)"
        )
    log.assume("the log has no UTC: its clock, since boot, begins at the start")
    return options.start_utc_ns

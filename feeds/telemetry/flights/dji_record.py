"""Flight records of DJI's apps (binary .txt) of versions 1 to 12: OSD records, by the app's clock.

A record is its type, how many octets follow, these, and FF. From version 7 on they are scrambled,
from 13 on encrypted. The layout is DJI's secret; as https://github.com/lvauvillier/dji-log-parser
and http://djilogs.live555.com found it out.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from functools import cache
from itertools import cycle

from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

FIRST_SCRAMBLED, DETAILS_FIRST, FIRST_ENCRYPTED, NO_VERSION_YET = 7, 12, 13, 32
"""Versions from which on records are scrambled, stand behind the details, and are encrypted."""
EXPORTERS = "Airdata, PhantomHelp or Flight Reader"
_LONG_HEAD_FROM, _SHORT_HEAD_OCTETS, _HEAD_OCTETS, _DETAILS_OCTETS = 6, 12, 100, 436
_START_MS_AT = 91
"""Of the details: when the flight began, milliseconds since 1970."""
_OSD, _CUSTOM = 1, 5
_END = 0xFF
_IMAGE, _IMAGE_END = b"\xff\xd8\xff", b"\xff\xd9"
_OF_OSD = struct.Struct("<2d4h12xB5xH")
"""Longitude and latitude, radians; height, m/10; velocity north, east and down, dm/s; satellites;
how long it has flown, s/10."""
_OF_CUSTOM = struct.Struct("<2x2fq")
"""Speed, distance, and the app's clock, milliseconds since 1970."""
_MAGIC = 0x123456789ABCDEF0
_CRC_64 = 0x95AC9329AC4BC9B5
"""The polynomial of Jones, its bits in reverse."""
MIN_SATELLITES = 4
"""The fewest that give a position in three dimensions."""
_MS_NS, _TENTH_NS = NS // 1000, NS // 10
_LATEST_MS = 2**63 // _MS_NS
_LEAST_OCTETS = {_OSD: _OF_OSD.size, _CUSTOM: _OF_CUSTOM.size}


def record_version(data: bytes) -> int | None:
    """The version of a flight record of a DJI app; None for what is none.

    It begins with where its details are, 8 octets little-endian, their length, 2, and the version.
    """
    details, version = int.from_bytes(data[:8], "little"), data[10] if len(data) > 10 else 0
    is_place = _SHORT_HEAD_OCTETS < details <= len(data)
    if not (0 < version < NO_VERSION_YET and 0 in data[:8]):
        return None
    return version if is_place or (details == 0 and version >= FIRST_ENCRYPTED) else None


def read_dji_record(data: bytes, options: FlightOptions, log: Log) -> None:
    """Take every OSD record with a position; raises `PlotfeedError` for an encrypted one."""
    version = record_version(data)
    if version is None:
        raise PlotfeedError("no flight record of a DJI app")
    if version >= FIRST_ENCRYPTED:
        raise PlotfeedError(
            f"a flight record of a DJI app, version {version}, encrypted, with a key that DJI "
            f"gives to who asks for it: have {EXPORTERS} make a CSV of it, and give that"
        )
    reference = options.altitude_reference or AltitudeReference.ABOVE_TAKEOFF
    log.state(f"height in metres, above take-off: OSD, version {version}")
    frames = list(_frames(data, version, log))
    if not frames:
        raise PlotfeedError("no positions: expected OSD records")
    clock = _clock(data, version, frames, options, log)
    for offset, octets, app_ms in frames:
        where = f"offset {offset}"
        longitude, latitude, height, north, east, down, satellites, flown = _OF_OSD.unpack_from(
            octets
        )
        t_utc_ns = app_ms * _MS_NS if clock is None else clock + flown * _TENTH_NS
        if longitude == 0 and latitude == 0:
            log.skip(where, "position 0, 0: no GPS fix")
        elif satellites < MIN_SATELLITES:
            log.skip(where, f"{satellites} satellites; expected {MIN_SATELLITES} or more")
        elif clock is None and not 0 < app_ms < _LATEST_MS:
            log.skip(where, "no time")
        else:
            log.take(
                where,
                t_utc_ns=t_utc_ns,
                latitude_deg=math.degrees(latitude),
                longitude_deg=math.degrees(longitude),
                altitude_m=height / 10,
                altitude_reference=reference,
                velocity_enu_m_s=(east / 10, north / 10, -down / 10),
            )


def _frames(data: bytes, version: int, log: Log) -> Iterator[tuple[int, bytes, int]]:
    """Where each OSD record stands, its octets, and the app's time behind it; 0 where none is."""
    offset, osd, app_ms = 0, b"", 0
    for at, kind, octets in _records(data, version, log):
        if kind == _OSD:
            if osd:
                yield offset, osd, app_ms
            offset, osd, app_ms = at, octets, 0
        elif kind == _CUSTOM and not app_ms:
            app_ms = _OF_CUSTOM.unpack_from(octets)[2]
    if osd:
        yield offset, osd, app_ms


def _clock(
    data: bytes,
    version: int,
    frames: list[tuple[int, bytes, int]],
    options: FlightOptions,
    log: Log,
) -> int | None:
    """UTC of take-off, nanoseconds; None where the app's clock is beside the positions."""
    if any(app_ms > 0 for _, _, app_ms in frames):
        log.state("time: the app's clock, in CUSTOM")
        return None
    details = _HEAD_OCTETS if version >= DETAILS_FIRST else int.from_bytes(data[:8], "little")
    start = data[details + _START_MS_AT : details + _START_MS_AT + 8]
    start_ms = int.from_bytes(start, "little")
    if 0 < start_ms < _LATEST_MS:
        log.assume("it took off when its details say that it began: it has no clock besides")
        return start_ms * _MS_NS
    if options.start_utc_ns is None:
        raise PlotfeedError(
            "no time in this record: the time of its start must be given (start_utc_ns)"
        )
    log.assume("the record has no time: it took off at the start")
    return options.start_utc_ns


def _records(data: bytes, version: int, log: Log) -> Iterator[tuple[int, int, bytes]]:
    """Offset, type and octets of the wanted records; images are passed over, and damage is told."""
    at, end = _place(data, version)
    bad_from, may_have_images = at, True
    while at < end:
        if at == bad_from and data[at] == 0:  # between records
            at = bad_from = at + 1
            continue
        image_end = -1
        if may_have_images and data.startswith(_IMAGE, at):
            image_end = data.find(_IMAGE_END, at, end)
            may_have_images = image_end >= 0
        after = image_end + len(_IMAGE_END) if image_end >= 0 else _after(data, at, end)
        # Where the last one ended the next is expected; elsewhere another must follow.
        if after is None or (at > bad_from and image_end < 0 and not _is_start(data, after, end)):
            at += 1
            continue
        _tell_damage(bad_from, at, log)
        if image_end < 0 and data[at] in _LEAST_OCTETS:
            kind, octets = data[at], data[at + 2 : after - 1]
            if version >= FIRST_SCRAMBLED:
                octets = _plain(kind, octets)
            if len(octets) >= _LEAST_OCTETS[kind]:
                yield at, kind, octets
            else:
                log.skip(f"offset {at}", f"a record of type {kind} that is too short")
        at = bad_from = after
    _tell_damage(bad_from, end, log)


def _tell_damage(start: int, end: int, log: Log) -> None:
    if end > start:
        log.skip(f"offset {start}", f"{end - start} octets that are no record")


def _place(data: bytes, version: int) -> tuple[int, int]:
    """Where the records begin and end."""
    if version >= DETAILS_FIRST:
        return _HEAD_OCTETS + _DETAILS_OCTETS, len(data)
    begin = _HEAD_OCTETS if version >= _LONG_HEAD_FROM else _SHORT_HEAD_OCTETS
    return begin, int.from_bytes(data[:8], "little")


def _after(data: bytes, at: int, end: int) -> int | None:
    """Where the record ends that begins there; None if none does."""
    if at + 2 >= end:
        return None
    after = at + 3 + data[at + 1]
    return after if after <= end and data[after - 1] == _END else None


def _is_start(data: bytes, at: int, end: int) -> bool:
    """Whether a record or an image seems to begin there, or all ends."""
    return at >= end or data.startswith(_IMAGE, at) or _after(data, at, end) is not None


def _plain(kind: int, octets: bytes) -> bytes:
    """The octets of a scrambled record, of which the first chooses the key."""
    if not octets:
        return b""
    return bytes(a ^ b for a, b in zip(octets[1:], cycle(scrambling_key(kind, octets[0]))))


@cache
def scrambling_key(kind: int, first: int) -> bytes:
    """The eight octets by which a record of that type and first octet is scrambled, over and over.

    A CRC-64 that begins with the sum of both, of the first octet times a constant.
    """
    crc = (first * _MAGIC & 2**64 - 1) ^ ((first + kind) & 0xFF)  # eight octets are at once in it
    for _ in range(64):
        crc = crc >> 1 ^ (_CRC_64 if crc & 1 else 0)
    return crc.to_bytes(8, "little")

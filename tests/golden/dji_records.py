"""Flight records as DJI's apps wrote them to version 12, for make_flights.py and tests.

Each fifth of a second OSD and CUSTOM, each second HOME and RC, at the end an image; the details,
behind them or, in version 12, before them. From version 7 on what a record holds is scrambled.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import radians
from typing import NamedTuple

HEAD_OCTETS, DETAILS_OCTETS = 100, 436
OSD, HOME, RC, CUSTOM = 1, 2, 4, 5
IMAGE = b"\xff\xd8\xff\xe0\x00\x10JFIF\x00" + bytes(range(1, 200)) + b"\xff\xd9"
JONES = 0x95AC9329AC4BC9B5


class Flown(NamedTuple):
    """Where the drone was, and how it moved."""

    t_utc_ms: int
    latitude_deg: float
    longitude_deg: float
    up_m: float
    east_m_s: float
    north_m_s: float
    climb_m_s: float
    flown_s: float
    satellites: int = 14


def dji_record(version: int, rows: Sequence[Flown], *, has_clock: bool = True) -> bytes:
    """The whole file; without a clock the app wrote no CUSTOM."""
    records = b""
    for i, row in enumerate(rows):
        records += _record(version, OSD, _osd(row), i)
        if i % 5 == 0:
            home = struct.pack("<2df", radians(row.longitude_deg), radians(row.latitude_deg), 1200)
            records += _record(version, HOME, home + bytes(14), i)
            records += _record(version, RC, struct.pack("<5H", *[1024] * 5), i)
        if has_clock:
            custom = struct.pack("<2B2fq", 0, 0, row.east_m_s, 12.0, row.t_utc_ms)
            records += _record(version, CUSTOM, custom, i)
    records += IMAGE
    details = bytes(80 + 3) + struct.pack("<iiq", len(rows), 0, rows[0].t_utc_ms)
    details = details.ljust(DETAILS_OCTETS, b"\0")
    octets = HEAD_OCTETS if version >= 6 else 12
    if version >= 12:
        place, parts = octets + len(details) + len(records), (details, records)
    else:
        place, parts = octets + len(records), (records, details)
    head = struct.pack("<QH2B", place, len(details), version, 0).ljust(octets, b"\0")
    return head + b"".join(parts)


def _osd(row: Flown) -> bytes:
    place = radians(row.longitude_deg), radians(row.latitude_deg)
    moved = (row.up_m, row.north_m_s, row.east_m_s, -row.climb_m_s)
    is_fixed = row.satellites >= 4
    return struct.pack(
        "<2d7h2BI6BHB2x6B",
        *(place if is_fixed else (0.0, 0.0)),
        *(round(value * 10) for value in moved),
        *(-12, 8, 900),
        *(6, 0, 0x8000 * is_fixed | 0x0C),
        *(row.satellites, 0, 0, 0, 87, 15),
        round(row.flown_s * 10),
        *(55, 9, 11, 0, 0, 0, 0),
    )


def _record(version: int, kind: int, octets: bytes, number: int) -> bytes:
    if version >= 7:
        first = number * 37 & 0xFF
        key = _key(kind, first)
        hidden = bytes(octet ^ key[i % 8] for i, octet in enumerate(octets))
        octets = bytes([first]) + hidden + b"\0"
    return bytes([kind, len(octets)]) + octets + b"\xff"


def _key(kind: int, first: int) -> bytes:
    crc = (kind + first) % 256
    for octet in (first * 0x123456789ABCDEF0 % 2**64).to_bytes(8, "little"):
        crc ^= octet
        for _ in range(8):
            crc = crc >> 1 ^ JONES * (crc & 1)
    return crc.to_bytes(8, "little")

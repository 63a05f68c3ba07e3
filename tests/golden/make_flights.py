"""Writes flights/: one path as a DJI drone, a rotary UAV and ArduPilot would have logged it.

    .venv/bin/python tests/golden/make_flights.py

The path is known at every instant, unlike that of a recorded flight: `place_m` and `velocity_m_s`
say where the drone is from where it took off. Layouts are those of real logs: subtitles of a
Matrice 300, a table with columns of its own, and DataFlash records of ArduPilot 4 with the formats
before them, fixes that are none in the beginning, and one that is logged twice.
"""

from __future__ import annotations

import struct
import sys
from datetime import UTC, datetime, timedelta
from math import atan2, cos, degrees, hypot, pi, radians, sin
from pathlib import Path

HERE = Path(__file__).parent / "flights"
DURATION_S = 210
START = datetime(2024, 5, 14, 9, 30, tzinfo=UTC)
LATITUDE_DEG, LONGITUDE_DEG, GROUND_MSL_M = 43.3, -5.9, 120.0
GROUND_ELLIPSOID_M = 172.0
"""Of the CSV and the DataFlash log, 52 m of geoid above the sea."""
WITHOUT_FIX = 25
FIX_S = 0.5
GPS_EPOCH, LEAP_S = datetime(1980, 1, 6, tzinfo=UTC), 18
EARTH_A_M, EARTH_E2 = 6_378_137.0, 0.0066943799901413165  # WGS 84


def place_m(t_s: float) -> tuple[float, float, float]:
    """East, north and up: a figure of eight that it gathers speed for, at changing heights."""
    u, _ = _progress(t_s)
    return 130 * sin(u), 90 * sin(2 * u), 30 - 30 * cos(1.5 * u)


def velocity_m_s(t_s: float) -> tuple[float, float, float]:
    """The same as its derivative."""
    u, rate = _progress(t_s)
    return 130 * cos(u) * rate, 180 * cos(2 * u) * rate, 45 * sin(1.5 * u) * rate


def _progress(t_s: float) -> tuple[float, float]:
    """Along the figure, and its rate; at rest for 10 s, faster for 15 s, steady from then on."""
    steady = 2 * pi / 95
    since = t_s - 10
    if since <= 0:
        return 0.0, 0.0
    if since < 15:
        return steady * since**2 / 30, steady * since / 15
    return steady * (since - 7.5), steady


def geodetic(t_s: float) -> tuple[float, float, float]:
    """Latitude and longitude, degrees, and height above where it took off."""
    east, north, up = place_m(t_s)
    bent = 1 - EARTH_E2 * sin(radians(LATITUDE_DEG)) ** 2
    across = EARTH_A_M / bent**0.5 + GROUND_ELLIPSOID_M
    along = EARTH_A_M * (1 - EARTH_E2) / bent**1.5 + GROUND_ELLIPSOID_M
    latitude_deg = LATITUDE_DEG + degrees(north / along)
    longitude_deg = LONGITUDE_DEG + degrees(east / across / cos(radians(LATITUDE_DEG)))
    return latitude_deg, longitude_deg, up


def subtitles() -> str:
    """Positions to 4 digits, heights above take-off; the day and local time of each second."""
    blocks = []
    for i in range(DURATION_S + 1):
        latitude_deg, longitude_deg, up_m = geodetic(i)
        shown = [f"{timedelta(seconds=n)!s:0>8},000" for n in (i, i + 1)]
        day = START + timedelta(seconds=i)
        blocks.append(
            f"{i + 1}\n{shown[0]} --> {shown[1]}\n{day:%Y.%m.%d %H:%M:%S}\n"
            f"GPS({latitude_deg:.4f},{longitude_deg:.4f},0.0M) BAROMETER:{up_m:.1f}M\n"
        )
    return "\n".join(blocks)


def table() -> str:
    """Seconds of the day beside the date, course and speed beside the velocity."""
    lines = [
        "time,timestamp,latitude,longitude,altitude (m),speed,heading,date,groupNb,Vx m/s,Vy m/s"
    ]
    for i in range(DURATION_S + 1):
        latitude_deg, longitude_deg, up_m = geodetic(i)
        east, north, _ = velocity_m_s(i)
        t = START + timedelta(seconds=i)
        of_day_s = (t - t.replace(hour=0, minute=0)).total_seconds()
        lines.append(
            f"{t:%Y-%m-%d %H:%M:%S},{of_day_s},{latitude_deg:.8f},{longitude_deg:.8f},"
            f"{GROUND_MSL_M + up_m:.1f},{hypot(east, north):.6f},"
            f"{degrees(atan2(east, north)) % 360:.1f},{t:%d%m%y},0,{east:.4f},{north:.4f}"
        )
    return "\n".join(lines) + "\n"


FORMAT = struct.Struct("<BB4s16s64s")
GPS = struct.Struct("<QBBIHBhiiifffB")
ATTITUDE = struct.Struct("<QhhhhHHHH")
FORMATS = {
    0x80: (FORMAT, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"),
    0x8A: (
        *(GPS, b"GPS", b"QBBIHBcLLefffB"),
        b"TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,U",
    ),
    0x8B: (
        *(ATTITUDE, b"ATT", b"QccccCCCC"),
        b"TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw",
    ),
}


def dataflash() -> bytes:
    """Fixes each half a second, the attitude between them."""
    out = b"".join(
        _record(0x80, (kind, body.size + 3, name, codes, columns))
        for kind, (body, name, codes, columns) in FORMATS.items()
    )
    since_boot_us = 31_000_000
    for i in range(-WITHOUT_FIX, round(DURATION_S / FIX_S) + 1):
        t_s = i * FIX_S
        time_us = since_boot_us + round(t_s * 1e6)
        out += _record(0x8A, _fix(t_s, time_us, is_one=i >= 0))
        if i == 100:
            out += _record(0x8A, _fix(t_s, time_us, is_one=True))
        yaw = round(i * 37 % 36_000)
        out += _record(0x8B, (time_us + 1000, 120, 118, -40, -43, yaw, yaw, 2, 1))
    return out


def _record(kind: int, values: tuple[int | float | bytes, ...]) -> bytes:
    return b"\xa3\x95" + bytes([kind]) + FORMATS[kind][0].pack(*values)


def _fix(t_s: float, time_us: int, *, is_one: bool) -> tuple[int | float, ...]:
    latitude_deg, longitude_deg, up_m = geodetic(max(t_s, 0.0))
    east, north, up = velocity_m_s(max(t_s, 0.0))
    since = START - GPS_EPOCH + timedelta(seconds=LEAP_S + t_s)
    week, of_week = divmod(since, timedelta(weeks=1))
    return (
        *(time_us, 0, 3 if is_one else 1, round(of_week / timedelta(milliseconds=1)), week),
        *(14 if is_one else 2, 70 if is_one else 9999),
        *(round(latitude_deg * 1e7) * is_one, round(longitude_deg * 1e7) * is_one),
        round((GROUND_MSL_M + up_m) * 100) * is_one,
        *(hypot(east, north), degrees(atan2(east, north)) % 360, -up, 1),
    )


def write(folder: Path) -> None:
    """All of them."""
    (folder / "eight.srt").write_text(subtitles())
    (folder / "eight.csv").write_text(table())
    (folder / "eight.bin").write_bytes(dataflash())


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)

"""Writes flights/: one path as drones, autopilots, receivers and exporters would have logged it.

    .venv/bin/python tests/golden/make_flights.py

The path is known at every instant, unlike that of a recorded flight: `place_m` and `velocity_m_s`
say where the drone is from where it took off. Layouts are those of real logs: subtitles of a
Matrice 300, a table with columns of its own, and DataFlash records of ArduPilot 4 with the formats
before them, fixes that are none in the beginning, and one that is logged twice. A part of it as
Airdata, Litchi, PhantomHelp, older DJI models, PX4, KML and NMEA have it.
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
GROUND_ELLIPSOID_M = 172.0  # Of the CSV and the DataFlash log, 52 m of geoid above the sea
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


PART_S = (20, 45)  # Of the flight, in the files below: they are many, and kept small
PHASE_S = 0.37  # By which their clocks of whole seconds are behind the beginning
FOOT_M = 0.3048


def airdata() -> str:
    """Airdata's CSV: 10 Hz, the clock in whole seconds, feet and miles, blanks before names."""
    lines = [
        "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),"
        "height_above_ground_at_drone_location(feet),altitude_above_seaLevel(feet),"
        "height_sonar(feet),speed(mph),satellites, xSpeed(mph), ySpeed(mph), zSpeed(mph),message"
    ]
    for ms in range(0, (PART_S[1] - PART_S[0]) * 1000, 100):
        latitude_deg, longitude_deg, up_m = geodetic(PART_S[0] + ms / 1000)
        east, north, up = velocity_m_s(PART_S[0] + ms / 1000)
        mph = [v / 0.44704 for v in (hypot(east, north), north, east, -up)]
        shown = START + timedelta(seconds=PART_S[0] + PHASE_S + ms / 1000)
        feet = [up_m / FOOT_M, up_m / FOOT_M, (up_m + GROUND_MSL_M) / FOOT_M]
        lines.append(
            f"{ms},{shown:%Y-%m-%d %H:%M:%S},{latitude_deg:.10f},{longitude_deg:.10f},"
            + ",".join(f"{v:.2f}" for v in feet)
            + f",0,{mph[0]:.4f},17,{mph[1]:.4f},{mph[2]:.4f},{mph[3]:.4f},"
        )
    return "\n".join(lines) + "\n"


def litchi() -> str:
    """Litchi's CSV: altitude above take-off, which it does not say; UTC with milliseconds."""
    lines = [
        "latitude,longitude,altitude(m),ascent(m),speed(m/s),distance(m),max_altitude(m),"
        "satellites,gpslevel,voltage(v),velocityX(mps),velocityY(mps),velocityZ(mps),pitch(deg),"
        "roll(deg),yaw(deg),time(millisecond),datetime(utc),datetime(local),flightmode"
    ]
    for ms in range(0, (PART_S[1] - PART_S[0]) * 1000, 200):
        latitude_deg, longitude_deg, up_m = geodetic(PART_S[0] + ms / 1000)
        east, north, up = velocity_m_s(PART_S[0] + ms / 1000)
        utc = START + timedelta(seconds=PART_S[0], milliseconds=ms)
        local = utc + timedelta(hours=2)
        lines.append(
            f"{latitude_deg:.8f},{longitude_deg:.8f},{up_m:.1f},0,{hypot(east, north):.1f},0,60.0,"
            f"16,5,15.2,{north:.1f},{east:.1f},{-up:.1f},0,0,0,{ms},"
            f"{utc:%Y-%m-%d %H:%M:%S}.{utc.microsecond // 1000:03d},"
            f"{local:%Y-%m-%d %H:%M:%S}.{local.microsecond // 1000:03d},P-GPS"
        )
    return "\n".join(lines) + "\n"


def phantomhelp() -> str:
    """PhantomHelp's and Flight Reader's: a line before the names, date and time apart, feet."""
    lines = [
        "sep=,",
        "CUSTOM.date [local],CUSTOM.updateTime [local],OSD.flyTime [s],OSD.latitude,"
        "OSD.longitude,OSD.height [ft],OSD.hSpeed [MPH],OSD.gpsNum",
    ]
    for tenths in range(0, (PART_S[1] - PART_S[0]) * 10, 2):
        latitude_deg, longitude_deg, up_m = geodetic(PART_S[0] + tenths / 10)
        east, north, _ = velocity_m_s(PART_S[0] + tenths / 10)
        at = START + timedelta(hours=2, seconds=PART_S[0] + tenths / 10)
        hundredths = at.microsecond // 10_000
        lines.append(
            f"{at.month}/{at.day}/{at.year},{at:%I:%M:%S}.{hundredths:02d} {at:%p},{tenths / 10},"
            f"{latitude_deg:.8f},{longitude_deg:.8f},{up_m / FOOT_M:.1f},"
            f"{hypot(east, north) / 0.44704:.1f},16"
        )
    return "\n".join(lines) + "\n"


def old_subtitles() -> str:
    """An older DJI's: longitude first, then satellites, the height as Hb, no empty first hour."""
    blocks = []
    for i in range(PART_S[1] - PART_S[0]):
        latitude_deg, longitude_deg, up_m = geodetic(PART_S[0] + i)
        at = START + timedelta(seconds=PART_S[0] + i)
        shown = [f"{timedelta(seconds=n)!s:0>8},000" for n in (i, i + 1)]
        blocks.append(
            f"{i + 1}\n{shown[0]} --> {shown[1]}\n"
            f"HOME({LONGITUDE_DEG:.4f},{LATITUDE_DEG:.4f}) "
            f"{at.year}.{at.month}.{at.day} {at:%H:%M:%S}\n"
            f"GPS({longitude_deg:.6f},{latitude_deg:.6f},16) Hs:0.0 Hb:{up_m:.1f}\n"
            "ISO:100 Shutter:60 EV: Fnum:F2.2\n"
        )
    return "\n".join(blocks)


def frame_subtitles() -> str:
    """A film's at 5 frames a second: dates in whole seconds beside timecodes, no heights."""
    blocks = []
    for i in range((PART_S[1] - PART_S[0]) * 5):
        latitude_deg, longitude_deg, _ = geodetic(PART_S[0] + i / 5)
        at = START + timedelta(seconds=PART_S[0] + PHASE_S + i / 5)
        codes = [f"00:00:{n // 5:02d},{n % 5 * 200:03d}" for n in (i, i + 1)]
        blocks.append(
            f'{i + 1}\n{codes[0]} --> {codes[1]}\n<font size="28">FrameCnt: {i + 1}\n'
            f"{at:%Y-%m-%d %H:%M:%S}\n[latitude: {latitude_deg:.6f}] "
            f"[longitude: {longitude_deg:.6f}] </font>\n"
        )
    return "\n".join(blocks)


ULOG_HEAD = b"ULog\x01\x12\x35\x01"
BOOT_US = 31_000_000
ULOG_TOPICS = {
    b"vehicle_global_position": (
        b"uint64_t timestamp;double lat;double lon;float alt;float eph;float epv;",
        "<Qddfff",
    ),
    b"vehicle_gps_position": (
        b"uint64_t timestamp;uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;"
        b"float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;uint8_t[3] _padding0;",
        "<QQiiifffB",  # padding at the end is not logged
    ),
}


def ulog() -> bytes:
    """PX4's: the estimator at 5 Hz, the receiver at 1 Hz, which has its fix after 3 s."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<H", len(body)) + kind + body

    out = ULOG_HEAD + struct.pack("<Q", BOOT_US) + message(b"B", bytes(40))
    for name, (fields, _) in ULOG_TOPICS.items():
        out += message(b"F", name + b":" + fields)
    for number, name in enumerate(ULOG_TOPICS):
        out += message(b"A", struct.pack("<BH", 0, number) + name)
    layouts = [layout for _, layout in ULOG_TOPICS.values()]
    for fifths in range((PART_S[1] - PART_S[0]) * 5):
        t_s = PART_S[0] + fifths / 5
        latitude_deg, longitude_deg, up_m = geodetic(t_s)
        east, north, up = velocity_m_s(t_s)
        boot_us, altitude_m = BOOT_US + fifths * 200_000, GROUND_MSL_M + up_m
        if fifths % 5 == 0:
            utc_us = round((START + timedelta(seconds=t_s)).timestamp() * 1e6)
            fixed = fifths >= 15
            body = struct.pack(
                layouts[1],
                *(boot_us, utc_us * fixed, round(latitude_deg * 1e7), round(longitude_deg * 1e7)),
                *(round(altitude_m * 1000), north, east, -up, 3 if fixed else 2),
            )
            out += message(b"D", struct.pack("<H", 1) + body)
        body = struct.pack(layouts[0], boot_us, latitude_deg, longitude_deg, altitude_m, 0.8, 1.2)
        out += message(b"D", struct.pack("<H", 0) + body)
    return out


def kml() -> str:
    """A gx:Track with absolute altitudes, one of whose coordinates is empty."""
    points = []
    for i in range(PART_S[1] - PART_S[0]):
        latitude_deg, longitude_deg, up_m = geodetic(PART_S[0] + i)
        at = START + timedelta(seconds=PART_S[0] + i)
        place = f"{longitude_deg:.8f} {latitude_deg:.8f} {GROUND_MSL_M + up_m:.2f}"
        points.append(
            f"<when>{at:%Y-%m-%dT%H:%M:%SZ}</when><gx:coord>{'' if i == 7 else place}</gx:coord>"
        )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2" '
        'xmlns:gx="http://www.google.com/kml/ext/2.2"><Document><Placemark><gx:Track>\n'
        "<altitudeMode>absolute</altitudeMode>\n"
        + "\n".join(points)
        + "\n</gx:Track></Placemark></Document></kml>\n"
    )


def nmea() -> str:
    """A receiver's at 5 Hz: RMC each second, GGA each time; the first two without a fix."""

    def sentence(told: str) -> str:
        check = 0
        for octet in told.encode():
            check ^= octet
        return f"${told}*{check:02X}"

    def angle(value_deg: float, digits: int, sides: str) -> str:
        whole, part = divmod(abs(value_deg), 1)
        return f"{int(whole):0{digits}d}{part * 60:09.6f},{sides[value_deg < 0]}"

    lines = []
    for fifths in range((PART_S[1] - PART_S[0]) * 5):
        t_s = PART_S[0] + fifths / 5
        latitude_deg, longitude_deg, up_m = geodetic(t_s)
        east, north, _ = velocity_m_s(t_s)
        at = START + timedelta(seconds=t_s)
        clock = f"{at:%H%M%S}.{at.microsecond // 10_000:02d}"
        place = f"{angle(latitude_deg, 2, 'NS')},{angle(longitude_deg, 3, 'EW')}"
        if fifths % 5 == 0:
            knots, course = hypot(east, north) / 0.514444, degrees(atan2(east, north)) % 360
            told = f"GNRMC,{clock},A,{place},{knots:.2f},{course:.1f},{at:%d%m%y},,,A"
            lines.append(sentence(told))
        quality = 0 if fifths < 2 else 1
        told = f"GNGGA,{clock},{place},{quality},14,0.7,{GROUND_MSL_M + up_m:.2f},M,52.0,M,,"
        lines.append(sentence(told))
    return "\r\n".join(lines) + "\r\n"


def write(folder: Path) -> None:
    """All of them."""
    (folder / "eight.srt").write_text(subtitles())
    (folder / "eight.csv").write_text(table())
    (folder / "eight.bin").write_bytes(dataflash())
    (folder / "part.ulg").write_bytes(ulog())
    for name, text in (
        ("airdata.csv", airdata()),
        ("litchi.csv", litchi()),
        ("phantomhelp.csv", phantomhelp()),
        ("old.srt", old_subtitles()),
        ("frames.srt", frame_subtitles()),
        ("part.kml", kml()),
        ("part.nmea", nmea()),
    ):
        (folder / name).write_bytes(text.encode())


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)

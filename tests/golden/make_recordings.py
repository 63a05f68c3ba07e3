"""Writes recordings/: what a turning radar of air traffic control and a tracker send, recorded.

libasterix encodes, and the containers are written here:

    .venv/bin/python tests/golden/make_recordings.py

The capture has two scans in Ethernet frames, padded where they are short, to two groups of
receivers. A packet has plots, or the message of a sector, or both. The frames are FINAL.
"""

from __future__ import annotations

import struct
import sys
from math import cos, radians, sin
from pathlib import Path
from random import Random
from typing import Any

from asterix.generated import Cat_034_1_29, Cat_048_1_32, Cat_062_1_21

HERE = Path(__file__).parent / "recordings"
SAC, SIC = 25, 13
DAY_S = 1_715_644_800  # 2024-05-14
NOON_S = 12 * 3600
SECTORS, PERIOD_S = 32, 633 / 128
AIRCRAFT = 40
LETTERS = " ABCDEFGHIJKLMNOPQRSTUVWXYZ     " + " " * 16 + "0123456789"


def block(category: Any, records: list[dict[str, Any]]) -> bytes:
    """A data block of libasterix."""
    made = [category.cv_record.create(items) for items in records]
    octets: bytes = category.create(made).unparse().to_bytes()
    return octets


def callsign(text: str) -> int:
    """Eight characters of six bits."""
    number = 0
    for letter in text.ljust(8):
        number = number << 6 | LETTERS.index(letter) % 64 if letter != " " else number << 6 | 32
    return number


def source() -> tuple[tuple[str, int], tuple[str, int]]:
    """Who sends."""
    return (("SAC", SAC), ("SIC", SIC))


def plot(chance: Random, number: int, azimuth_deg: float, t_s: float) -> dict[str, Any]:
    """What a Mode S radar has of one aircraft; every ninth is an echo alone."""
    range_nm, level = chance.uniform(5, 220), chance.randrange(80, 1600)
    items: dict[str, Any] = {
        "010": source(),
        "140": round(t_s * 128),
        "040": (
            ("RHO", round(range_nm * 256)),
            ("THETA", round(azimuth_deg * 65536 / 360) % 65536),
        ),
        "161": (0, number + 1),
        "170": ((0, 2, 0, 0, 0, None),),
    }
    if number % 9 == 0:
        return items | {
            "020": ((1, 0, 0, 0, 0, None),),
            "130": {"PRL": chance.randrange(10, 90), "PAM": chance.randrange(170, 226)},
        }
    x_nm, y_nm = (range_nm * turn(radians(azimuth_deg)) for turn in (sin, cos))
    return items | {
        "020": ((5, 0, 0, 0, 0, None),),
        "070": (0, 0, number % 2, 0, chance.randrange(0o7777)),
        "090": (0, 0, level),
        "130": {
            "SRL": chance.randrange(60, 90),
            "SRR": chance.randrange(1, 30),
            "SAM": chance.randrange(176, 216),
        },
        "220": chance.randrange(1, 1 << 24),
        "240": callsign(f"PLF{number:03}"),
        "250": [chance.getrandbits(56) << 8 | bds for bds in (0x40, 0x60)[: 1 + number % 2]],
        "042": (round(x_nm * 128) % 65536, round(y_nm * 128) % 65536),
        "200": (chance.randrange(800, 2400), chance.randrange(65536)),
        "230": (1, 0, 0, 0, 1, 1, 1, 1, 5),
    }


def north(t_s: float) -> dict[str, Any]:
    """The beam passes north: how the radar is, and where."""
    return {
        "010": source(),
        "000": 1,
        "030": round(t_s * 128),
        "041": 633,
        "050": {"COM": (0, 1, 0, 0, 0, 1, 0, 0), "MDS": (0, 2, 0, 1, 1, 1, 0, 0, 0)},
        "060": {"COM": (0, 0, 0, 0), "MDS": (0, 0, 0)},
        "120": (300, 2_018_000, -275_000 % (1 << 24)),
    }


def packets() -> list[tuple[float, bytes]]:
    """Payloads, and when in the day they were sent."""
    chance = Random(34)  # noqa: S311
    aircraft = sorted(chance.uniform(0, 360) for _ in range(AIRCRAFT))
    sent = []
    for sector in range(2 * SECTORS + 1):
        end_deg = sector * 360 / SECTORS
        t_s = NOON_S + end_deg / 360 * PERIOD_S
        seen = [
            (i, azimuth)
            for i, azimuth in enumerate(aircraft)
            if (sector - 1) % SECTORS * 360 / SECTORS
            <= azimuth
            < ((sector - 1) % SECTORS + 1) * 11.25
        ]
        plots = [
            plot(chance, i, azimuth, t_s - ((end_deg - azimuth) % 360) / 360 * PERIOD_S)
            for i, azimuth in seen
        ] if sector else []  # fmt: skip
        # Sent at a sector's end, with where the next one begins.
        crossing = {"010": source(), "000": 2, "030": round(t_s * 128), "020": sector * 8 % 256}
        about = block(Cat_034_1_29, [crossing if sector % SECTORS else north(t_s)])
        of_plots = block(Cat_048_1_32, plots) if plots else b""
        together = sector % 3 and sector % SECTORS
        parts = [of_plots + about] if together else [of_plots, about]
        for i, octets in enumerate(filter(None, parts)):
            sent.append((t_s + 0.11 + 0.002 * i, octets))
    return sent


def frame(payload: bytes, group: int) -> bytes:
    """An Ethernet frame of a datagram to a group of receivers."""
    group_address, own = bytes([232, group, 1, 13]), bytes([10, 0, 3, 13])
    udp = struct.pack(">HHHH", 50_000, 21_113 + group, 8 + len(payload), 0)
    head = struct.pack(
        ">BBHHHBBH4s4s", 0x45, 0, 28 + len(payload), 7, 0, 32, 17, 0, own, group_address
    )
    head = head[:10] + struct.pack(">H", checksum(head)) + head[12:]
    pseudo = own + group_address + struct.pack(">BBH", 0, 17, 8 + len(payload))
    udp = udp[:6] + struct.pack(">H", checksum(pseudo + udp + payload) or 0xFFFF)
    ethernet = bytes.fromhex("01005e") + group_address[1:] + bytes.fromhex("02000000030d0800")
    return (ethernet + head + udp + payload).ljust(60, b"\0")


def checksum(octets: bytes) -> int:
    """Of the internet."""
    words = struct.unpack(f">{(len(octets) + 1) // 2}H", octets + b"\0" * (len(octets) % 2))
    total = sum(words)
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


def capture() -> bytes:
    """All packets, to both groups, 20 microseconds apart."""
    out = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1)
    for t_s, payload in packets():
        for group in (1, 2):
            octets = frame(payload, group)
            us = round(t_s * 1e6) + 20 * group
            seconds, fraction = divmod(us, 1_000_000)
            out += (
                struct.pack("<IIII", DAY_S + seconds, fraction, len(octets), len(octets)) + octets
            )
    return out


def final(payload: bytes, t_s: float) -> bytes:
    """A frame of a recorder, which notes hundredths of seconds."""
    ticks = round(t_s * 100).to_bytes(3, "big")
    return struct.pack(">HBBB", 12 + len(payload), 0, 0, 0) + ticks + payload + b"\xa5" * 4


def track() -> dict[str, Any]:
    """What a tracker has of one aircraft."""
    return {
        "010": (("SAC", SAC), ("SIC", 100)),
        "015": 1,
        "070": NOON_S * 128 + 105,
        "105": (8_260_333, 2_018_777),
        "100": (16_700_000, 90_123),
        "185": (647, 64_900),
        "060": (0, 0, 0, 0, 0o3412),
        "040": 1473,
        "136": 1400,
        "220": 65_400,
    }


def write(folder: Path) -> None:
    """All of them."""
    chance = Random(48)  # noqa: S311
    plots = [plot(chance, i, 335 + i, NOON_S + 36.2 + i / 64) for i in range(2)]
    (folder / "turning_radar.pcap").write_bytes(capture())
    (folder / "two_plots.ff").write_bytes(final(block(Cat_048_1_32, plots), NOON_S + 37.42))
    (folder / "one_track.ff").write_bytes(final(block(Cat_062_1_21, [track()]), NOON_S + 2.5))


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)

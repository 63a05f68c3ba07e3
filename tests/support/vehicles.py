"""Autopilots that send what pymavlink's own endpoint makes, in processes of their own.

    python vehicles.py udpout:127.0.0.1:14550 --system 1 --system 2

Each system circles at 100 m above its home, which is 650 m above the sea.
"""

from __future__ import annotations

import argparse
import math
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

CENTRE = (40.45, -3.73)
HOME_MSL_M = 650.0
HERTZ = 10.0


@contextmanager
def vehicle(*words: object) -> Iterator[None]:
    """One at work, or about to be: it takes a while to load what it needs."""
    process = subprocess.Popen([sys.executable, __file__, *map(str, words)])
    try:
        yield
    finally:
        process.terminate()
        process.wait(120)


@contextmanager
def sending_vehicle(port: int) -> Iterator[None]:
    """One that already sends to that port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hears:
        hears.bind(("127.0.0.1", port))
        hears.settimeout(120)
        with vehicle(f"udpout:127.0.0.1:{port}"):
            hears.recv(1000)
            hears.close()
            yield


def main() -> None:
    """Send until a signal comes."""
    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavutil  # type: ignore[import-untyped]

    parser = argparse.ArgumentParser()
    parser.add_argument("url")
    parser.add_argument("--system", type=int, action="append", default=[])
    parser.add_argument("--off-s", type=float, default=0.0, help="of its UTC, ahead of ours")
    parser.add_argument("--raw", action="store_true", help="GPS_RAW_INT alone")
    given = parser.parse_args()
    link = mavutil.mavlink_connection(given.url, source_system=1, source_component=1)
    began_s = time.monotonic() - 100.0
    while True:
        since_boot_s = time.monotonic() - began_s
        for system in given.system or [1]:
            link.mav.srcSystem = system
            _send(link.mav, system, since_boot_s, given.off_s, is_raw=given.raw)
        link.recv_msg()  # which is how a server of pymavlink lets others connect
        time.sleep(1 / HERTZ)


def _send(mav: object, system: int, since_boot_s: float, off_s: float, *, is_raw: bool) -> None:
    turn = 2 * math.pi * since_boot_s / 60
    north_m, east_m = 200 * math.cos(turn), 200 * math.sin(turn) + 100 * system
    latitude = round((CENTRE[0] + north_m / 111_200) * 1e7)
    longitude = round((CENTRE[1] + east_m / 84_900) * 1e7)
    boot_ms, msl_mm = round(since_boot_s * 1e3), round((HOME_MSL_M + 100) * 1e3)
    rate = 200 * 2 * math.pi / 60
    north_cm_s, east_cm_s = round(-rate * math.sin(turn) * 100), round(rate * math.cos(turn) * 100)
    mav.heartbeat_send(2, 12, 0, 0, 4)  # type: ignore[attr-defined]
    mav.system_time_send(round((time.time() + off_s) * 1e6), boot_ms)  # type: ignore[attr-defined]
    mav.attitude_send(boot_ms, 0.1, 0.2, 0.3, 0, 0, 0)  # type: ignore[attr-defined]
    course = round(math.degrees(math.atan2(east_cm_s, north_cm_s)) % 360 * 100)
    mav.gps_raw_int_send(  # type: ignore[attr-defined]
        *(boot_ms * 1000, 3, latitude, longitude, msl_mm, 80, 120, round(rate * 100), course, 14),
        *(msl_mm, 900, 1500, 300),
    )
    if not is_raw:
        mav.global_position_int_send(  # type: ignore[attr-defined]
            *(boot_ms, latitude, longitude, msl_mm, 100_000, north_cm_s, east_cm_s, 0, 0)
        )


if __name__ == "__main__":
    main()

"""Autopilots that send what pymavlink's own endpoint makes, in processes of their own."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from support.waiting import PATIENCE_S

PROGRAM = Path(__file__).parent / "mavlink_vehicle.py"


@contextmanager
def vehicle(*words: object) -> Iterator[None]:
    """One at work, or about to be: it takes a while to load what it needs."""
    process = subprocess.Popen([sys.executable, PROGRAM, *map(str, words)])
    try:
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


@contextmanager
def sending_vehicle(port: int) -> Iterator[None]:
    """One that already sends to that port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hears:
        hears.bind(("127.0.0.1", port))
        hears.settimeout(PATIENCE_S)
        with vehicle(f"udpout:127.0.0.1:{port}"):
            hears.recv(1000)
            hears.close()
            yield

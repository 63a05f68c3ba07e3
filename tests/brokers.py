"""Real brokers for tests, each on a free port of its own."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mqtt_client import PATIENCE_S


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


@contextmanager
def mosquitto(folder: Path, port: int) -> Iterator[None]:
    """Mosquitto on that port, for MQTT 3.1.1 and 5; skips the test where it is not installed."""
    search = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"])
    program = shutil.which("mosquitto", path=search)
    if program is None:
        pytest.skip("mosquitto is not installed")
    config = folder / f"mosquitto-{port}.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\n")
    broker = subprocess.Popen(
        [program, "-c", str(config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        wait_until_listening(port)
        yield
    finally:
        broker.terminate()
        broker.wait(PATIENCE_S)


def wait_until_listening(port: int) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not is_listening(port):
        assert time.monotonic() < deadline, f"nobody listens on port {port}"
        time.sleep(0.01)


def wait_until_silent(port: int) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while is_listening(port):
        assert time.monotonic() < deadline, f"somebody still listens on port {port}"
        time.sleep(0.01)


def is_listening(port: int, host: str = "127.0.0.1") -> bool:
    with contextlib.suppress(OSError), socket.create_connection((host, port), 5):
        return True
    return False


@contextmanager
def deaf_server() -> Iterator[int]:
    """The port of a server that takes connections and never says a word."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]

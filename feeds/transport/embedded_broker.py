"""The embedded MQTT broker: iotcore's, in child processes, on loopback alone.

MQTT 3.1.1 and MQTT 5 have a broker each, and a session publishes to both: in iotcore 0.4 a message
with MQTT 5 properties cuts off every 3.1.1 client that has subscribed to it.

Run as a module this *is* such a child: it serves until its standard input closes, which it does
when the parent ends, however it ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from plotfeed.proto.errors import PlotfeedError

LOOPBACK = "127.0.0.1"
START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 2.0
SETTLE_S = 0.1
"""By then a child whose port somebody else took has ended, although that port answers."""
MAX_MESSAGE_OCTETS = 1 << 20


class BrokerError(PlotfeedError):
    """The embedded broker did not start."""

    exit_code = 1


@dataclass(frozen=True, slots=True)
class Ports:
    """Where the broker listens: one port for each protocol that it speaks."""

    mqtt3: int
    mqtt5: int
    websocket: int

    def urls(self) -> dict[str, str]:
        """What to tell people, by protocol."""
        return {
            "MQTT 3.1.1": f"mqtt://{LOOPBACK}:{self.mqtt3}",
            "MQTT 5": f"mqtt://{LOOPBACK}:{self.mqtt5}",
            "WebSocket": f"ws://{LOOPBACK}:{self.websocket} (MQTT 3.1.1)",
        }


class EmbeddedBroker:
    """Start it, use its ports, stop it."""

    def __init__(self, ports: Ports) -> None:
        self.ports = ports
        self._folder = Path(tempfile.mkdtemp(prefix="plotfeed-broker-"))
        listeners = {
            "mqtt3": {"v4.1": ports.mqtt3, "ws.1": ports.websocket},
            "mqtt5": {"v5.1": ports.mqtt5},
        }
        self._children = [self._child(name, tables) for name, tables in listeners.items()]

    @classmethod
    async def start(cls, preferred_port: int = 1883) -> Self:
        """Listen on `preferred_port` and the two after it, or on free ones where they are taken.

        Raises `BrokerError` if it does not listen within ten seconds, twice.
        """
        async with _no_other_session_starts():
            try:
                return await cls._listening(free_ports(preferred_port))
            except BrokerError:  # somebody may have taken a port that was free a moment ago
                return await cls._listening(free_ports(preferred_port))

    @classmethod
    async def _listening(cls, ports: Ports) -> Self:
        broker = cls(ports)
        try:
            await broker._wait_until_it_listens()
        except BaseException:
            broker.stop()
            raise
        return broker

    def _child(self, name: str, listeners: dict[str, int]) -> subprocess.Popen[bytes]:
        config = self._folder / f"{name}.toml"
        config.write_text(_configuration(listeners))
        return subprocess.Popen(  # noqa: S603 - our own command
            [sys.executable, "-m", "plotfeed.feeds.transport.embedded_broker", str(config)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for us: the broker is still needed to say goodbye
        )

    async def _wait_until_it_listens(self) -> None:
        deadline = time.monotonic() + START_TIMEOUT_S
        waiting = [self.ports.mqtt3, self.ports.mqtt5, self.ports.websocket]
        while waiting:
            self._check_children(in_time=time.monotonic() <= deadline)
            with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, waiting[0]), 1):
                waiting.pop(0)
                continue
            await asyncio.sleep(0.01)
        await asyncio.sleep(SETTLE_S)
        self._check_children()

    def _check_children(self, *, in_time: bool = True) -> None:
        if not in_time or any(child.poll() is not None for child in self._children):
            raise BrokerError(
                f"the embedded broker did not start on port {self.ports.mqtt3}; "
                "give the address of a broker of your own with --broker mqtt://HOST:PORT"
            )

    def stop(self) -> None:
        """End the children and take away their files."""
        for child in self._children:
            child.terminate()
        for child in self._children:
            try:
                child.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
            if child.stdin is not None:
                child.stdin.close()
        shutil.rmtree(self._folder, ignore_errors=True)


@contextlib.asynccontextmanager
async def _no_other_session_starts() -> AsyncIterator[None]:
    """Hold off sessions of this machine that look for free ports in the same moment.

    Else one could take another's broker for its own, and lose it when that ends.
    """
    try:
        import fcntl

        path = Path(tempfile.gettempdir(), f"plotfeed-{os.getuid()}.lock")
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except (ImportError, AttributeError, OSError):  # another system, or somebody else's file
        yield
        return
    with os.fdopen(lock):
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            await asyncio.sleep(0.01)
        yield


def free_ports(preferred: int) -> Ports:
    """Three ports that nobody listens on: the preferred and the next two if they are free."""
    with contextlib.ExitStack() as held:
        found = []
        for wanted in (preferred, preferred + 1, preferred + 2):
            listener = held.enter_context(socket.socket())
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind((LOOPBACK, wanted))
            except (OSError, OverflowError):
                listener.bind((LOOPBACK, 0))
            found.append(listener.getsockname()[1])
    return Ports(*found)


def _configuration(listeners: dict[str, int]) -> str:
    """The broker's own settings: small segments, since its log keeps messages in memory."""
    router = f"""id = 0
[router]
id = 0
max_connections = 10000
max_outgoing_packet_count = 1000
max_segment_size = {MAX_MESSAGE_OCTETS}
max_segment_count = 10
"""
    return router + "".join(
        f"""
[{table}]
name = "{table}"
listen = "{LOOPBACK}:{port}"
next_connection_delay_ms = 1
[{table}.connections]
connection_timeout_ms = 60000
max_payload_size = {MAX_MESSAGE_OCTETS}
max_inflight_count = 500
dynamic_filters = true
"""
        for table, port in listeners.items()
    )


def _serve(config: str) -> None:
    from iotcore import Broker

    def end_with_parent() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()
    Broker(config_path=config).run_forever()


if __name__ == "__main__":
    _serve(sys.argv[1])

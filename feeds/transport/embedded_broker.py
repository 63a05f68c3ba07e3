"""The embedded MQTT broker: iotcore's, in child processes, on loopback alone.

MQTT 3.1.1 and MQTT 5 have a broker each, and a session publishes to both: in iotcore 0.4 a message
with MQTT 5 properties cuts off every 3.1.1 client that has subscribed to it. Where a scene names
web pages that may come, WebSocket has a process too, which knows them by their origins.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import socket
import subprocess  # nosec B404
import sys
import time
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, Self

from plotfeed.feeds.console.posix import listen_again, lock, lock_of_user
from plotfeed.feeds.scene.output_keys import EmbeddedBrokerKeys
from plotfeed.feeds.transport.broker_process import OUT_OF_MEMORY
from plotfeed.feeds.transport.local_hosts import LOOPBACK
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)

START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 2.0
# By then a child whose port somebody else took has ended, although that port answers.
SETTLE_S = 0.1
# So long a session that ended just now may still have the ports that a scene names.
PORT_PATIENCE_S = 3.0
LOOK_EVERY_S = 0.25  # From one look at the children to the next
AGAIN_AFTER_S = 0.5  # A child that has ended is made anew no sooner
SEGMENT_OCTETS = 1 << 20  # Of the broker's log, which keeps ten of them for each filter, in memory
ONE_OF_YOUR_OWN = "give the address of a broker of your own with --broker mqtt://HOST:PORT"


class BrokerError(PlotfeedError):
    """The embedded broker did not start."""

    exit_code = 1


@dataclass(frozen=True, slots=True)
class Ports:
    """Where the broker listens: one port for each protocol that it speaks."""

    mqtt3: int
    mqtt5: int
    websocket: int | None = None
    # The ports that were wanted and are taken, by those that stand in for them.
    instead_of: Mapping[int, int] = field(default_factory=dict)

    def by_protocol(self) -> dict[str, int]:
        """All ports."""
        ports = {"MQTT 3.1.1": self.mqtt3, "MQTT 5": self.mqtt5}
        return ports if self.websocket is None else {**ports, "WebSocket": self.websocket}

    def urls(self) -> dict[str, str]:
        """What to tell people, by protocol: an address, and what there is to say of it."""
        found = {}
        for protocol, port in self.by_protocol().items():
            more = ["MQTT 3.1.1"] if port == self.websocket else []
            more += [f"port {self.instead_of[port]} is taken"] if port in self.instead_of else []
            scheme = "ws" if port == self.websocket else "mqtt"
            found[protocol] = f"{scheme}://{LOOPBACK}:{port}"
            if more:
                found[protocol] += f" ({'; '.join(more)})"
        return found


class EmbeddedBroker:
    """Start it, use its ports, stop it."""

    def __init__(self, ports: Ports, settings: EmbeddedBrokerKeys) -> None:
        self.ports = ports
        self._orders: dict[str, dict[str, Any]] = {
            "MQTT 3.1.1": {"configuration": _configuration("v4.1", ports.mqtt3, settings)},
            "MQTT 5": {"configuration": _configuration("v5.1", ports.mqtt5, settings)},
        }
        if ports.websocket is not None:
            self._orders["WebSocket"] = {
                "port": ports.websocket,
                "broker_port": ports.mqtt3,
                "origins": settings.websocket_origins,
            }
        self._settings = settings
        self._children = {name: self._child(name) for name in self._orders}

    @classmethod
    async def start(
        cls,
        preferred_port: int = 1883,
        settings: EmbeddedBrokerKeys | None = None,
        *,
        may_be_others: bool = True,
    ) -> Self:
        """Listen on `preferred_port` and those after it; on free ones where they are taken.

        Raises `BrokerError` if they are taken and may not be others, or if it does not listen
        within ten seconds, twice, or is not installed.
        """
        if not find_spec("iotcore"):
            raise BrokerError(
                "the embedded broker is not installed (extra broker, which is not there for every "
                f"machine); {ONE_OF_YOUR_OWN}, or run without one: --broker none"
            )
        settings = settings or EmbeddedBrokerKeys()
        if settings.websocket_origins is not None and not find_spec("websockets"):
            key = "mqtt.embedded.websocket_origins"
            raise BrokerError(f"{key} needs more: pip install 'plotfeed[page]'")
        websocket = settings.websocket_origins is not None
        async with _no_other_session_starts():
            if not may_be_others:
                await _wait_for_ports(preferred_port, websocket)
            try:
                return await cls._listening(free_ports(preferred_port, websocket), settings)
            except BrokerError:  # somebody may have taken a port that was free a moment ago
                if not may_be_others:
                    raise
                return await cls._listening(free_ports(preferred_port, websocket), settings)

    @classmethod
    async def _listening(cls, ports: Ports, settings: EmbeddedBrokerKeys) -> Self:
        broker = cls(ports, settings)
        try:
            await broker._wait_until_it_listens()
        except BaseException:
            broker.stop()
            raise
        return broker

    def _child(self, name: str) -> subprocess.Popen[bytes]:
        orders = {**self._orders[name], "max_memory_mib": self._settings.max_memory_mib}
        return subprocess.Popen(  # noqa: S603 - our own command  # nosec B603
            [sys.executable, "-m", "plotfeed.feeds.transport.broker_process", json.dumps(orders)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for us: the broker is still needed to say goodbye
        )

    async def _wait_until_it_listens(self) -> None:
        deadline = time.monotonic() + START_TIMEOUT_S
        waiting = [*self.ports.by_protocol().values()]
        while waiting:
            self._check_children(in_time=time.monotonic() <= deadline)
            with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, waiting[0]), 1):
                waiting.pop(0)
                continue
            await asyncio.sleep(0.01)
        await asyncio.sleep(SETTLE_S)
        self._check_children()

    def _check_children(self, *, in_time: bool = True) -> None:
        ended = any(child.poll() is not None for child in self._children.values())
        if ended or not in_time:
            raise BrokerError(
                f"the embedded broker did not start on port {self.ports.mqtt3}; {ONE_OF_YOUR_OWN}"
            )

    async def keep_up(self) -> None:
        """Make a child anew that has ended, and say why it has, until cancelled."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            for name, child in self._children.items():
                if child.poll() is None:
                    continue
                why = f"exit code {child.returncode}"
                if child.returncode == OUT_OF_MEMORY:
                    most = self._settings.max_memory_mib
                    why = f"it took more than {most} MiB, mqtt.embedded.max_memory_mib"
                log.warning("the embedded broker of %s has ended (%s); it starts anew", name, why)
                await asyncio.sleep(AGAIN_AFTER_S)
                _close(child)
                self._children[name] = self._child(name)

    def stop(self) -> None:
        """End the children."""
        for child in self._children.values():
            child.terminate()
        for child in self._children.values():
            try:
                child.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
            _close(child)


def _close(child: subprocess.Popen[bytes]) -> None:
    if child.stdin is not None:
        child.stdin.close()


async def _wait_for_ports(first: int, websocket: bool) -> None:
    """Return when ports that a scene names are free; raises `BrokerError` if one stays taken."""
    deadline = time.monotonic() + PORT_PATIENCE_S
    while True:
        ports = free_ports(first, websocket)
        if not ports.instead_of:
            return
        if time.monotonic() > deadline:
            break
        await asyncio.sleep(0.05)
    instead = next(iter(ports.instead_of))
    protocol = next(name for name, port in ports.by_protocol().items() if port == instead)
    raise BrokerError(
        f"mqtt.port = {first}: port {ports.instead_of[instead]} of {LOOPBACK}, for {protocol}, is "
        "taken; name another, or leave the key out to have any that is free"
    )


@contextlib.asynccontextmanager
async def _no_other_session_starts() -> AsyncIterator[None]:
    """Hold off sessions of this machine that look for free ports in the same moment.

    Else one could take another's broker for its own, and lose it when that ends.
    """
    try:
        file = lock_of_user()
    except OSError:  # another system, or somebody else's file
        yield
        return
    with os.fdopen(file):
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError):
                lock(file)
                break
            await asyncio.sleep(0.01)
        yield


def free_ports(preferred: int, websocket: bool = False) -> Ports:
    """Ports that nobody listens on: the preferred and those after it, if they are free."""
    found: list[int] = []
    instead_of = {}
    with contextlib.ExitStack() as held:
        for wanted in range(preferred, preferred + 2 + websocket):
            listener = held.enter_context(socket.socket())
            listen_again(listener)
            try:
                listener.bind((LOOPBACK, wanted))
            except (OSError, OverflowError):
                listener.bind((LOOPBACK, 0))
                instead_of[listener.getsockname()[1]] = wanted
            found.append(listener.getsockname()[1])
    return Ports(found[0], found[1], found[2] if websocket else None, instead_of)


def _configuration(listener: str, port: int, settings: EmbeddedBrokerKeys) -> str:
    """The broker's own settings: small segments, since its log keeps messages in memory."""
    return f"""id = 0
[router]
id = 0
max_connections = {settings.max_connections}
max_outgoing_packet_count = 1000
max_segment_size = {SEGMENT_OCTETS}
max_segment_count = 10

[{listener}]
name = "{listener}"
listen = "{LOOPBACK}:{port}"
next_connection_delay_ms = 1
[{listener}.connections]
connection_timeout_ms = 10000
max_payload_size = {settings.max_payload_octets}
max_inflight_count = 500
dynamic_filters = true
"""

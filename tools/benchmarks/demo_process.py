"""A `plotfeed demo` of its own for a benchmark, and a subscriber to it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import sys
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.packets import Publication

logging.disable(logging.WARNING)  # the broker goes first, and is missed

COMMAND = Path(sys.executable).with_name("plotfeed")
OnMessage = Callable[[str, bytes, dict[str, Any]], None]


@dataclass(frozen=True, slots=True)
class Demo:
    """Where a running demo listens for MQTT 5, and when it was started."""

    host: str
    port: int
    started_ns: int
    process: asyncio.subprocess.Process


@contextlib.asynccontextmanager
async def demo(*options: str) -> AsyncIterator[Demo]:
    """Start it, wait until it says where it listens, and end it at the end."""
    started_ns = time.monotonic_ns()
    process = await asyncio.create_subprocess_exec(
        COMMAND, "demo", *options, stdout=asyncio.subprocess.PIPE
    )
    try:
        assert process.stdout
        async for line in process.stdout:
            if line.strip().startswith(b"MQTT"):
                host, _, port = line.decode().rpartition("//")[2].strip().partition(":")
                yield Demo(host, int(port), started_ns, process)
                break
    finally:
        if process.returncode is None:
            process.terminate()
        await process.communicate()


@contextlib.asynccontextmanager
async def subscriber(where: Demo, topics: list[str], heard: OnMessage) -> AsyncIterator[None]:
    """Hears those topics, with the MQTT 5 properties of each message."""

    def received(message: Publication) -> None:
        heard(message.topic, message.payload, {"user_property": message.properties.pairs})

    address = BrokerAddress(where.host, where.port, (5,))
    link = MqttTransport(address, "bench", subscribe=topics, on_received=received)
    async with link.connected(5.0):
        yield

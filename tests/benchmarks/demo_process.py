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

import gmqtt

logging.getLogger("gmqtt").setLevel(logging.CRITICAL + 1)  # the broker goes first, and is missed

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
            if line.strip().startswith(b"MQTT 5"):
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

    def on_message(_c: Any, topic: str, payload: bytes, _q: int, properties: dict[str, Any]) -> int:
        heard(topic, payload, properties)
        return 0

    client = gmqtt.Client("bench")
    client.set_config({"reconnect_retries": -2, "reconnect_delay": 0})  # never
    client.on_message = on_message
    await client.connect(where.host, where.port, version=5)
    for topic in topics:
        client.subscribe(topic)
    try:
        yield
    finally:
        with contextlib.suppress(Exception):
            await client.disconnect()

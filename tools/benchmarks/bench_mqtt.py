"""What it costs to publish by plotfeed, aiomqtt and paho-mqtt, to the embedded broker.

    python tools/benchmarks/bench_mqtt.py

The others run in `.venv-bench`, which is made where it is missing, each in a process of its own,
in turns. QoS 0, MQTT 3.1.1. A run ends when its last message has come back, which the broker sends
once it has taken all the others. CPU is that of the publishing process.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

from aims import python_with, ratios, spread

OURS = "plotfeed"
OTHERS = {"aiomqtt": "aiomqtt==2.5.1", "paho-mqtt": "paho-mqtt"}
CLIENTS = (OURS, *OTHERS)
COUNTS = {60: 20_000, 1400: 20_000, 30_000: 3000}
REPEATS = 3
HOST = "127.0.0.1"
END = "bench/end"


async def by_plotfeed(port: int, payload: bytes, count: int) -> None:
    """All messages, and the last one back."""
    from plotfeed.feeds.messages.message import Message
    from plotfeed.feeds.messages.transports import publish
    from plotfeed.feeds.scene.output_keys import MqttQueueKeys
    from plotfeed.feeds.transport.mqtt.address import BrokerAddress
    from plotfeed.feeds.transport.mqtt.client import MqttTransport

    class Sender:
        """Counts nothing."""

        now_ns = staticmethod(time.time_ns)

        def settled(self, outgoing: Message) -> None:
            """One has left."""

    sender, back = Sender(), asyncio.Event()
    link = MqttTransport(
        BrokerAddress(HOST, port, (4,)),
        "bench",
        subscribe=[END],
        on_message=lambda *_: back.set(),
        queue=MqttQueueKeys(policy="wait", messages=10_000),
    )
    async with link.connected(5.0):
        await asyncio.sleep(0.1)
        with Measured(payload, count):
            for _ in range(count):
                await link.room()
                message = Message("bench/load", payload, "", 0)
                publish([link], [message.again(sender, 1)])
                if link.waiting:
                    await asyncio.sleep(0)
            last = Message(END, b"", "", 0)
            publish([link], [last.again(sender, 1)])
            await back.wait()


async def by_aiomqtt(port: int, payload: bytes, count: int) -> None:
    """The same."""
    import aiomqtt

    async with aiomqtt.Client(HOST, port) as client:
        await client.subscribe(END)
        await asyncio.sleep(0.1)
        with Measured(payload, count):
            for _ in range(count):
                await client.publish("bench/load", payload)
            await client.publish(END, b"")
            await anext(aiter(client.messages))


async def by_paho(port: int, payload: bytes, count: int) -> None:
    """The same, with the thread that paho brings."""
    from paho.mqtt import client as paho

    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    ready, back = threading.Event(), threading.Event()
    client.on_subscribe = lambda *_: ready.set()
    client.on_message = lambda *_: back.set()
    client.on_connect = lambda *_: client.subscribe(END)
    client.connect(HOST, port)
    client.loop_start()
    ready.wait(5)
    with Measured(payload, count):
        for _ in range(count):
            client.publish("bench/load", payload)
        client.publish(END, b"")
        back.wait(60)
    client.loop_stop()


class Measured:
    """Prints the messages a second and the CPU of each, microseconds."""

    def __init__(self, payload: bytes, count: int) -> None:
        self._octets, self._count = len(payload), count

    def __enter__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def __exit__(self, *_: object) -> None:
        wall, cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu
        print(json.dumps([self._count / wall, cpu / self._count * 1e6]), flush=True)


def _versions(python: Path) -> str:
    listed = subprocess.run(
        [python, "-m", "pip", "list", "--format=json", "--disable-pip-version-check"],
        check=True,
        capture_output=True,
    ).stdout
    found = {row["name"]: row["version"] for row in json.loads(listed)}
    return ", ".join(f"{name} {found[name]}" for name in OTHERS)


async def main() -> None:
    """Measures and prints a table."""
    from plotfeed.feeds.transport.embedded_broker import EmbeddedBroker

    python = python_with(".venv-bench", *OTHERS.values())
    broker = await EmbeddedBroker.start(18831)
    found: dict[tuple[str, int], list[Any]] = defaultdict(list)
    try:
        for _ in range(REPEATS):
            for octets, count in COUNTS.items():
                for client in CLIENTS:
                    arguments = [client, broker.ports.mqtt, octets, count]
                    out = subprocess.run(  # noqa: ASYNC221 - nothing else runs in this loop
                        [
                            sys.executable if client == OURS else python,
                            __file__,
                            *map(str, arguments),
                        ],
                        check=True,
                        capture_output=True,
                    ).stdout
                    found[client, octets].append(json.loads(out.splitlines()[-1]))
    finally:
        await broker.stop()
    print(f"Median (least to most) of {REPEATS} repeats in turns. {_versions(python)}; "
          "the embedded broker.\n")  # fmt: skip
    print("| octets | client | messages/s | CPU µs a message | CPU × paho-mqtt |")
    print("|--:|---|--:|--:|--:|")
    for octets in COUNTS:
        for client in CLIENTS:
            rates, cpu_us = zip(*found[client, octets], strict=True)
            _, of_paho = zip(*found["paho-mqtt", octets], strict=True)
            cells = spread(rates, ",.0f"), spread(cpu_us, ".0f"), spread(ratios(cpu_us, of_paho))
            print(f"| {octets:,} | {client} | {' | '.join(cells)} |")


def _publish(client: str, port: str, octets: str, count: str) -> None:
    run = {OURS: by_plotfeed, "aiomqtt": by_aiomqtt, "paho-mqtt": by_paho}[client]
    asyncio.run(run(int(port), bytes(int(octets)), int(count)))


if __name__ == "__main__":
    _publish(*sys.argv[1:]) if sys.argv[1:] else asyncio.run(main())

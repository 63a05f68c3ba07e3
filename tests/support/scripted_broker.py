"""A broker that does what a test says and no more, in the test's own event loop."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, fields
from typing import Any

from support.certificates import Certificates
from support.deliveries import Deliveries, number_of
from support.servers import serving
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport.mqtt.address import BrokerAccess, BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport

CONNECT, PUBLISH, SUBSCRIBE, PINGREQ = 0x10, 0x30, 0x80, 0xC0
BUSY = 0x89  # A refusal that is not for ever


@dataclass
class ScriptedBroker:
    """MQTT 5, for one client."""

    properties: bytes = b""  # Of its CONNACK
    code: int = 0  # Of its CONNACK
    granted: int = 1  # To who subscribes
    reads: bool = True  # Whether it takes anything after it has said welcome
    acknowledges: bool = False  # Whether it does so by itself
    port: int = 0
    # Ids of QoS 1 messages of this connection, in the order in which they came.
    unacknowledged: list[int] = field(default_factory=list)
    received: int = 0  # Messages of any QoS
    # Their payloads, a list for each connection.
    heard: list[list[bytes]] = field(default_factory=list)
    _writer: asyncio.StreamWriter | None = None

    def acknowledge(self, n: int, reason: bytes = b"") -> None:
        for _ in range(n):
            self.send(0x40, self.unacknowledged.pop(0).to_bytes(2, "big") + reason)

    def send(self, kind: int, body: bytes) -> None:
        assert self._writer is not None
        assert len(body) < 128
        self._writer.write(bytes([kind, len(body)]) + body)

    def hang_up(self) -> None:
        assert self._writer is not None
        self._writer.transport.abort()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        try:
            while True:
                kind, body = await _packet(reader)
                self._answer(kind, body)
                if not self.reads:
                    writer.transport.pause_reading()  # type: ignore[attr-defined]
                    await asyncio.Event().wait()
        except (asyncio.IncompleteReadError, ConnectionError, ssl.SSLError):
            pass
        finally:
            writer.close()

    def _answer(self, kind: int, body: bytes) -> None:
        if kind & 0xF0 == CONNECT:
            self.unacknowledged.clear()
            self.heard.append([])
            self.send(0x20, bytes([0, self.code, len(self.properties)]) + self.properties)
        elif kind & 0xF0 == PINGREQ:  # else whoever waits for long would come anew, and go on
            self.send(0xD0, b"")
        elif kind & 0xF0 == SUBSCRIBE:
            self.send(0x90, body[:2] + bytes([0, self.granted]))
        elif kind & 0xF0 == PUBLISH:
            self.received += 1
            rest = body[2 + int.from_bytes(body[:2], "big") :]
            if kind & 0x06:
                self.unacknowledged.append(int.from_bytes(rest[:2], "big"))
                rest = rest[2:]
            assert rest[0] < 128
            self.heard[-1].append(rest[1 + rest[0] :])
            if self.acknowledges:
                self.acknowledge(len(self.unacknowledged))


async def _packet(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    kind = (await reader.readexactly(1))[0]
    length = shift = 0
    while True:
        octet = (await reader.readexactly(1))[0]
        length |= (octet & 0x7F) << shift
        shift += 7
        if not octet & 0x80:
            return kind, await reader.readexactly(length)


@asynccontextmanager
async def linked(
    broker: ScriptedBroker, *subscribe: str, tls: Certificates | None = None, **queue: object
) -> AsyncIterator[MqttTransport]:
    context, address = None, "mqtt"
    access = BrokerAccess(version="5")
    if tls is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tls.broker.certificate, tls.broker.key)
        address, access = "mqtts", BrokerAccess(ca_file=tls.ca, version="5")
    async with serving(broker.serve, broker.port, context) as broker.port:
        url = f"{address}://127.0.0.1:{broker.port}"
        link = MqttTransport(
            BrokerAddress.parse(url, access=access),
            "test",
            subscribe=subscribe,
            queue=MqttQueueKeys.model_validate(queue),
        )
        async with link.connected(PATIENCE_S):
            yield link


@asynccontextmanager
async def scripted(
    *subscribe: str, tls: Certificates | None = None, **more: Any
) -> AsyncIterator[tuple[MqttTransport, ScriptedBroker, Deliveries]]:
    """A link, its broker, and what is published; fields of the broker, the others of queues."""
    known = {field.name for field in fields(ScriptedBroker)} & more.keys()
    broker = ScriptedBroker(**{name: more.pop(name) for name in known})
    async with linked(broker, *subscribe, tls=tls, **more) as link:
        yield link, broker, Deliveries()


@asynccontextmanager
async def hearing(port: int, *filters: str) -> AsyncIterator[list[tuple[str, bytes]]]:
    """Topics and payloads that come meanwhile."""
    heard: list[tuple[str, bytes]] = []
    link = MqttTransport(
        BrokerAddress("127.0.0.1", port),
        "ears",
        subscribe=filters,
        on_message=lambda topic, payload, _type: heard.append((topic, payload)),
    )
    async with link.connected(PATIENCE_S):
        await asyncio.sleep(0.1)  # its subscriptions are on their way
        yield heard


async def end_connection(broker: ScriptedBroker, link: MqttTransport, *, code: int = 0) -> None:
    """The next ones are answered with that code."""
    broker.code = code
    broker.hang_up()
    await until(lambda: not link.is_up)


def numbers(payloads: list[bytes]) -> list[int]:
    return [number_of(payload) for payload in payloads]

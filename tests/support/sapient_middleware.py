"""A small SAPIENT middleware for tests, polite or not."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from support.deliveries import NOBODY
from support.sapient_rules import checked
from support.servers import serving
from support.waiting import PATIENCE_S

from plotfeed.feeds.formats.sapient.sapient_announcer import SapientAnnouncer
from plotfeed.feeds.formats.sapient.sapient_node import CONTENT_TYPE
from plotfeed.feeds.link.counters import SapientCounters, SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import SapientKeys
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.sapient import SapientIntake, SapientNews, SapientTcpTransport
from plotfeed.testing import radar, scene

SCENE = scene([radar(report=["sapient"])], seed=1)
ANNOUNCER = SapientAnnouncer(SCENE, SCENE.sensor[0])
Behaviour = Callable[["Peer"], Coroutine[Any, Any, None]]


@dataclass
class Peer:
    """One connection, from the middleware's side."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    heard: list[SapientMessage] = field(default_factory=list)

    async def next(self) -> SapientMessage:
        length = int.from_bytes(await self.reader.readexactly(4), "little")
        message = checked(await self.reader.readexactly(length))
        self.heard.append(message)
        return message

    async def hear_all(self) -> None:
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                await self.next()

    def kinds(self) -> list[str | None]:
        return [m.WhichOneof("content") for m in self.heard]

    def send(self, data: bytes) -> None:
        self.writer.write(len(data).to_bytes(4, "little") + data)

    def acknowledge(self, *reasons: str, accepted: bool = True) -> None:
        ack = SapientMessage(
            registration_ack={"acceptance": accepted, "ack_response_reason": reasons}
        )
        self.send(ack.SerializeToString())


async def polite(peer: Peer) -> None:
    await peer.next()
    peer.acknowledge()
    await peer.hear_all()


class Middleware:
    """Treats its n-th connection by the n-th behaviour, and the rest by the last."""

    def __init__(self, *behaviours: Behaviour) -> None:
        self.peers: list[Peer] = []
        self.address = ""
        self._behaviours = behaviours or (polite,)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = Peer(reader, writer)
        self.peers.append(peer)
        behave = self._behaviours[min(len(self.peers), len(self._behaviours)) - 1]
        try:
            await behave(peer)
        finally:
            writer.close()


@asynccontextmanager
async def listening(*behaviours: Behaviour) -> AsyncIterator[Middleware]:
    middleware = Middleware(*behaviours)
    async with serving(middleware.serve) as port:
        middleware.address = f"127.0.0.1:{port}"
        yield middleware


@asynccontextmanager
async def linked(
    address: str, *, wait: bool = True, **settings: Any
) -> AsyncIterator[SapientTcpTransport]:
    keys = SapientKeys(**settings)
    intake = SapientIntake(keys.max_messages_per_s, keys.max_octets_per_s)
    counters = SapientCounters(SessionCounters())
    link = SapientTcpTransport(
        "radar",
        address,
        keys,
        ANNOUNCER,
        clock=WallClock(),
        intake=intake,
        news=SapientNews(),
        counters=counters,
    )
    opening, _ = ANNOUNCER.opening(WallClock().now_ns())
    link.publish([opening.again(NOBODY, 1)])
    running = asyncio.create_task(link.run())
    try:
        if wait:
            await link.wait_until_up(PATIENCE_S)
        yield link
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def status_report(octets: int = 0) -> Message:
    (message,) = ANNOUNCER.regular(WallClock().now_ns())
    if octets:
        big = SapientMessage.FromString(message.payload)
        big.additional_information = "x" * octets
        return Message(
            topic=message.topic,
            payload=big.SerializeToString(),
            content_type=CONTENT_TYPE,
            due_utc_ns=message.due_utc_ns,
        )
    return message

"""The ways that messages of a recording may leave by."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Protocol

from plotfeed.feeds.broker_address import BrokerAddress
from plotfeed.feeds.message import Message
from plotfeed.feeds.mqtt import MqttLink
from plotfeed.feeds.mqtt_queue import MqttQueue
from plotfeed.feeds.parcel import Link
from plotfeed.feeds.replay_udp import RecordedUdp, ReplayUdp
from plotfeed.feeds.udp import UdpDestination

WAITING = 4096
"""Messages that may wait for a broker while whoever has no deadlines waits for room."""
CONNECT_S = 5.0


class WayOut(Link, Protocol):
    """A link, and what of a recording goes over it."""

    def carries(self, message: Message) -> bool:
        """Whether it is a message for this link."""


class ReplayMqtt(MqttLink):
    """A broker, which is given everything."""

    def __init__(self, address: BrokerAddress, *, waits: bool = False) -> None:
        """`waits` says that nothing is dropped as long as the broker is away or slow."""
        queue = MqttQueue(policy="wait", messages=WAITING) if waits else None
        super().__init__(address, "plotfeed-replay", queue=queue)

    def carries(self, message: Message) -> bool:
        """Any."""
        return bool(message.topic)


@dataclass(frozen=True, slots=True, kw_only=True)
class Destinations:
    """Where a replay goes."""

    brokers: tuple[BrokerAddress, ...] = ()
    udp: tuple[UdpDestination, ...] = ()
    recorded_udp: bool = False
    """Whether datagrams go where they once went."""
    ttl: int = 1
    """Of those that once went to a multicast group."""
    interface: str | None = None
    """By which those leave."""


@contextlib.asynccontextmanager
async def ways_out(to: Destinations, *, waits: bool) -> AsyncIterator[list[WayOut]]:
    """Sockets that are open and brokers that are there; raises `PlotfeedError`."""
    outs: list[WayOut] = []
    running: list[asyncio.Task[None]] = []
    with contextlib.ExitStack() as sockets:
        for settings in to.udp:
            link = ReplayUdp(settings, waits=waits)
            sockets.callback(link.close)
            link.open()
            outs.append(link)
        if to.recorded_udp:
            recorded = RecordedUdp(ttl=to.ttl, interface=to.interface, waits=waits)
            sockets.callback(recorded.close)
            outs.append(recorded)
        try:
            for broker in to.brokers:
                mqtt = ReplayMqtt(broker, waits=waits)
                running.append(asyncio.create_task(mqtt.run(), name="link[replay]"))
                await mqtt.wait_until_up(CONNECT_S)
                outs.append(mqtt)
            yield outs
        finally:
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)

"""A live source at work: octets in, reports of drones out, and what autopilots are asked."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from functools import partial
from typing import Any

from plotfeed.feeds.scene.telemetry_keys import KINDS, SourceAddress, TelemetrySource
from plotfeed.feeds.telemetry.live.aircraft import AircraftReports
from plotfeed.feeds.telemetry.live.heard import HeardReport, Listener
from plotfeed.feeds.telemetry.live.remote_id import NetworkRemoteIdReports, RemoteIdReports
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.transport.http import PolledOctets
from plotfeed.feeds.transport.octet_sources import (
    OctetSource,
    PipedOctets,
    SerialOctets,
    TcpOctets,
    UdpOctets,
)
from plotfeed.feeds.transport.peers import PeerTurns

log = logging.getLogger(__name__)

HEARTBEAT_S = 1.0
ASK_EVERY_S = 10.0

Take = Callable[[str, PositionReport], object]  # Told of the reports of a drone
# Told of what was not taken, and of which drone; "" if that is not known.
Refuse = Callable[[str, Refused], object]


class LiveSource:
    """A source of a scene or of a command: listens, understands, and hands on."""

    def __init__(
        self,
        settings: TelemetrySource,
        *,
        now_utc_ns: Callable[[], int],
        take: Take,
        refuse: Refuse,
    ) -> None:
        """Raises `PlotfeedError` where a library is missing."""
        self.address = settings.address
        self.name = str(self.address)
        self._settings = settings
        stated = {"rcs_m2": settings.rcs_m2, "target_class": settings.target_class}
        self._stated: dict[str, Any] = {k: v for k, v in stated.items() if v is not None}
        self._take, self._refuse = take, refuse
        self._turns = PeerTurns(
            listener_of(settings),
            say=self._hand_on,
            note=partial(log.warning, "%s: %s", self.name),
            now_utc_ns=now_utc_ns,
        )
        self._octets: OctetSource
        if settings.view is None:
            self._octets = octets_of(self.address, self._turns, settings.interface)
        else:
            view = ",".join(f"{degrees:.6f}" for degrees in settings.view)
            self._octets = PolledOctets(self.address, self._turns, view, settings.poll_s)

    @property
    def bound_port(self) -> int:
        """The port at which it listens, if it does."""
        return self._octets.bound_port

    async def open(self) -> None:
        """Listen from now on; raises `TransportError`."""
        await self._octets.open()

    async def run(self) -> None:
        """Keep listening; returns where what is read has an end."""
        asks = self.address.transport == "udpout" or self._settings.ask_hz is not None
        asking = None
        if self.address.kind == "mavlink" and asks:
            asking = asyncio.create_task(self._ask())
        try:
            await self._octets.run()
            await self._turns.emptied()
        finally:
            if asking is not None:
                asking.cancel()

    def close(self) -> None:
        """Take no more."""
        self._octets.close()
        self._turns.close()

    def _hand_on(self, heard: HeardReport) -> None:
        if isinstance(heard.said, Refused):
            self._refuse(heard.drone, heard.said)
        else:
            said = heard.said._replace(**self._stated)
            self._take(heard.drone, said)

    async def _ask(self) -> None:
        """Say every second that somebody listens, and from time to time what is wanted."""
        from plotfeed.feeds.telemetry.live.mavlink import heartbeat, requests

        every_us = None if self._settings.ask_hz is None else round(1e6 / self._settings.ask_hz)
        beats = 0
        while True:
            for peer in list(self._octets.correspondents):
                self._octets.send(peer, heartbeat())
                if every_us is not None and beats % math.ceil(ASK_EVERY_S / HEARTBEAT_S) == 1:
                    for request in requests(every_us):
                        self._octets.send(peer, request)
            beats += 1
            await asyncio.sleep(HEARTBEAT_S)


def listener_of(settings: TelemetrySource) -> Listener:
    """Whoever understands a source; raises `PlotfeedError` where a library is missing."""
    if settings.address.kind == "mavlink":
        from plotfeed.feeds.telemetry.live.mavlink import MavlinkReports

        return MavlinkReports(settings.template, settings.altitude)
    if KINDS[settings.address.kind].is_traffic:
        return AircraftReports(settings.address.kind, settings.template, settings.qnh_hpa)
    if settings.address.transport == "http":
        return NetworkRemoteIdReports(settings.template)
    return RemoteIdReports(settings.template)


def octets_of(
    address: SourceAddress, taker: PeerTurns, interface: str | None = None
) -> OctetSource:
    """The way in to a source's octets."""
    if address.transport in ("udpin", "udpout"):
        return UdpOctets(address, taker, interface)
    if address.transport in ("tcp", "tcpin"):
        return TcpOctets(address, taker)
    if address.transport == "serial":
        return SerialOctets(address, taker)
    return PipedOctets(address, taker)

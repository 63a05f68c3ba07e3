"""What a fleet says over MQTT, and is asked there; and telemetry, passed on by the drone's cell."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Mapping
from typing import Any

from plotfeed.feeds.delivery.counters import SessionCounters
from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.fleet.cells import cell_of
from plotfeed.feeds.fleet.coordinator import Coordinator
from plotfeed.feeds.fleet.fleet_parts import Gap
from plotfeed.feeds.fleet.fleet_status import told_in
from plotfeed.feeds.messages.message import Message, retained_message
from plotfeed.feeds.session.presence import SessionPresence
from plotfeed.feeds.session.session_part import CELL, ENDED, FLEET, RUNNING
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc

log = logging.getLogger(__name__)

EVERY_S = 2.0
FAREWELL_S = 1.0
MOST_WORKERS = 100_000
CONTROL = f"{FLEET}/control"
"""Topic behind the prefix."""


class FleetLink:
    """The coordinator's connection: retained health of the fleet, its control, and its relay."""

    def __init__(self, fleet: Coordinator, address: BrokerAddress) -> None:
        self.relayed = 0
        """Telemetry messages passed on."""
        self.fleet = fleet
        self.statuses: dict[str, dict[str, Any]] = {}
        """What workers said last of their parts, by part."""
        self._prefix = fleet.scene.mqtt.prefix
        self._clock = WallClock()
        self._totals = SessionCounters()
        self._presence = SessionPresence(fleet.scene, self._clock, self._totals, self._publish)
        self._scaling: asyncio.Task[None] | None = None
        self._cells = fleet.settings.cells
        topics = [f"{self._prefix}/{FLEET}/+", self._presence.topic]
        if self._cells is not None:
            topics.append(f"{self._prefix}/telemetry/+")
        self.link = MqttTransport(
            address, "plotfeed-fleet", subscribe=topics, on_message=self._hear
        )
        fleet.on_change = self.say

    async def run(self) -> None:
        """Say how the fleet does, every now and then, until cancelled; then that it has ended."""
        self._presence.begin(self.fleet.began_utc_ns or self._clock.now_ns())
        try:
            while True:
                self.say()
                await asyncio.sleep(EVERY_S)
        finally:
            if self._scaling is not None:
                self._scaling.cancel()
            self._presence.end()
            self.say(ENDED)
            await self.link.drain(FAREWELL_S)

    def say(self, state: str = RUNNING) -> None:
        """Publish what there is to know of the fleet."""
        payload = json.dumps(health(self.fleet, state)).encode()
        self._publish(retained_message(self._prefix, FLEET, payload, self._clock.now_ns()))

    def _publish(self, message: Message) -> None:
        self.link.publish(Delivery(message, self._clock, 1))

    def _hear(self, topic: str, payload: bytes, content_type: str | None) -> None:
        if topic == self._presence.topic:
            self._presence.hear(payload)
        elif topic == f"{self._prefix}/{CONTROL}":
            self._obey(payload)
        elif topic.startswith(f"{self._prefix}/{FLEET}/"):
            self._note(topic.rpartition("/")[2], payload)
        elif self._cells is not None:
            now_ns = self._clock.now_ns()
            cell = cell_of(payload, content_type, now_ns, self._cells)
            drone = topic.rpartition("/")[2]
            to = f"{self._prefix}/{CELL}/{cell}/{drone}"
            self.relayed += 1
            self._publish(Message(to, payload, content_type or "", now_ns))

    def _note(self, name: str, payload: bytes) -> None:
        """Keep what a worker says of one of the parts that there are."""
        names = {part.name for part in self.fleet.parts}
        with contextlib.suppress(PlotfeedError):
            if name in names:
                self.statuses[name] = told_in(payload, of_part=True)
        for gone in self.statuses.keys() - names:
            del self.statuses[gone]

    def _obey(self, payload: bytes) -> None:
        """Do what is asked of the fleet; what cannot be done is told in a line."""
        try:
            workers = asked_workers(payload)
            if self._scaling is not None and not self._scaling.done():
                raise PlotfeedError("sensors change hands already: ask again when they have")
        except PlotfeedError as error:
            log.warning("%s/%s: %s", self._prefix, CONTROL, error)
            return
        self._scaling = asyncio.create_task(self._scale(workers))

    async def _scale(self, workers: int) -> None:
        try:
            await self.fleet.scale(workers)
        except PlotfeedError as error:
            log.warning("%s/%s: %s", self._prefix, CONTROL, error)
        else:
            log.warning("the fleet has %d parts now", len(self.fleet.parts))


def asked_workers(payload: bytes) -> int:
    """How many workers a command asks for; raises `PlotfeedError` for anything else."""
    try:
        told = json.loads(payload)
    except (ValueError, RecursionError):
        told = None
    found = told.get("workers") if isinstance(told, Mapping) else None
    if not isinstance(found, int) or isinstance(found, bool) or not 1 <= found <= MOST_WORKERS:
        raise PlotfeedError(f'expected {{"workers": N}}, N from 1 to {MOST_WORKERS}')
    return found


def health(fleet: Coordinator, state: str = RUNNING) -> dict[str, Any]:
    """What there is to know of a fleet, as it is retained."""
    return {
        "fleet": fleet.id,
        "state": state,
        "scene": fleet.scene.scene.name,
        "began_utc": iso_utc(fleet.began_utc_ns),
        "began_utc_ns": fleet.began_utc_ns,
        "generation": fleet.generation,
        "takeovers": fleet.takeovers,
        "parts": [
            {
                "part": part.name,
                "worker": part.worker.name if part.worker is not None else "",
                "epoch": part.epoch,
                "sends": part.joined_utc_ns > 0,
                "sent_until_utc": iso_utc(part.sent_until_utc_ns),
                "sent_until_utc_ns": part.sent_until_utc_ns,
                "sensors": list(part.sensors),
            }
            for part in fleet.parts
        ],
        "gaps": [_told(gap) for gap in fleet.gaps],
    }


def _told(gap: Gap) -> dict[str, Any]:
    return {
        "part": gap.part,
        "sensors": list(gap.sensors),
        "why": gap.why,
        "from_utc_ns": gap.from_utc_ns,
        "to_utc_ns": gap.to_utc_ns,
    }

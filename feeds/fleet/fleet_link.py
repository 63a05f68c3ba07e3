"""What a fleet says of itself over MQTT."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any

from plotfeed.feeds.delivery.counters import SessionCounters
from plotfeed.feeds.delivery.outbox import Outbox
from plotfeed.feeds.fleet.coordinator import Coordinator
from plotfeed.feeds.fleet.fleet_parts import Gap
from plotfeed.feeds.fleet.fleet_status import told_in
from plotfeed.feeds.messages.message import Message, retained_message
from plotfeed.feeds.session.presence import SessionPresence
from plotfeed.feeds.session.session_part import ENDED, FLEET, RUNNING
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc

EVERY_S = 2.0
FAREWELL_S = 1.0


class FleetLink:
    """The coordinator's connection: retained health of the fleet."""

    def __init__(self, fleet: Coordinator, address: BrokerAddress) -> None:
        self.fleet = fleet
        self.statuses: dict[str, dict[str, Any]] = {}
        """What workers said last of their parts, by part."""
        self._prefix = fleet.scene.mqtt.prefix
        self._clock = WallClock()
        self._totals = SessionCounters()
        self._presence = SessionPresence(fleet.scene, self._clock, self._totals, self._publish)
        topics = [f"{self._prefix}/{FLEET}/+", self._presence.topic]
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
            self._presence.end()
            self.say(ENDED)
            await self.link.drain(FAREWELL_S)

    def say(self, state: str = RUNNING) -> None:
        """Publish what there is to know of the fleet."""
        payload = json.dumps(health(self.fleet, state)).encode()
        self._publish(retained_message(self._prefix, FLEET, payload, self._clock.now_ns()))

    def _publish(self, message: Message) -> None:
        Outbox(self._clock, [self.link]).send_past_link(message)

    def _hear(self, topic: str, payload: bytes, _content_type: str | None) -> None:
        if topic == self._presence.topic:
            self._presence.hear(payload)
        else:
            self._note(topic.rpartition("/")[2], payload)

    def _note(self, name: str, payload: bytes) -> None:
        """Keep what a worker says of one of the parts that there are."""
        names = {part.name for part in self.fleet.parts}
        with contextlib.suppress(PlotfeedError):
            if name in names:
                self.statuses[name] = told_in(payload, of_part=True)
        for gone in self.statuses.keys() - names:
            del self.statuses[gone]


def health(fleet: Coordinator, state: str = RUNNING) -> dict[str, Any]:
    """What there is to know of a fleet, as it is retained."""
    return {
        "fleet": fleet.id,
        "state": state,
        "scene": fleet.scene.scene.name,
        "began_utc": iso_utc(fleet.began_utc_ns),
        "began_utc_ns": fleet.began_utc_ns,
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

"""The ways that messages of a recording may leave by."""

from __future__ import annotations

from typing import Protocol

from plotfeed.feeds.broker_address import BrokerAddress
from plotfeed.feeds.message import Message
from plotfeed.feeds.mqtt import MqttLink
from plotfeed.feeds.mqtt_queue import MqttQueue
from plotfeed.feeds.parcel import Link

WAITING = 4096
"""Messages that may wait for a broker while whoever has no deadlines waits for room."""


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

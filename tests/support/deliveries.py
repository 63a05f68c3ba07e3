"""Numbered messages on their way, and what became of each of them."""

from __future__ import annotations

import time

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import Transport, publish

NUMBER_OCTETS = 4


class _Nobody:
    """A client that counts nothing."""

    def now_ns(self) -> int:
        return time.time_ns()

    def settled(self, message: Message) -> None:
        pass


NOBODY = _Nobody()


class FollowedDelivery(Message):
    """Remembers every word that is said of it."""

    def __init__(self, message: Message, number: int = 0) -> None:
        super().__init__(
            message.topic,
            message.payload,
            message.content_type,
            message.due_utc_ns,
            message.properties,
            message.retain,
            message.qos,
        )
        self.number, self.client, self.unsettled = number, NOBODY, 1
        self.said: list[bool] = []

    def settle(self, *, delivered: bool | None, to: str = "") -> None:
        self.said.append(delivered is not False)
        super().settle(delivered=delivered, to=to)

    @property
    def was_delivered(self) -> bool | None:
        """None if that is not known yet; never said twice."""
        assert len(self.said) <= 1
        return self.said[0] if self.said else None


class Deliveries:
    """Makes them, numbered from 0."""

    def __init__(self) -> None:
        self.made: list[FollowedDelivery] = []

    def make(
        self, *, qos: int = 1, octets: int = 10, topic: str = "t", retain: bool = False
    ) -> FollowedDelivery:
        number = len(self.made)
        message = Message(
            topic=topic,
            payload=number.to_bytes(NUMBER_OCTETS, "big").ljust(octets, b"\0"),
            content_type="x",
            due_utc_ns=0,
            qos=qos,
            retain=retain,
        )
        delivery = FollowedDelivery(message, number)
        self.made.append(delivery)
        return delivery

    def publish(self, link: Transport, count: int, **how: int | str | bool) -> None:
        for _ in range(count):
            publish([link], [self.make(**how)])  # type: ignore[arg-type]

    @property
    def delivered(self) -> list[int]:
        return [p.number for p in self.made if p.was_delivered]

    @property
    def given_up(self) -> list[int]:
        return [p.number for p in self.made if p.was_delivered is False]

    @property
    def unsettled(self) -> list[int]:
        return [p.number for p in self.made if p.was_delivered is None]


def number_of(payload: bytes) -> int:
    return int.from_bytes(payload[:NUMBER_OCTETS], "big")


def taken(link: Transport, message: Message) -> bool:
    """Whether a link that settles at once says that it has delivered a message."""
    delivery = FollowedDelivery(message)
    publish([link], [delivery])
    assert delivery.was_delivered is not None
    return delivery.was_delivered


def published(link: Transport, content_type: str, *payloads: bytes) -> list[FollowedDelivery]:
    """Messages that a link was given together."""
    made = [FollowedDelivery(Message("t", payload, content_type, 0)) for payload in payloads]
    publish([link], made)
    return made

"""What has been sent with QoS 1 over one connection, until the broker has answered."""

from __future__ import annotations

from collections.abc import Callable

from plotfeed.feeds.messages.outgoing import Outgoing
from plotfeed.feeds.transport.mqtt.send_queue import QueueCounts

MAX_UNACKNOWLEDGED = 1000
"""At once, where the broker does not say how many."""
MAX_UNACKNOWLEDGED_OCTETS = 32 << 20
"""Of payloads, besides the one that goes beyond it."""
FIRST_ID, LAST_ID = 1000, 65_535
"""Of messages; those below are for gmqtt, whose subscriptions have ids too."""


class Qos1Window:
    """Deliveries that are unacknowledged, by the ids of their packets.

    A broker may take no more than so many messages at once (Receive Maximum: mosquitto takes 20).
    """

    def __init__(self, counts: QueueCounts, on_room: Callable[[], None]) -> None:
        """`on_room` is called whenever one message less is on its way."""
        self.limit = MAX_UNACKNOWLEDGED
        self._outgoing: dict[int, Outgoing] = {}
        self._octets = 0
        self._last_id = FIRST_ID - 1
        self._counts = counts
        self._on_room = on_room

    @property
    def unacknowledged(self) -> int:
        """How many have not arrived as far as is known."""
        return len(self._outgoing)

    @property
    def has_room(self) -> bool:
        """Whether another message may be sent."""
        return len(self._outgoing) < self.limit and self._octets < MAX_UNACKNOWLEDGED_OCTETS

    def put(self, one: Outgoing) -> int:
        """Keep it, and give it an id."""
        number = self._last_id + 1 if self._last_id < LAST_ID else FIRST_ID
        while number in self._outgoing:
            number = number + 1 if number < LAST_ID else FIRST_ID
        self._last_id = number
        self._outgoing[number] = one
        self._octets += len(one.message.payload)
        return number

    def acknowledge(self, number: int) -> None:
        """The broker has taken it; an id that nobody has is passed over."""
        self._answered(number, delivered=True)

    def refuse(self, number: int) -> str:
        """The broker has answered that it does not take it; its topic, empty for an unknown id."""
        one = self._outgoing.get(number)
        self._counts.refused += self._answered(number, delivered=False)
        return "" if one is None else one.message.topic

    def take_all(self) -> list[Outgoing]:
        """All that is unacknowledged, in the order in which it was sent; it is kept no longer."""
        outgoing, self._outgoing = list(self._outgoing.values()), {}
        self._octets = 0
        return outgoing

    def _answered(self, number: int, *, delivered: bool) -> bool:
        one = self._outgoing.pop(number, None)
        if one is None:
            return False
        self._octets -= len(one.message.payload)
        one.settle(delivered=delivered, to=self._counts.destination)
        self._on_room()
        return True

"""Messages of QoS 1 that are on their way: sent on one connection, and not acknowledged yet."""

from __future__ import annotations

from collections.abc import Callable

from gmqtt.storage import PersistentStorage

from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.transport.mqtt.send_queue import QueueCounts

MAX_UNACKNOWLEDGED = 1000
"""At once, where the broker does not say how many; gmqtt alone would send 65,535."""
MAX_UNACKNOWLEDGED_OCTETS = 32 << 20
"""Of payloads, besides the one that goes beyond it."""


class Qos1Window(PersistentStorage):  # type: ignore[misc]
    """What gmqtt keeps of one connection until it is acknowledged: here, whose message it was.

    A broker may take no more than so many messages at once (Receive Maximum: mosquitto takes 20).
    """

    def __init__(self, counts: QueueCounts, on_room: Callable[[], None]) -> None:
        """`on_room` is called whenever one message less is on its way."""
        super().__init__()
        self.window = MAX_UNACKNOWLEDGED
        self.sending: Delivery | None = None
        """What gmqtt is told to publish now; it answers with the id that it gave it."""
        self._octets = 0
        self._counts = counts
        self._on_room = on_room

    @property
    def unacknowledged(self) -> int:
        """How many have not arrived as far as is known."""
        return len(self._messages)

    @property
    def has_room(self) -> bool:
        """Whether another message may be sent."""
        return len(self._messages) < self.window and self._octets < MAX_UNACKNOWLEDGED_OCTETS

    def push_message(self, mid: int, raw_package: bytes) -> None:  # noqa: ARG002 - gmqtt's
        """It is sent, under this id."""
        if self.sending is not None:
            super().push_message(mid, self.sending)
            self._octets += len(self.sending.message.payload)

    def remove_message_by_mid(self, mid: int) -> None:
        """The broker has acknowledged it."""
        self._answered(mid, delivered=True)

    def refuse(self, mid: int) -> None:
        """The broker has answered that it does not take it."""
        self._counts.refused += self._answered(mid, delivered=False)

    def get_all(self) -> list[tuple[int, bytes]]:
        """Nothing that gmqtt should send again: that is the link's to do."""
        return []

    def take_all(self) -> list[Delivery]:
        """All that is unacknowledged, in the order in which it was sent; it is kept no longer."""
        deliveries: list[Delivery] = list(self._messages.values())
        self._octets = 0
        self.clear()
        return deliveries

    def _answered(self, mid: int, *, delivered: bool) -> bool:
        delivery: Delivery | None = self._messages.get(mid)
        if delivery is None:
            return False
        super().remove_message_by_mid(mid)
        self._octets -= len(delivery.message.payload)
        delivery.settle(delivered=delivered)
        self._on_room()
        return True

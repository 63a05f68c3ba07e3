"""What waits to leave by an MQTT link, in its order: bounded, counted, and dropped by a policy."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.scene.output_keys import MqttQueueKeys

MAX_WAITING_OCTETS = 32 << 20
"""Of payloads; more do not wait, however few messages they are."""
OVERRUN = 10_000
"""What is taken beyond the limit from whoever publishes although he should wait."""


@dataclass(slots=True)
class QueueCounts:
    """What a link has done with messages other than deliver them."""

    dropped: int = 0
    """Given up unsent: by the policy, too old, too large for the broker, or still in the socket's
    buffer when a connection was lost."""
    superseded: int = 0
    """Retained messages that gave way to a newer one on their topic, which is all that counts."""
    repeated: int = 0
    """Sent again, since a lost connection had left them unacknowledged."""
    refused: int = 0
    """Of QoS 1, which the broker has answered with a refusal."""


@dataclass(slots=True, eq=False)
class QueuedDelivery:
    """A parcel that waits, or that is sent and not acknowledged."""

    parcel: Delivery
    since_s: float
    """When it first had to wait or was first sent."""
    sent: bool = False


class SendQueue:
    """The messages of one QoS that wait for one link."""

    def __init__(
        self,
        settings: MqttQueueKeys,
        qos: int,
        counts: QueueCounts,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._policy = settings.policy
        self._limit = settings.limit(qos)
        self._max_age_s = settings.max_age_s
        waits = settings.policy == "wait"
        self._most = self._limit + (OVERRUN if waits else 0)
        self._most_octets = MAX_WAITING_OCTETS * (2 if waits else 1)
        self._counts = counts
        self._now_s = now_s
        self._entries: OrderedDict[str | QueuedDelivery, QueuedDelivery] = OrderedDict()
        self._octets = 0

    def __len__(self) -> int:
        """How many wait."""
        return len(self._entries)

    @property
    def octets(self) -> int:
        """Of the payloads that wait."""
        return self._octets

    @property
    def is_full(self) -> bool:
        """Whether, by the policy, others shall wait now instead of publishing."""
        if self._policy != "wait" or not self._entries:
            return False
        return len(self._entries) >= self._limit or self._octets >= MAX_WAITING_OCTETS

    def put(self, parcel: Delivery) -> None:
        """Let it wait, or drop what the policy drops: dropped is settled as not delivered."""
        self.expire()
        entry = QueuedDelivery(parcel, self._now_s())
        key = _key(entry)
        dropped = []
        superseded = self._remove(key) if key in self._entries else None
        if self._policy == "drop-oldest":
            while self._entries and self._lacks_room_for(parcel):
                dropped.append(self._remove(next(iter(self._entries))))
        if self._lacks_room_for(parcel):
            dropped.append(entry)
        else:
            self._entries[key] = entry
            self._octets += len(parcel.message.payload)
        if superseded is not None:
            self._supersede(superseded)
        for given_up in dropped:
            self._drop(given_up)

    def take(self) -> QueuedDelivery | None:
        """The one whose turn it is, if any is left."""
        self.expire()
        return self._remove(next(iter(self._entries))) if self._entries else None

    def put_back(self, entries: Sequence[QueuedDelivery]) -> None:
        """Let these go before all others, in their order; they may be more than the limit."""
        for entry in reversed(entries):
            key = _key(entry)
            if key in self._entries:
                self._supersede(entry)
                continue
            self._entries[key] = entry
            self._entries.move_to_end(key, last=False)
            self._octets += len(entry.parcel.message.payload)

    def expire(self) -> None:
        """Drop what has waited too long."""
        if self._max_age_s is None:
            return
        before_s = self._now_s() - self._max_age_s
        while self._entries:
            key, entry = next(iter(self._entries.items()))
            if entry.since_s >= before_s:
                return
            self._drop(self._remove(key))

    def give_up(self) -> None:
        """Settle all that waits as not delivered."""
        while self._entries:
            self._drop(self._remove(next(iter(self._entries))))

    def _lacks_room_for(self, parcel: Delivery) -> bool:
        """One message has room however large it is, if any has."""
        if len(self._entries) >= self._most:
            return True
        octets = self._octets + len(parcel.message.payload)
        return octets > self._most_octets and bool(self._entries)

    def _remove(self, key: str | QueuedDelivery) -> QueuedDelivery:
        entry = self._entries.pop(key)
        self._octets -= len(entry.parcel.message.payload)
        return entry

    def _drop(self, entry: QueuedDelivery) -> None:
        self._counts.dropped += 1
        entry.parcel.settle(delivered=False)

    def _supersede(self, entry: QueuedDelivery) -> None:
        self._counts.superseded += 1
        entry.parcel.settle(delivered=False)


def _key(entry: QueuedDelivery) -> str | QueuedDelivery:
    """By which there is one on a topic at most, if it is retained; else by itself."""
    message = entry.parcel.message
    return message.topic if message.retain else entry

"""What waits to leave by an MQTT link, in its order: bounded, counted, and dropped by a policy."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.messages.bounded_queue import BoundedQueue, QueueStatistics
from plotfeed.feeds.scene.output_keys import MqttQueueKeys

MAX_WAITING_OCTETS = 32 << 20
"""Of payloads; more do not wait, however few messages they are."""
OVERRUN = 10_000
"""What is taken beyond the limit from whoever publishes although he should wait."""


@dataclass(slots=True)
class QueueCounts:
    """What a link has done with messages other than deliver them."""

    dropped: int = 0
    """Given up before they left: by the policy, too old, too large for the broker, or still in the
    socket's buffer when a connection was lost."""
    superseded: int = 0
    """Retained messages that gave way to a newer one on their topic, which is all that counts."""
    repeated: int = 0
    """Sent again, since a lost connection had left them unacknowledged."""
    refused: int = 0
    """Of QoS 1, which the broker has answered with a refusal."""


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
        self._counts = counts
        self._now_s = now_s
        waits = settings.policy == "wait"
        self._queue: BoundedQueue[tuple[Delivery, bool]] = BoundedQueue(
            self._limit + (OVERRUN if waits else 0),
            limit_octets=MAX_WAITING_OCTETS * (2 if waits else 1),
            octets_of=lambda waiting: len(waiting[0].message.payload),
            any_size_alone=True,
        )
        """Deliveries, and whether they were sent before; retained ones by their topic."""

    def __len__(self) -> int:
        """How many wait."""
        return len(self._queue)

    def statistics(self) -> QueueStatistics:
        """What has waited so far, and what does now."""
        return self._queue.statistics()

    @property
    def is_full(self) -> bool:
        """Whether, by the policy, others shall wait now instead of publishing."""
        if self._policy != "wait" or not self._queue:
            return False
        return len(self._queue) >= self._limit or self._queue.octets >= MAX_WAITING_OCTETS

    def put(self, delivery: Delivery) -> None:
        """Let it wait, or drop what the policy drops: dropped is settled as not delivered."""
        self.expire()
        delivery.since_s = self._now_s()
        message = delivery.message
        topic = message.topic if message.retain else None
        dropped = []
        superseded = self._queue.drop(topic)[0] if topic in self._queue else None
        if self._policy == "drop-oldest":
            while self._queue and not self._queue.has_room(len(message.payload)):
                dropped.append(self._queue.drop()[0])
        if not self._queue.put((delivery, False), topic):
            dropped.append(delivery)
        if superseded is not None:
            self._supersede(superseded)
        for given_up in dropped:
            self._drop(given_up)

    def take(self) -> tuple[Delivery, bool] | None:
        """The one whose turn it is, if any is left, and whether it was sent before."""
        self.expire()
        return self._queue.take() if self._queue else None

    def put_back(self, deliveries: Sequence[Delivery]) -> None:
        """Let these, which were sent, go before all others, in their order.

        They may be more than the limit.
        """
        for delivery in reversed(deliveries):
            message = delivery.message
            topic = message.topic if message.retain else None
            if topic in self._queue:
                self._supersede(delivery)
            else:
                self._queue.put_back((delivery, True), topic)

    def expire(self) -> None:
        """Drop what has waited too long."""
        if self._max_age_s is None:
            return
        before_s = self._now_s() - self._max_age_s
        while self._queue and self._queue.first()[0].since_s < before_s:
            self._drop(self._queue.drop()[0])

    def give_up(self) -> None:
        """Settle all that waits as not delivered."""
        while self._queue:
            self._drop(self._queue.drop()[0])

    def _drop(self, delivery: Delivery) -> None:
        self._counts.dropped += 1
        delivery.settle(delivered=False)

    def _supersede(self, delivery: Delivery) -> None:
        self._counts.superseded += 1
        delivery.settle(delivered=False)

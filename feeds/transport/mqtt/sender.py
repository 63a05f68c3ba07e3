"""What is published over MQTT: sent by the connection that there is, or kept until there is one."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport.mqtt.connection import MqttConnection
from plotfeed.feeds.transport.mqtt.send_queue import QueueCounts, SendQueue

SLICE = 100
"""Messages that are sent before others have their turn in the loop."""


class MqttSender:
    """What cannot leave at once waits, or is dropped, as the settings of the queue have it.

    Messages of one QoS keep their order.
    """

    def __init__(self, queue: MqttQueueKeys | None = None) -> None:
        self.counts = QueueCounts()
        self._queues = [SendQueue(queue or MqttQueueKeys(), qos, self.counts) for qos in (0, 1)]
        self._connection: MqttConnection | None = None
        self._sending: asyncio.Handle | None = None
        self._room = asyncio.Event()
        self._ended = False

    @property
    def waiting(self) -> int:
        """Messages that wait for a connection, or for room on it."""
        return sum(map(len, self._queues))

    @property
    def unacknowledged(self) -> int:
        """Messages of QoS 1 that have been sent, and of which it is not known that they arrived."""
        return 0 if self._connection is None else self._connection.unacknowledged

    @property
    def dropped(self) -> int:
        """Messages that were given up unsent."""
        return self.counts.dropped

    @property
    def repeated(self) -> int:
        """Messages that were sent again, since a lost connection had left them unacknowledged."""
        return self.counts.repeated

    @property
    def is_full(self) -> bool:
        """Whether whoever publishes should wait for `room` first; only by the policy "wait"."""
        return any(queue.is_full for queue in self._queues)

    async def room(self) -> None:
        """Return when it is not full, or its end has come."""
        while self.is_full:
            self._room.clear()
            await self._room.wait()

    def publish(self, *deliveries: Delivery) -> None:
        """Send each, let it wait, or drop it; it is settled as soon as its fate is known.

        Delivered is what the socket has taken, with QoS 0, and what the broker has acknowledged,
        with QoS 1.
        """
        connection = self._connection
        if (
            not self._ended
            and connection is not None
            and not self._queues[0]
            and connection.has_room(0)
            and all(d.message.qos == 0 and connection.takes(d.message) for d in deliveries)
        ):
            connection.send(*deliveries)
        else:
            for delivery in deliveries:
                self._publish(delivery)

    def _publish(self, delivery: Delivery) -> None:
        qos = delivery.message.qos
        queue, connection = self._queues[qos], self._connection
        if self._ended:
            delivery.settle(delivered=False)
        elif connection is None or queue or not connection.has_room(qos):
            queue.put(delivery)
        else:
            if qos:
                delivery.since_s = time.monotonic()
            self._send(connection, delivery)

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be published soon."""
        if self._connection is not None:
            self._connection.prepare(messages)

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until nothing waits and sockets have taken everything, or the time is up.

        What was published with QoS 1 has been acknowledged then.
        """
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + timeout_s
        while not self._is_idle():
            if loop.time() > deadline_s:
                return
            await asyncio.sleep(0.001)

    def expire(self) -> None:
        """Drop what has waited too long; to be called now and then."""
        for queue in self._queues:
            queue.expire()
        self._tell_of_room()

    def send_by(self, connection: MqttConnection | None) -> None:
        """From now on, by this one, or by none; what another had not delivered waits for it."""
        lost, self._connection = self._connection, connection
        if lost is not None:
            self._queues[1].put_back(lost.give_up())
        self._has_room_again()

    def end(self) -> MqttConnection | None:
        """Settle all that has not arrived, as not delivered; the connection that there was."""
        self._ended = True
        connection = self._connection
        self.send_by(None)
        for queue in self._queues:
            queue.give_up()
        self._room.set()
        return connection

    def _is_idle(self) -> bool:
        return not self.waiting and (self._connection is None or self._connection.is_idle())

    def _has_room_again(self) -> None:
        """Go on sending, as soon as it is this link's turn in the loop."""
        if self._sending is None and self.waiting:
            self._sending = asyncio.get_running_loop().call_soon(self._send_waiting)

    def _send_waiting(self) -> None:
        """Send what waits, in its order and a slice at a time, as far as there is room."""
        self._sending = None
        more = False
        for qos, queue in enumerate(self._queues):
            for _ in range(SLICE):
                if self._connection is None or not self._connection.has_room(qos):
                    break
                found = queue.take()
                if found is None:
                    break
                self._send(self._connection, *found)
            else:
                more = True
        if more:
            self._has_room_again()
        self._tell_of_room()

    def _send(
        self, connection: MqttConnection, delivery: Delivery, sent_before: bool = False
    ) -> None:
        if not connection.takes(delivery.message):
            self.counts.dropped += 1
            delivery.settle(delivered=False)
        elif delivery.message.qos:
            self.counts.repeated += sent_before
            connection.send_until_acknowledged(delivery)
        else:
            connection.send(delivery)

    def _tell_of_room(self) -> None:
        if not self.is_full:
            self._room.set()

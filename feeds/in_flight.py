"""Messages of QoS 1 on their way: what a broker has not acknowledged, and what waits for room."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from gmqtt.storage import PersistentStorage

from plotfeed.feeds.message import Message

MAX_UNACKNOWLEDGED = 1000
"""At once, where the broker does not say how many; gmqtt alone would send 65,535."""
MAX_WAITING = 10_000
"""Messages that wait for a broker to acknowledge others; more are not taken."""


class InFlight(PersistentStorage):  # type: ignore[misc]
    """What gmqtt keeps of one connection until it is acknowledged.

    A broker may take no more than so many messages at once (Receive Maximum: mosquitto takes 20),
    and gmqtt refuses the others. Here they wait for their turn, in their order.
    """

    def __init__(self, send: Callable[[Message], None]) -> None:
        super().__init__()
        self.window = MAX_UNACKNOWLEDGED
        self._send = send
        self._waiting: deque[Message] = deque()

    @property
    def unacknowledged(self) -> int:
        """How many have not arrived as far as is known, those that wait among them."""
        return len(self._messages) + len(self._waiting)

    def send(self, message: Message) -> bool:
        """Send it, or let it wait; False if there is no room to wait."""
        if len(self._waiting) >= MAX_WAITING:
            return False
        self._waiting.append(message)
        self._send_waiting()
        return True

    def remove_message_by_mid(self, mid: int) -> None:
        """The broker has acknowledged it."""
        super().remove_message_by_mid(mid)
        self._send_waiting()

    def _send_waiting(self) -> None:
        while self._waiting and len(self._messages) < self.window:
            try:
                self._send(self._waiting[0])
            except OverflowError:
                return
            self._waiting.popleft()

"""What a connection's socket has not taken yet, and whose messages that are."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from plotfeed.feeds.delivery.delivery import Delivery

MAX_UNSENT_OCTETS = 8 << 20
"""What may wait in a socket for a broker that has stalled; more is not taken."""
MAX_UNSENT_MESSAGES = 4096
"""The same in messages of QoS 0: asyncio looks at each of them whenever it takes another."""
GIVE_UP_S = 20.0
"""A socket that has taken nothing for so long has nobody at its other end."""


class SocketBuffer:
    """Watches the buffer of one transport; a message of QoS 0 is delivered when it has left that.

    Octets that are written unseen, such as pings, or that TLS adds, can only make it seem later.
    """

    def __init__(
        self,
        transport: Any,
        on_room: Callable[[], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """`on_room` is called whenever the socket has taken everything after it had not.

        Of a transport of asyncio, whose protocol shall tell `hold` and `release`.
        """
        self.moved_s = now_s()
        """When it last took something that had to wait."""
        self._transport = transport
        self._on_room = on_room
        self._now_s = now_s
        self._deliveries: deque[tuple[int, Delivery]] = deque()
        self._holds = False
        self._octets = 0
        """In the buffer, at the last look."""
        self._given = 0
        """Octets since it began to hold any."""
        self._only_began = False

    @property
    def octets(self) -> int:
        """Octets that it has not taken."""
        return int(self._transport.get_write_buffer_size())

    @property
    def messages(self) -> int:
        """Messages of QoS 0 that it has not taken."""
        return len(self._deliveries)

    @property
    def has_room(self) -> bool:
        """Whether it may be given more."""
        if not self._holds:
            return not self._transport.is_closing()
        self._look()
        return (
            self._octets <= MAX_UNSENT_OCTETS
            and len(self._deliveries) < MAX_UNSENT_MESSAGES
            and not self._transport.is_closing()
        )

    def given(self, octets: int) -> bool:
        """Note that at least so many were written, when there was room; whether all have left."""
        if not self._holds:
            return True
        before, self._octets = self._octets, self.octets
        if self._only_began:
            self._only_began = False
        else:
            self._given += max(self._octets - before, octets)
        self._settle_taken()
        return False

    def keep(self, delivery: Delivery) -> None:
        """The one that was given last, and has not left."""
        self._deliveries.append((self._given, delivery))

    def give_up(self) -> int:
        """The connection is lost: settle what was not taken; how many messages that were."""
        lost = len(self._deliveries)
        while self._deliveries:
            self._deliveries.popleft()[1].settle(delivered=False)
        return lost

    def is_stuck(self) -> bool:
        """Whether it has taken nothing for long, though it should."""
        if not self._holds and not self._transport.is_closing():
            return False
        self._look()
        self._settle_taken()
        return self._now_s() - self.moved_s > GIVE_UP_S

    def _look(self) -> None:
        octets = self.octets
        if octets < self._octets:
            self.moved_s = self._now_s()
        self._octets = octets

    def _settle_taken(self) -> None:
        taken = self._given - self._octets
        while self._deliveries and self._deliveries[0][0] <= taken:
            self._deliveries.popleft()[1].settle(delivered=True)

    def hold(self) -> None:
        """The socket has not taken everything."""
        self._holds = self._only_began = True
        self._octets = self._given = self.octets
        self.moved_s = self._now_s()

    def release(self) -> None:
        """The socket has taken everything."""
        self._holds = False
        self._octets = 0
        self.moved_s = self._now_s()
        for _ in range(len(self._deliveries)):
            self._deliveries.popleft()[1].settle(delivered=True)
        self._on_room()

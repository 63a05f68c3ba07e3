"""Messages that have come in and wait for the session to have time for them.

Whatever floods in, sectors leave when they are due: what came is taken between them. The time at
which it is taken is the one that counts, and that a recording keeps: put in again at that time, it
comes between the same two actions.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

MAX_WAITING = 20_000
"""Telemetry of a second from a few thousand drones; more is refused."""

Take = Callable[[str, bytes, str | None, int], None]
"""Called with topic, payload, content type, and the time at which it is taken."""


class Inbox:
    """A bounded queue in front of whoever takes messages."""

    def __init__(self, take: Take, most: int = MAX_WAITING) -> None:
        self.overflowed = 0
        """Messages that found no room."""
        self._take = take
        self._waiting: deque[tuple[str, bytes, str | None]] = deque()
        self._most = most

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, topic: str, payload: bytes, content_type: str | None) -> bool:
        """Let it wait; False if there is no room."""
        if len(self._waiting) >= self._most:
            self.overflowed += 1
            return False
        self._waiting.append((topic, payload, content_type))
        return True

    def take(self, most: int, t_utc_ns: int) -> int:
        """Take that many at most, as of that time; how many there were."""
        taken = min(most, len(self._waiting))
        for _ in range(taken):
            self._take(*self._waiting.popleft(), t_utc_ns)
        return taken

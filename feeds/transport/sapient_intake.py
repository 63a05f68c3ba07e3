"""How much all connections to a SAPIENT middleware may say to a session: a little at a time.

What is beyond it is not read, so that TCP lets the middleware wait, and no deadline does.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Protocol

SERVE_EVERY_S = 0.02  # While anything waits, some of it is taken in so often
AT_ONCE_S = 0.05  # After a silence, what may be said in this time is taken in at once


class Speaker(Protocol):
    """A connection over which messages have come that are not taken in yet."""

    def hear_one(self) -> int:
        """Take in one of them, and say how many octets it had."""

    @property
    def has_more(self) -> bool:
        """Whether another one is there."""


class SapientIntake:
    """Lets connections speak in turn, a message each, as often as messages and octets may come."""

    def __init__(self, max_messages_per_s: float, max_octets_per_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._max_messages_per_s, self._max_octets_per_s = max_messages_per_s, max_octets_per_s
        # That may be taken in now; octets are owed after a long message.
        self._messages, self._octets = 0.0, 0.0
        self._filled_s = self._loop.time() - AT_ONCE_S
        self._waiting: deque[Speaker] = deque()
        self._timer: asyncio.TimerHandle | None = None

    def serve(self, speaker: Speaker) -> None:
        """Let that one speak when it is its turn, which may be now; it has something to say."""
        self._waiting.append(speaker)
        if self._timer is None:
            self._serve()

    def forget(self, speaker: Speaker) -> None:
        """Take in no more of what that one has said."""
        self._waiting = deque(other for other in self._waiting if other is not speaker)

    def _serve(self) -> None:
        self._timer = None
        self._fill()
        while self._waiting and self._messages >= 1 and self._octets > 0:
            speaker = self._waiting.popleft()
            self._messages -= 1
            self._octets -= speaker.hear_one()
            if speaker.has_more:
                self._waiting.append(speaker)
        if self._waiting:
            self._timer = self._loop.call_later(SERVE_EVERY_S, self._serve)

    def _fill(self) -> None:
        now_s = self._loop.time()
        for_s, self._filled_s = now_s - self._filled_s, now_s
        least = 1.0  # of however few a second, one at a time must be possible
        self._messages = min(
            self._messages + for_s * self._max_messages_per_s,
            max(AT_ONCE_S * self._max_messages_per_s, least),
        )
        self._octets = min(
            self._octets + for_s * self._max_octets_per_s, AT_ONCE_S * self._max_octets_per_s
        )

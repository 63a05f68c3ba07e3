"""The viewers of a page: a bounded queue each, so that a slow one holds up nobody."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from plotfeed.feeds.page.view import Update

MAX_QUEUED = 20
"""Updates; when there are more, the oldest are dropped, and a snapshot makes up for them."""
MAX_QUEUED_OCTETS = 8 << 20


class Viewer:
    """What waits to be sent to one browser, and what it looks at."""

    def __init__(self, snapshot: Callable[[], Update]) -> None:
        self.sees_truth = False
        self.watched: tuple[str, ...] = ()
        self.dropped = 0
        """Updates that it was too slow for."""
        self._snapshot = snapshot
        self._needs_all = True
        self._queue: deque[bytes] = deque()
        self._octets = 0
        self._filled = asyncio.Event()
        self._filled.set()

    def offer(self, update: Update) -> None:
        """The next update, for when there is time to send it."""
        if self._needs_all:
            return
        frame = self._frame(update)
        self._queue.append(frame)
        self._octets += len(frame)
        if len(self._queue) > MAX_QUEUED or self._octets > MAX_QUEUED_OCTETS:
            self.dropped += len(self._queue)
            self.start_again()
        self._filled.set()

    def start_again(self) -> None:
        """Forget what waits; a snapshot is next."""
        self._queue.clear()
        self._octets = 0
        self._needs_all = True
        self._filled.set()

    def show_truth(self, *, shown: bool) -> None:
        """Whether it sees the drones, from a snapshot on."""
        if shown != self.sees_truth:
            self.sees_truth = shown
            self.start_again()

    async def next(self) -> bytes:
        """The next frame to send; waits for one."""
        await self._filled.wait()
        if self._needs_all:
            self._needs_all = False
            frame = self._frame(self._snapshot())
        else:
            frame = self._queue.popleft()
            self._octets -= len(frame)
        if not self._queue and not self._needs_all:
            self._filled.clear()
        return frame

    def _frame(self, update: Update) -> bytes:
        return update.public + update.truth if self.sees_truth else update.public

"""What is replayed next, read some way ahead in a thread, so that nothing is unpacked late."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

from plotfeed.feeds.replay_source import Item, Reader

AHEAD, AHEAD_OCTETS = 4096, 16 << 20
"""Messages, and what they hold, that wait before no more are read."""
SWITCH_S = 1e-5
"""So long at most a thread that reads keeps the loop from sending; usually it is 5 ms."""
GARBAGE = 100_000
"""Objects more than before, from which on garbage is looked for; messages leave none behind."""


class ReadAhead:
    """A bounded queue between a reader and whoever sends."""

    def __init__(self, reader: Reader, on_news: Callable[[], object]) -> None:
        """`on_news` is called when there is something after there was nothing, or the end is."""
        self.reader = reader
        self.finished = False
        """Nothing more will come, unless it is told to go on elsewhere."""
        self._on_news = on_news
        self._items: deque[Item] = deque()
        self._octets = 0
        self._full = False
        self._room = asyncio.Event()
        self._room.set()

    def peek(self) -> Item | None:
        """The next message, if one has been read."""
        return self._items[0] if self._items else None

    def pop(self) -> Item:
        """Take it."""
        item = self._items.popleft()
        self._octets -= len(item.recorded.payload)
        if self._full and len(self._items) <= AHEAD // 2 and self._octets <= AHEAD_OCTETS // 2:
            self._full = False
            self._room.set()
        return item

    def put_back(self, items: Sequence[Item]) -> None:
        """What was taken and not sent, in its order."""
        self._items.extendleft(reversed(items))
        self._octets += sum(len(item.recorded.payload) for item in items)

    def go_on(self, reader: Reader) -> None:
        """With this one, and forget what was read before."""
        self._items.clear()
        self._octets = 0
        self.reader = reader
        self.finished = self._full = False
        self._room.set()

    async def run(self) -> None:
        """Read ahead until cancelled; raises what reading raises."""
        loop = asyncio.get_running_loop()
        with ThreadPoolExecutor(1, thread_name_prefix="read-ahead") as thread:
            while True:
                await self._room.wait()
                if self.finished:
                    self._room.clear()
                    continue
                reader = self.reader
                items = await loop.run_in_executor(thread, reader.batch)
                if reader is self.reader:
                    self._take(items)

    def read_now(self) -> None:
        """Read some without a thread, where nothing waits for its time."""
        while not self._items and not self.finished:
            self._take(self.reader.batch())

    def _take(self, items: list[Item]) -> None:
        was_empty = not self._items
        self._items.extend(items)
        self._octets += sum(len(item.recorded.payload) for item in items)
        self.finished = self.reader.finished
        if len(self._items) >= AHEAD or self._octets >= AHEAD_OCTETS:
            self._full = True
            self._room.clear()
        if was_empty and (items or self.finished):
            self._on_news()


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Meanwhile neither a thread nor the garbage collector holds up the loop for long."""
    switch_s, thresholds = sys.getswitchinterval(), gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(GARBAGE, *thresholds[1:])
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(switch_s)
        gc.set_threshold(*thresholds)
        gc.unfreeze()

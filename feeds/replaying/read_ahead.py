"""Messages of a recording in the order of their replay, lap after lap."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import NamedTuple

from plotfeed.feeds.replaying.replay_settings import ReplaySettings
from plotfeed.replay.files import RepeatableRecording
from plotfeed.replay.pacing import Laps, lap_period_ns
from plotfeed.replay.recorded import Recorded, Stage

BATCH, BATCH_OCTETS = 256, 1 << 20  # Messages looked at in one go
BEFORE = Stage.BEFORE


class ReplayItem(NamedTuple):
    """A message, and when it was recorded."""

    unrolled_ns: int  # In the line of all laps
    lap: int  # From 0
    recorded_ns: int  # When it left or was received; before a link, when it was due
    recorded: Recorded


class ReplayReader:
    """Reads what is to be replayed, a batch at a time; it may be used in a thread."""

    def __init__(self, source: RepeatableRecording, settings: ReplaySettings) -> None:
        self.finished = False  # Nothing is left
        # Recorded time at which each lap begins; None until something has been read.
        self.begin_ns: int | None = None
        self.laps: Laps | None = None  # Known once a lap has been read to its end
        self._source = source
        self._settings = settings
        self._lap = 0
        self._from_ns: int | None = None  # Where this lap begins, if not with all others
        self._bounds: tuple[int | None, int | None] | None = None
        self._is_taken: dict[tuple[str, str, str], bool] = {}
        self._messages: Iterator[Recorded] | None = None
        self._first_ns: int | None = None
        self._last_ns = self._count = 0

    def elsewhere(self, lap: int, from_ns: int) -> ReplayReader:
        """A reader that goes on from that recorded time in that lap."""
        other = ReplayReader(self._source, self._settings)
        other.begin_ns, other.laps, other._bounds = self.begin_ns, self.laps, self._bounds
        other._lap, other._from_ns = lap, from_ns
        return other

    def batch(self) -> list[ReplayItem]:
        """The next messages; there may be none in a batch, and more in the next."""
        messages = self._opened()
        start_ns, end_ns = self._part()
        offset_ns = 0 if self.laps is None else self._lap * self.laps.period_ns
        lap, is_taken, takes = self._lap, self._is_taken, self._settings.selection.takes
        items: list[ReplayItem] = []
        looked = octets = 0
        for recorded in islice(messages, BATCH):
            looked += 1
            octets += len(recorded.payload)
            stage = recorded.stage
            # Its text, since the hash of an enum takes longer.
            key = (recorded.topic, recorded.content_type, stage._value_)
            if (taken := is_taken.get(key)) is None:
                taken = is_taken[key] = takes(recorded.topic, recorded.content_type, stage)
            if taken:
                t_ns = recorded.publish_time_ns if stage is BEFORE else recorded.log_time_ns
                if (start_ns is None or t_ns >= start_ns) and (end_ns is None or t_ns < end_ns):
                    items.append(ReplayItem(t_ns + offset_ns, lap, t_ns, recorded))
            if octets > BATCH_OCTETS:
                break
        if items:
            self._note(items)
        if looked < BATCH and octets <= BATCH_OCTETS:
            self._end_lap()
        return items

    def _opened(self) -> Iterator[Recorded]:
        if self._messages is None:
            self._messages = self._source.messages(*self._part())
        return self._messages

    def _part(self) -> tuple[int | None, int | None]:
        """Start and end of this lap as recorded times."""
        if self._bounds is None:
            self._bounds = self._found_bounds()
        start_ns, end_ns = self._bounds
        return (start_ns if self._from_ns is None else self._from_ns), end_ns

    def _found_bounds(self) -> tuple[int | None, int | None]:
        start, end = self._settings.start, self._settings.end
        if start is None and end is None:
            return None, None
        first = next(self._source.messages(None, None), None)
        if first is None:
            return None, None
        first_ns = first.log_time_ns
        # What begins before the recording begins with it.
        start_ns = None if start is None else max(start.at(first_ns), first_ns)
        return start_ns, None if end is None else end.at(first_ns)

    def _note(self, items: list[ReplayItem]) -> None:
        times = [item.recorded_ns for item in items]
        if self._first_ns is None:
            self._first_ns = min(times)
        if self.begin_ns is None:
            start_ns, _ = self._part()
            self.begin_ns = self._first_ns if start_ns is None else start_ns
        self._last_ns = max(self._last_ns, *times)
        self._count += len(items)

    def _end_lap(self) -> None:
        """Go on with the next lap, if there is one."""
        was_whole, first_ns = self._from_ns is None, self._first_ns
        if self.laps is None and first_ns is not None and self.begin_ns is not None:
            self.laps = Laps(
                begin_ns=self.begin_ns, period_ns=self._period_ns(self.begin_ns, first_ns)
            )
        self._lap += 1
        self._messages = self._from_ns = self._first_ns = None
        self._last_ns = self._count = 0
        most = self._settings.laps
        nothing_there = self.laps is None or (was_whole and first_ns is None)
        self.finished = nothing_there or (most is not None and self._lap >= most)

    def _period_ns(self, begin_ns: int, first_ns: int) -> int:
        period_ns = lap_period_ns(begin_ns, first_ns, self._last_ns, self._count)
        _, end_ns = self._part()
        stands_at_ns = self._settings.stands_at_ns
        if stands_at_ns is not None:
            return max(period_ns, stands_at_ns + 1 - begin_ns)
        return period_ns if end_ns is None else min(period_ns, end_ns - begin_ns)


# Messages, and what they hold, that wait before no more are read.
AHEAD, AHEAD_OCTETS = 4096, 16 << 20


class ReadAhead:
    """What is read ahead of whoever sends: all of it is sent, and reading waits at a limit."""

    def __init__(self, reader: ReplayReader, on_news: Callable[[], object]) -> None:
        """`on_news` is called when there is something after there was nothing, or the end is."""
        self.reader = reader
        self.finished = False  # Nothing more will come, unless it is told to go on elsewhere
        self._on_news = on_news
        self._items: deque[ReplayItem] = deque()
        self._octets = 0
        self._full = False
        self._room = asyncio.Event()
        self._room.set()

    def peek(self) -> ReplayItem | None:
        """The next message, if one has been read."""
        return self._items[0] if self._items else None

    def pop(self) -> ReplayItem:
        """Take it."""
        item = self._items.popleft()
        self._octets -= len(item.recorded.payload)
        if self._full and len(self._items) <= AHEAD // 2 and self._octets <= AHEAD_OCTETS // 2:
            self._full = False
            self._room.set()
        return item

    def put_back(self, items: Sequence[ReplayItem]) -> None:
        """What was taken and not sent, in its order."""
        self._items.extendleft(reversed(items))
        self._octets += sum(len(item.recorded.payload) for item in items)

    def go_on(self, reader: ReplayReader) -> None:
        """Go on with another reader, and forget what was read before."""
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

    def _take(self, items: list[ReplayItem]) -> None:
        was_empty = not self._items
        self._items.extend(items)
        self._octets += sum(len(item.recorded.payload) for item in items)
        self.finished = self.reader.finished
        if len(self._items) >= AHEAD or self._octets >= AHEAD_OCTETS:
            self._full = True
            self._room.clear()
        if was_empty and (items or self.finished):
            self._on_news()

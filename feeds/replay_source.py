"""Messages of a recording in the order of their replay: lap after lap, from any place on."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple, Protocol

from plotfeed.feeds.replay_settings import ReplaySettings
from plotfeed.replay.pacing import Laps, lap_period_ns
from plotfeed.replay.recorded import Recorded, Stage

BATCH, BATCH_OCTETS = 256, 1 << 20
"""Messages looked at in one go."""
BEFORE = Stage.BEFORE


class Source(Protocol):
    """A recording that can be read more than once, and from any time on."""

    def messages(self, start_ns: int | None, end_ns: int | None) -> Iterator[Recorded]:
        """Messages by log time, from `start_ns` on and before `end_ns`."""


class Item(NamedTuple):
    """A message, and when it was recorded."""

    unrolled_ns: int
    """In the line of all laps."""
    lap: int
    """From 0."""
    recorded_ns: int
    """When it left or was heard; before a link, when it was due."""
    recorded: Recorded


class Reader:
    """Reads what is to be replayed, a batch at a time; it may be used in a thread."""

    def __init__(self, source: Source, settings: ReplaySettings) -> None:
        self.finished = False
        """Nothing is left."""
        self.begin_ns: int | None = None
        """Recorded time at which each lap begins; None until something has been read."""
        self.laps: Laps | None = None
        """Known once a lap has been read to its end."""
        self._source = source
        self._settings = settings
        self._lap = 0
        self._from_ns: int | None = None
        """Where this lap begins, if not with all others."""
        self._bounds: tuple[int | None, int | None] | None = None
        self._is_taken: dict[tuple[str, str, str], bool] = {}
        self._messages: Iterator[Recorded] | None = None
        self._first_ns: int | None = None
        self._last_ns = self._count = 0

    def elsewhere(self, lap: int, from_ns: int) -> Reader:
        """A reader that goes on from that recorded time in that lap."""
        other = Reader(self._source, self._settings)
        other.begin_ns, other.laps, other._bounds = self.begin_ns, self.laps, self._bounds
        other._lap, other._from_ns = lap, from_ns
        return other

    def batch(self) -> list[Item]:
        """The next messages; there may be none in a batch, and more in the next."""
        messages = self._opened()
        start_ns, end_ns = self._part()
        offset_ns = 0 if self.laps is None else self._lap * self.laps.period_ns
        lap, is_taken, takes = self._lap, self._is_taken, self._settings.selection.takes
        items: list[Item] = []
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
                    items.append(Item(t_ns + offset_ns, lap, t_ns, recorded))
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

    def _note(self, items: list[Item]) -> None:
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

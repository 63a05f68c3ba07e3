"""What sensors of a recording reported, sector by sector, as the ledger has it.

Plots are measured in the messages and true in the ledger, where they stand in the same order.
Without a ledger, each message that brings plots is taken for a sector.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from typing import NamedTuple

from google.protobuf.message import DecodeError

from plotfeed.feeds.page.recorded_plots import (
    DroneNumbers,
    PlotRow,
    looks_of,
    nobody_s,
    plots_of,
    rows_in,
)
from plotfeed.feeds.page.recording import LEFT, Recording
from plotfeed.feeds.times import NS
from plotfeed.models.state import Looks, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.log_reader import LogReader
from plotfeed.replay.recorded import Recorded

MAX_WAITING = 4096
"""Sectors whose plots wait for their entry in the ledger; older ones give way."""
FAR_NS = 86_400 * NS
"""Times further from a recording than this are not its own."""

_Key = tuple[str, str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSector:
    """One sector, or one message where there is no ledger."""

    at_ns: int
    """Log time at which this was known."""
    sensor: str
    looks: Looks
    plots: Plots
    sent: Sequence[pb.Sent]
    link: str | None
    """The link's keys then, in JSON, empty for none; None if that is not known."""


class _Entry(NamedTuple):
    """A sector as it was read."""

    at_ns: int
    told: pb.Ledger
    """Without plots where those that were measured are not known."""
    rows: Sequence[PlotRow]


class RecordedSectors:
    """Reads a recording from a time on, as far as it is asked to; it may be used in a thread."""

    def __init__(
        self, log: LogReader, recording: Recording, drones: DroneNumbers, from_ns: int
    ) -> None:
        self.read_ns = from_ns
        """Log time as far as which it has read."""
        self._recording = recording
        self._drones = drones
        self._waiting: OrderedDict[_Key, list[PlotRow]] = OrderedDict()
        topics = {*recording.carriers, *([recording.ledger] if recording.ledger else [])}
        stages = {*recording.carried, *LEFT}
        self._messages = log.messages(from_ns, None, topics, stages)
        self._next: Recorded | None = None

    def until(self, t_ns: int) -> list[RecordedSector]:
        """What was known then, and is new since the last call."""
        entries: list[_Entry] = []
        message = self._next or next(self._messages, None)
        while message is not None and message.log_time_ns <= t_ns:
            entries += self._taken(message)
            message = next(self._messages, None)
        self.read_ns, self._next = t_ns, message
        return list(self._sectors(entries))

    def _taken(self, message: Recorded) -> Iterator[_Entry]:
        if message.topic == self._recording.ledger:
            yield from self._entry(message)
        elif message.stage not in self._recording.carried:
            return
        elif self._recording.ledger is None:
            yield self._alone(message)
        else:
            self._wait(message)

    def _wait(self, message: Recorded) -> None:
        """Keep plots until the ledger tells of them."""
        named = dict(message.properties)
        sensor = self._recording.carriers[message.topic]
        key = (sensor, named.get("scan", ""), named.get("sector", ""))
        self._waiting.setdefault(key, []).extend(rows_in(message))
        while len(self._waiting) > MAX_WAITING:
            self._waiting.popitem(last=False)

    def _entry(self, message: Recorded) -> Iterator[_Entry]:
        """Of the ledger; one that is none, or of another time, is passed over."""
        try:
            told = pb.Ledger.FromString(message.payload)
        except DecodeError:
            return
        if not self._is_plausible(told):
            return
        rows = self._waiting.pop((told.sensor, str(told.scan), str(told.sector)), [])
        if len(rows) != len(told.plots):
            rows = []
            del told.plots[:]
        yield _Entry(message.log_time_ns, told, rows)

    def _alone(self, message: Recorded) -> _Entry:
        """Plots as they were delivered, and nothing besides."""
        told = pb.Ledger(sensor=self._recording.carriers[message.topic])
        told.messages.add(
            topic=message.topic,
            due_utc_ns=message.publish_time_ns,
            link_due_utc_ns=message.log_time_ns,
            sent_utc_ns=message.log_time_ns,
            delivered=True,
            fate=pb.SENT,
        )
        return _Entry(message.log_time_ns, told, rows_in(message))

    def _sectors(self, entries: Sequence[_Entry]) -> Iterator[RecordedSector]:
        """Their columns are made at once, and cut."""
        has_ledger = self._recording.ledger is not None
        rows = list(chain.from_iterable(entry.rows for entry in entries))
        truths = list(chain.from_iterable(entry.told.plots for entry in entries))
        plots = plots_of(rows, truths, self._drones) if has_ledger else nobody_s(rows)
        told_looks = chain.from_iterable(entry.told.looks for entry in entries)
        looks = looks_of(list(told_looks), self._drones)
        plot_ends = accumulate(len(entry.rows) for entry in entries)
        look_ends = accumulate(len(entry.told.looks) for entry in entries)
        for entry, plot_end, look_end in zip(entries, plot_ends, look_ends, strict=True):
            yield RecordedSector(
                at_ns=entry.at_ns,
                sensor=entry.told.sensor,
                looks=looks.between(look_end - len(entry.told.looks), look_end),
                plots=plots.between(plot_end - len(entry.rows), plot_end),
                sent=entry.told.messages,
                link=entry.told.link if has_ledger else None,
            )

    def _is_plausible(self, told: pb.Ledger) -> bool:
        """Whether its times are near those of the recording."""
        first_ns, last_ns = self._recording.start_ns - FAR_NS, self._recording.end_ns + FAR_NS
        times = chain(
            (look.time_utc_ns for look in told.looks),
            (plot.time_utc_ns for plot in told.plots),
            (one.due_utc_ns for one in told.messages),
            (one.sent_utc_ns or first_ns for one in told.messages),
            (one.link_due_utc_ns or first_ns for one in told.messages),
        )
        return all(first_ns <= t_ns <= last_ns for t_ns in times)

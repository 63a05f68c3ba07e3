"""What a recording holds, in figures, from one pass over its messages in bounded memory."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.content_types import ASTERIX, MESSAGE_TYPE, is_asterix_topic, message_type
from plotfeed.proto.utc import NS
from plotfeed.replay.asterix_blocks import categories, is_asterix, record_counts
from plotfeed.replay.recorded import Recorded, Stage

MAX_SERIES = 10_000
OTHERS = "(others)"  # In place of the topic when there are more
LEDGER = "Ledger"  # What is told of plots when there is time: its lateness is nobody's
STEPS = 1000  # Of lateness within a factor of e: it is known to 0.05 %


@dataclass(slots=True)
class SeriesSummary:
    """Messages of one topic, stage and kind."""

    messages: int = 0
    octets: int = 0
    # Of ASTERIX, those that are whole; None where nothing tells where they end.
    records: int | None = 0


class Lateness:
    """How much later messages left than they were due; early ones are negative."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()

    def add(self, late_ns: int) -> None:
        """Take that of one more message."""
        step = 1 + round(math.log(abs(late_ns)) * STEPS) if late_ns else 0
        self._counts[step if late_ns > 0 else -step] += 1

    def __len__(self) -> int:
        return self._counts.total()

    def percentile_ns(self, percent: float) -> float:
        """The lateness that so many percent do not exceed; NaN of no messages."""
        left = math.ceil(percent / 100 * len(self))
        for step, count in sorted(self._counts.items()):
            left -= count
            if left <= 0:
                return math.copysign(math.exp((abs(step) - 1) / STEPS), step) if step else 0.0
        return math.nan


@dataclass(slots=True)
class Summary:
    """Counts, times, the longest gap and lateness."""

    # The layouts by which records are told apart.
    categories: Mapping[int, Category] = field(default_factory=lambda: CATEGORIES)
    messages: int = 0
    octets: int = 0  # Of payload
    records: int = 0  # Of ASTERIX, as far as they can be told apart
    first_ns: int | None = None  # Earliest log time
    last_ns: int | None = None  # Latest log time
    gap_ns: int = 0  # Longest time in which no message came
    gap_from_ns: int | None = None  # Log time of the message before that
    disordered: int = 0  # Messages of an earlier log time than one before them
    # By topic, stage and kind. A message of two categories is counted with both.
    series: dict[tuple[str, Stage, str], SeriesSummary] = field(default_factory=dict)
    # Of messages whose due time is known, but for the ledger.
    lateness: dict[Stage, Lateness] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Time from the earliest to the latest message."""
        if self.first_ns is None or self.last_ns is None:
            return 0.0
        return (self.last_ns - self.first_ns) / NS

    def add(self, message: Recorded) -> None:
        """Take one more message, in the order of the file."""
        self.messages += 1
        self.octets += len(message.payload)
        self._take_time(message.log_time_ns)
        kinds, is_asterix = kinds_of(message)
        records = record_counts(message.payload, self.categories) if is_asterix else {}
        self.records += sum(filter(None, records.values()))
        for kind in kinds:
            series = self._series_of(message, kind)
            series.messages += 1
            series.octets += len(message.payload)
            if is_asterix:
                more = records.get(int(kind), 0)
                have = series.records
                series.records = None if have is None or more is None else have + more
        if kinds == (LEDGER,):
            return
        late_ns = message.log_time_ns - message.publish_time_ns
        if late_ns or message.stage in (Stage.BEFORE, Stage.AFTER):
            self.lateness.setdefault(message.stage, Lateness()).add(late_ns)

    def _take_time(self, t_ns: int) -> None:
        if self.first_ns is None or self.last_ns is None:
            self.first_ns = self.last_ns = t_ns
            return
        if t_ns < self.last_ns:
            self.disordered += 1
            self.first_ns = min(self.first_ns, t_ns)
            return
        if t_ns - self.last_ns > self.gap_ns:
            self.gap_ns, self.gap_from_ns = t_ns - self.last_ns, self.last_ns
        self.last_ns = t_ns

    def _series_of(self, message: Recorded, kind: str) -> SeriesSummary:
        key = (message.topic, message.stage, kind)
        if key not in self.series and len(self.series) >= MAX_SERIES:
            key = (OTHERS, message.stage, "")
        return self.series.setdefault(key, SeriesSummary())


def kinds_of(message: Recorded) -> tuple[tuple[str, ...], bool]:
    """Categories of ASTERIX such as 048; else the message's type, or what its content type says.

    And whether it is ASTERIX.
    """
    content = message.content_type
    if not content and is_asterix_topic(message.topic):
        content = ASTERIX
    if content.startswith(ASTERIX) and is_asterix(content, message.payload):
        return tuple(f"{category:03d}" for category in categories(message.payload)), True
    if MESSAGE_TYPE in content:
        return (message_type(content).rpartition(".")[2],), False
    return (content.partition(";")[0].removeprefix("application/"),), False

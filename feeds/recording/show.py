"""What is live or in a file, one line a message; or a file in figures."""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from plotfeed.feeds.console import FAILED
from plotfeed.feeds.console.printed import aligned, printable, say, say_damage
from plotfeed.feeds.messages.message import checked_topic_filter, is_chosen
from plotfeed.feeds.recording.foreign_recordings import ForeignReader
from plotfeed.feeds.recording.record_text import EXTRA, record_told
from plotfeed.feeds.recording.recording_settings import ShowSettings
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import Block, records_in
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, Category
from plotfeed.proto.asterix.standard import tables
from plotfeed.proto.content_types import ASTERIX, MESSAGE_TYPE, is_asterix_topic, message_type
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.replay.asterix_files import (
    categories,
    is_asterix,
    raw_topic,
    record_counts,
    trailer_octets,
)
from plotfeed.replay.files import FORMATS, FileFormat
from plotfeed.replay.recorded import Recorded, RecordingReader, Stage

MAX_SERIES = 10_000
OTHERS = "(others)"  # In place of the topic when there are more
# What is told of plots when there is time: its lateness is nobody's
LEDGERS = (("LedgerBatch",), ("Ledger",))
STEPS = 1000  # Of lateness within a factor of e: it is known to 0.05 %


@dataclass(slots=True)
class SeriesSummary:
    """Messages of one topic, stage and kind."""

    messages: int = 0
    # Of ASTERIX, those that are whole; None where nothing tells where they end.
    records: int | None = 0
    octets: int = 0


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
            key = (message.topic, message.stage, kind)
            if key not in self.series and len(self.series) >= MAX_SERIES:
                key = (OTHERS, message.stage, "")
            series = self.series.setdefault(key, SeriesSummary())
            series.messages += 1
            series.octets += len(message.payload)
            if is_asterix:
                more = records.get(int(kind), 0)
                have = series.records
                series.records = None if have is None or more is None else have + more
        if kinds in LEDGERS:
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


def summary_lines(path: Path, reader: ForeignReader, summary: Summary) -> Iterator[str]:
    """What a file holds, as lines."""
    dated = FORMATS[reader.format].has_dates
    records = f"{summary.records} records of ASTERIX, " if summary.records else ""
    yield (
        f"{path}: {reader.format}, {summary.messages} messages, {records}"
        f"{summary.octets} octets, {summary.duration_s:.3f} s"
    )
    if summary.first_ns is not None and summary.last_ns is not None:
        yield f"  first        {shown_time(summary.first_ns, dated=dated)}"
        yield f"  last         {shown_time(summary.last_ns, dated=dated)}"
    if summary.gap_from_ns is not None:
        since = shown_time(summary.gap_from_ns, dated=dated)
        yield f"  longest gap  {summary.gap_ns / 1e9:.3f} s from {since}"
    if summary.disordered:
        yield f"  disordered   {summary.disordered} messages of earlier times than before them"
    for stage, late in summary.lateness.items():
        p50_ms, p99_ms = (late.percentile_ns(percent) / 1e6 for percent in (50, 99))
        yield f"  lateness     p50 {p50_ms:.3g} ms, p99 {p99_ms:.3g} ms of {len(late)} ({stage})"
    yield from _table(summary)
    if reader.skipped:
        yield f"  {reader.skipped} packets hold no UDP"
    for entry in reader.attachments():
        yield f"  attachment {printable(entry.name)}, {entry.octets} octets"
    if not dated:
        yield f"  {reader.format} has no date"


def _table(summary: Summary) -> Iterator[str]:
    """Topics with their messages, those a second over the whole file, and octets."""
    if not summary.series:
        return
    staged = len({stage for _, stage, _ in summary.series}) > 1
    rows = [
        ("topic", *(["stage"] if staged else []), "kind", "messages", "1/s", "records", "octets")
    ]
    for (topic, stage, kind), series in sorted(summary.series.items()):
        rate = f"{series.messages / summary.duration_s:.1f}" if summary.duration_s else ""
        named = (printable(topic), *([str(stage)] if staged else []), printable(kind))
        # A question mark where nothing tells where they end, nothing where it has none.
        records = "?" if series.records is None else str(series.records or "")
        counts = (str(series.messages), rate, records, str(series.octets))
        rows.append((*named, *counts))
    yield from (f"  {line}" for line in aligned(rows, f"{'<<<' if staged else '<<'}>>>>"))


def figures(path: Path, reader: ForeignReader, summary: Summary) -> dict[str, Any]:
    """What a file holds, as JSON."""
    dated = FORMATS[reader.format].has_dates

    def time(t_utc_ns: int | None) -> str | None:
        return None if t_utc_ns is None else shown_time(t_utc_ns, dated=dated)

    return {
        "file": str(path),
        "format": str(reader.format),
        "dated": dated,
        "messages": summary.messages,
        "records": summary.records,
        "octets": summary.octets,
        "duration_s": summary.duration_s,
        "first_utc": time(summary.first_ns),
        "last_utc": time(summary.last_ns),
        "longest_gap_s": summary.gap_ns / 1e9,
        "longest_gap_from_utc": time(summary.gap_from_ns),
        "disordered": summary.disordered,
        "lateness": {
            str(stage): {
                "messages": len(late),
                "p50_us": late.percentile_ns(50) / 1e3,
                "p99_us": late.percentile_ns(99) / 1e3,
            }
            for stage, late in summary.lateness.items()
        },
        "series": [
            {"topic": topic, "stage": str(stage), "kind": kind, **asdict(series)}
            for (topic, stage, kind), series in sorted(summary.series.items())
        ],
        "attachments": [
            {"name": entry.name, "octets": entry.octets} for entry in reader.attachments()
        ],
        "packets_without_udp": reader.skipped,
        "damage": [asdict(each) for each in reader.damage],
    }


def shown_time(t_utc_ns: int, *, dated: bool) -> str:
    """UTC, or the time of day where the file has no date."""
    text = iso_utc(t_utc_ns)
    return text if dated else text.partition("T")[2]


# What raw ASTERIX does not need is imported where it is needed: it takes longer than reading.

LINES_AT_ONCE = 64


def show_source(source: str, access: dict[str, Any], settings: ShowSettings) -> int:
    """Print the messages of a broker or a network, or what a file holds; the exit code.

    `access` holds the keyword arguments of `BrokerAddress.parse`. Raises `PlotfeedError`, and
    `OSError` of a file.
    """
    for topic_filter in settings.topics:
        checked_topic_filter(topic_filter)
    if settings.verbose and settings.as_json:
        raise PlotfeedError("--verbose: is text for people; --json has everything as it is")
    if settings.verbose and tables() is None:
        say(f"plotfeed: units alone; for names and words: {EXTRA}", err=True)
    if "://" not in source:
        return show_file(Path(source), settings)
    if settings.stages:
        raise PlotfeedError("--stage: only of a file")
    import asyncio

    from plotfeed.feeds.recording.record import LIVE, show_live, source_of  # and what sends

    live = source_of(source, access, "plotfeed-show", f"a file, {LIVE}")

    def lines_of(message: Recorded) -> Iterator[str]:
        return _content_lines(message, settings) if settings.chooses(message) else iter(())

    return asyncio.run(show_live(live, lines_of, settings.count, settings.duration))


def show_file(path: Path, settings: ShowSettings) -> int:
    """Print what a file holds, or its messages; the exit code: 2 if it is damaged.

    Raises `PlotfeedError` and `OSError`.
    """
    count = settings.count
    is_listed = settings.listed or settings.verbose or count is not None
    with ForeignReader(path) as reader:
        if is_listed:
            # In a terminal lines are printed as they come, else many in one write.
            at_once, said = 1 if sys.stdout.isatty() else LINES_AT_ONCE, 0
            lines = _lines(reader, settings)
            wanted = islice(lines, count)
            while some := list(islice(wanted, at_once)):
                say("\n".join(some))
                said += len(some)
            if count is not None and next(lines, None) is not None:
                return 0
        else:
            from plotfeed.feeds.console.printed import with_progress

            summary = Summary(settings.categories)
            for message in with_progress(
                reader.messages(), path.name, lambda: reader.at, reader.octets
            ):
                if settings.chooses(message):
                    summary.add(message)
            said = summary.messages
            if settings.as_json:
                say(json.dumps(figures(path, reader, summary)))
            else:
                say("\n".join(summary_lines(path, reader, summary)))
    say_damage(path, reader.damage, all_in="; --json without --list has all")
    if not said and (settings.topics or settings.stages):
        say(f"plotfeed: {path}: no message is of the topics and stages asked for", err=True)
        return 2 if reader.damage else FAILED
    return 2 if reader.damage else 0


def _lines(reader: ForeignReader, settings: ShowSettings) -> Iterator[str]:
    """Lines of every message; records of raw ASTERIX stand for themselves."""
    if reader.format is FileFormat.RAW:
        if not settings.stages or Stage.RECEIVED in settings.stages:
            yield from _raw_lines(reader, settings)
        return
    facts = FORMATS[reader.format]
    # Where one stage is asked for, every line would have the same.
    staged = facts.holds_stages and len(settings.stages) != 1
    for message in filter(settings.chooses, reader.messages()):
        when = shown_time(message.log_time_ns, dated=facts.has_dates)
        stage = f"{message.stage}  " if staged and message.stage is not Stage.RECEIVED else ""
        told = f', "stage": "{message.stage}"' if staged else ""
        for line in _content_lines(message, settings):
            if settings.as_json:  # an object that message_lines makes has members
                yield f'{{"time_utc": "{when}"{told}, {line[1:]}'
            else:
                yield f"{when}  {stage}{line}"


def _raw_lines(reader: RecordingReader, settings: ShowSettings) -> Iterator[str]:
    """Lines of the records in a file's data blocks, which lie back to back."""
    chosen = [n for n in range(256) if is_chosen(raw_topic(n), settings.topics)]
    end = 0
    for message in reader.messages():
        octets = message.payload
        at, end = end + HEADER_OCTETS, end + len(octets)
        if octets[0] not in chosen:
            continue
        block = Block(octets[0], octets[HEADER_OCTETS:], at)
        try:
            for record in records_in(block, settings.categories):
                told = record_told(record, settings.categories, settings.style)
                yield json.dumps(told) if settings.as_json else told
        except DecodeError as error:
            where = block.at_octet if error.at_octet is None else error.at_octet
            reader.damage.add(where, str(error).removeprefix(f"octet {where}: "))


def _content_lines(message: Recorded, settings: ShowSettings) -> Iterator[str]:
    """Lines of a message, without what a sender put behind its data blocks."""
    from plotfeed.feeds.recording.decoded_text import message_lines

    payload = message.payload
    if message.content_type.startswith(ASTERIX) and (trailer := trailer_octets(payload)):
        payload = payload[:-trailer]
    return message_lines(
        printable(message.topic),
        payload,
        message.content_type or None,
        settings.style,
        settings.categories,
    )

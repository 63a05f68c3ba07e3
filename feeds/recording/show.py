"""What a broker has or a file holds, one line a message; or a file in figures."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.console.printed import aligned, printable, say
from plotfeed.feeds.console.process import stopped_by_signals
from plotfeed.feeds.console.status_line import with_progress
from plotfeed.feeds.recording.decoded_text import (
    Categories,
    categories_of,
    message_lines,
    record_line,
)
from plotfeed.feeds.recording.record_sources import BrokerSource
from plotfeed.proto.asterix.codec.decode import Block, records_in
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS
from plotfeed.proto.content_types import ASTERIX
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.asterix_blocks import trailer_octets
from plotfeed.replay.asterix_files import RawReader
from plotfeed.replay.files import Recording, open_recording
from plotfeed.replay.recorded import Recorded
from plotfeed.replay.summary import Summary

MAX_WAITING_LINES = 100_000


def show_source(
    source: str,
    access: dict[str, Any],
    *,
    listed: bool,
    count: int | None,
    duration: float | None,
    as_json: bool,
    editions: Sequence[str] = (),
) -> int:
    """Print the messages of a broker, or what a file holds; the exit code.

    `access` holds the keyword arguments of `BrokerAddress.parse`, `listed` says that the messages
    of a file are wanted. Raises `PlotfeedError`, and `OSError` of a file.
    """
    categories = categories_of(editions)
    if "://" not in source:
        return show_file(
            Path(source), listed=listed, count=count, as_json=as_json, categories=categories
        )
    expected = "a file or mqtt://HOST:PORT/TOPIC-FILTER"
    broker = BrokerSource.parse(source, access, "plotfeed-show", expected=expected)
    lines_of = partial(message_lines, as_json=as_json, categories=categories)
    return asyncio.run(_show_broker(broker, count, duration, lines_of))


async def _show_broker(
    source: BrokerSource,
    count: int | None,
    duration_s: float | None,
    lines_of: Callable[[str, bytes, str | None], Iterator[str]],
) -> int:
    lines: asyncio.Queue[str] = asyncio.Queue(MAX_WAITING_LINES)
    dropped = 0

    def receive(message: Recorded) -> None:
        nonlocal dropped
        for line in lines_of(message.topic, message.payload, message.content_type or None):
            if lines.full():
                dropped += 1
            else:
                lines.put_nowait(line)

    try:
        await source.open(receive)
        printing = asyncio.create_task(_print(lines, count), name="print")
        with stopped_by_signals(printing.cancel) as signals:
            await asyncio.wait({printing}, timeout=duration_s)
        printing.cancel()
        await asyncio.gather(printing, return_exceptions=True)
    finally:
        await source.close()
    if dropped:
        say(f"plotfeed: {dropped} lines were not shown: the terminal is slower", err=True)
    return INTERRUPTED if signal.SIGINT in signals else 0


async def _print(lines: asyncio.Queue[str], count: int | None) -> None:
    printed = 0
    while count is None or printed < count:
        say(await lines.get())
        printed += 1


def show_file(
    path: Path, *, listed: bool, count: int | None, as_json: bool, categories: Categories
) -> int:
    """Print what a file holds, or its messages; the exit code: 2 if it is damaged.

    Raises `PlotfeedError` and `OSError`.
    """
    with open_recording(path) as recording:
        reader = recording.reader
        if listed or count is not None:
            lines = _lines(recording, as_json=as_json, categories=categories)
            for line in islice(lines, count):
                say(line)
            if count is not None and next(lines, None) is not None:
                return 0
        else:
            summary = Summary()
            for message in with_progress(
                reader.messages(), path.name, lambda: reader.at, recording.octets
            ):
                summary.add(message)
            if as_json:
                say(json.dumps(_figures(path, recording, summary)))
            else:
                say("\n".join(_text(path, recording, summary)))
    for damage in reader.damage:
        say(f"plotfeed: {path}: {damage}", err=True)
    return 2 if reader.damage else 0


def _lines(recording: Recording, *, as_json: bool, categories: Categories) -> Iterator[str]:
    """Lines of every message; records of raw ASTERIX stand for themselves."""
    reader = recording.reader
    if isinstance(reader, RawReader):
        return _raw_lines(reader, as_json=as_json, categories=categories)
    dated = recording.has_dates
    line_of = partial(_message_lines, dated=dated, as_json=as_json, categories=categories)
    return (line for message in reader.messages() for line in line_of(message))


def _raw_lines(reader: RawReader, *, as_json: bool, categories: Categories) -> Iterator[str]:
    for octets, at in reader.blocks():
        block = Block(octets[0], octets[HEADER_OCTETS:], at + HEADER_OCTETS)
        try:
            for record in records_in(block, categories):
                yield record_line(record, as_json=as_json)
        except DecodeError as error:
            where = block.at_octet if error.at_octet is None else error.at_octet
            reader.damage.add(where, str(error).removeprefix(f"octet {where}: "))


def _message_lines(
    message: Recorded, *, dated: bool, as_json: bool, categories: Categories
) -> Iterator[str]:
    topic, payload = printable(message.topic), message.payload
    trailer = trailer_octets(payload)
    if trailer and message.content_type.startswith(ASTERIX):
        payload = payload[:-trailer]
    lines = message_lines(
        topic, payload, message.content_type or None, as_json=as_json, categories=categories
    )
    when = _time(message.log_time_ns, dated=dated)
    for line in lines:
        # An object that message_lines makes has members.
        yield f'{{"time_utc": "{when}", {line[1:]}' if as_json else f"{when}  {line}"


def _text(path: Path, recording: Recording, summary: Summary) -> Iterator[str]:
    dated = recording.has_dates
    yield (
        f"{path}: {recording.format}, {summary.messages} messages, {summary.octets} octets, "
        f"{summary.duration_s:.3f} s"
    )
    if summary.first_ns is not None and summary.last_ns is not None:
        yield f"  first        {_time(summary.first_ns, dated=dated)}"
        yield f"  last         {_time(summary.last_ns, dated=dated)}"
    if summary.gap_from_ns is not None:
        since = _time(summary.gap_from_ns, dated=dated)
        yield f"  longest gap  {summary.gap_ns / 1e9:.3f} s from {since}"
    if summary.disordered:
        yield f"  disordered   {summary.disordered} messages of earlier times than before them"
    for stage, late in summary.lateness.items():
        p50_ms, p99_ms = (late.percentile_ns(percent) / 1e6 for percent in (50, 99))
        yield f"  lateness     p50 {p50_ms:.3g} ms, p99 {p99_ms:.3g} ms of {len(late)} ({stage})"
    yield from _table(summary)
    if recording.reader.skipped:
        yield f"  {recording.reader.skipped} packets hold no UDP"
    for entry in recording.reader.attachments():
        yield f"  attachment {printable(entry.name)}, {entry.octets} octets"
    if not dated:
        yield f"  {recording.format} has no date"


def _table(summary: Summary) -> Iterator[str]:
    """Topics with their messages, those a second over the whole file, and octets."""
    if not summary.series:
        return
    staged = len({stage for _, stage, _ in summary.series}) > 1
    rows = [("topic", *(["stage"] if staged else []), "kind", "messages", "1/s", "octets")]
    for (topic, stage, kind), series in sorted(summary.series.items()):
        rate = f"{series.messages / summary.duration_s:.1f}" if summary.duration_s else ""
        named = (printable(topic), *([str(stage)] if staged else []), printable(kind))
        rows.append((*named, str(series.messages), rate, str(series.octets)))
    yield from (f"  {line}" for line in aligned(rows, f"{'<<<' if staged else '<<'}>>>"))


def _figures(path: Path, recording: Recording, summary: Summary) -> dict[str, Any]:
    dated = recording.has_dates
    time = partial(_time_or_none, dated=dated)
    return {
        "file": str(path),
        "format": str(recording.format),
        "dated": dated,
        "messages": summary.messages,
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
            {
                "topic": topic,
                "stage": str(stage),
                "kind": kind,
                "messages": series.messages,
                "octets": series.octets,
            }
            for (topic, stage, kind), series in sorted(summary.series.items())
        ],
        "attachments": [
            {"name": entry.name, "octets": entry.octets} for entry in recording.reader.attachments()
        ],
        "packets_without_udp": recording.reader.skipped,
        "damage": [asdict(each) for each in recording.reader.damage],
    }


def _time(t_utc_ns: int, *, dated: bool) -> str:
    """UTC, or the time of day where the file has no date."""
    text = iso_utc(t_utc_ns)
    return text if dated else text.partition("T")[2]


def _time_or_none(t_utc_ns: int | None, *, dated: bool) -> str | None:
    return None if t_utc_ns is None else _time(t_utc_ns, dated=dated)

"""What a file holds in figures, as text and for programs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.printed import aligned, printable
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.files import Recording
from plotfeed.replay.summary import SeriesSummary, Summary


def summary_lines(path: Path, recording: Recording, summary: Summary) -> Iterator[str]:
    """What a file holds, as lines."""
    dated = recording.has_dates
    records = f"{summary.records} records of ASTERIX, " if summary.records else ""
    yield (
        f"{path}: {recording.format}, {summary.messages} messages, {records}"
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
    rows = [
        ("topic", *(["stage"] if staged else []), "kind", "messages", "1/s", "records", "octets")
    ]
    for (topic, stage, kind), series in sorted(summary.series.items()):
        rate = f"{series.messages / summary.duration_s:.1f}" if summary.duration_s else ""
        named = (printable(topic), *([str(stage)] if staged else []), printable(kind))
        counts = (str(series.messages), rate, _records(series), str(series.octets))
        rows.append((*named, *counts))
    yield from (f"  {line}" for line in aligned(rows, f"{'<<<' if staged else '<<'}>>>>"))


def _records(series: SeriesSummary) -> str:
    """How many, a question mark where nothing tells where they end, nothing where it has none."""
    return "?" if series.records is None else str(series.records or "")


def figures(path: Path, recording: Recording, summary: Summary) -> dict[str, Any]:
    """What a file holds, as JSON."""
    dated = recording.has_dates
    time = partial(_time_or_none, dated=dated)
    return {
        "file": str(path),
        "format": str(recording.format),
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
            {
                "topic": topic,
                "stage": str(stage),
                "kind": kind,
                "messages": series.messages,
                "records": series.records,
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


def shown_time(t_utc_ns: int, *, dated: bool) -> str:
    """UTC, or the time of day where the file has no date."""
    text = iso_utc(t_utc_ns)
    return text if dated else text.partition("T")[2]


def _time_or_none(t_utc_ns: int | None, *, dated: bool) -> str | None:
    return None if t_utc_ns is None else shown_time(t_utc_ns, dated=dated)

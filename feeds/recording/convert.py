"""Recordings from one format to another: what can be read and held, with a word on all else."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import click

from plotfeed.feeds.console.progress import with_progress
from plotfeed.feeds.console.whole_file import part_file
from plotfeed.feeds.messages.topic_filter import checked, matches
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.replay.files import (
    FORMATS,
    FileFormat,
    Recording,
    format_of_suffix,
    open_recording,
    writer_to,
)
from plotfeed.replay.recorded import Recorded, RecordingWriter, Stage

WHAT_LEFT = (Stage.AFTER, Stage.RECEIVED)
"""What a format without stages holds unless it is told otherwise."""
MAX_REASONS = 100
MAX_NOTES = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """Which messages are converted."""

    topics: Sequence[str] = ()
    """Topic filters; without any, all topics."""
    stages: Sequence[Stage] = ()
    """Without any, all that the format holds."""
    start_ns: Callable[[int], int] | None = None
    """The log time from which on, by that of the first message."""
    end_ns: Callable[[int], int] | None = None
    """The log time before which."""


@dataclass(slots=True)
class ConversionCounts:
    """What became of the messages."""

    messages: int = 0
    """That are in the new file."""
    octets: int = 0
    """Of their payload."""
    read: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    left_out: Counter[str] = field(default_factory=Counter)
    """By the reason why."""
    notes: list[str] = field(default_factory=list)


def convert(
    source: Path,
    target: Path,
    wanted: Wanted,
    *,
    from_format: FileFormat | None = None,
    to_format: FileFormat | None = None,
    date_utc_ns: int | None = None,
    force: bool = False,
    as_json: bool = False,
) -> int:
    """Write `target` with what is in `source`; the exit code. Raises `PlotfeedError`, `OSError`.

    `date_utc_ns` is midnight of the day on which a file without dates begins.
    """
    to_format = to_format or format_of_suffix(target)
    for topic_filter in wanted.topics:
        checked(topic_filter)
    totals = ConversionCounts()
    with (
        open_recording(source, from_format, date_utc_ns=date_utc_ns or 0) as recording,
        _new_file(source, target, force=force) as (file, keep),
    ):
        if not recording.has_dates and date_utc_ns is None:
            totals.notes.append(f"{recording.format} has no date: its first day is 1970-01-01")
        writer = writer_to(file, to_format)
        _copy_attachments(recording, writer, totals)
        messages = recording.reader.messages()
        moving = with_progress(messages, target.name, lambda: recording.reader.at, recording.octets)
        for message in _chosen(moving, wanted, to_format, totals):
            _write(writer, message, totals)
        writer.close()
        totals.notes += _notes(recording, writer, to_format)
        damage = recording.reader.damage
        keep(totals.read > 0 or not damage)
    for each in damage:
        click.echo(f"plotfeed: {source}: octet {each.offset}: {each.what}", err=True)
    if damage and not totals.read:
        raise PlotfeedError(f"{source}: nothing in it is whole; {target} is not written")
    (_print_json if as_json else _print)(source, target, recording, to_format, totals)
    return 0


def convert_as_asked(
    source: Path,
    target: Path,
    *,
    from_format: str | None,
    to_format: str | None,
    topics: Sequence[str],
    stages: Sequence[str],
    start: str | None,
    end: str | None,
    date: datetime | None,
    **options: bool,
) -> int:
    """`convert` by the options of the command."""
    wanted = Wanted(
        topics=topics,
        stages=[Stage(stage) for stage in stages],
        start_ns=_moment(start),
        end_ns=_moment(end),
    )
    return convert(
        source,
        target,
        wanted,
        from_format=FileFormat(from_format) if from_format else None,
        to_format=FileFormat(to_format) if to_format else None,
        date_utc_ns=None if date is None else int(date.replace(tzinfo=UTC).timestamp()) * NS,
        **options,
    )


def _moment(text: str | None) -> Callable[[int], int] | None:
    if text is None:
        return None
    from plotfeed.feeds.replaying.replay_settings import Moment

    return Moment.parse(text).at


@contextmanager
def _new_file(
    source: Path, target: Path, *, force: bool
) -> Iterator[tuple[BinaryIO, Callable[[bool], None]]]:
    """A file that becomes `target` if it is to be kept and nothing is raised; else there is none.

    What is no ordinary file, such as a pipe, is written as it is.
    """
    there = target.exists()
    if there and target.samefile(source):
        raise PlotfeedError(f"{target}: is what is read")
    if there and not target.is_file() and not target.is_dir():
        with target.open("wb") as file:
            yield file, lambda _: None
        return
    if there and not force:
        raise PlotfeedError(f"{target}: is there already; --force writes another in its place")
    if target.is_dir() or not target.parent.is_dir():
        raise PlotfeedError(f"{target}: expected the name of a file in a folder that is there")
    with part_file(target) as part:
        yield part


def _chosen(
    messages: Iterator[Recorded], wanted: Wanted, form: FileFormat, totals: ConversionCounts
) -> Iterator[Recorded]:
    """Those that are asked for; the others are counted where nobody asked for fewer."""
    stages = wanted.stages or (Stage if FORMATS[form].holds_stages else WHAT_LEFT)
    start_ns = end_ns = None
    for message in messages:
        if not totals.read:
            first_ns = message.log_time_ns
            start_ns = wanted.start_ns(first_ns) if wanted.start_ns else None
            end_ns = wanted.end_ns(first_ns) if wanted.end_ns else None
        totals.read += 1
        t_ns = message.log_time_ns
        if (start_ns is not None and t_ns < start_ns) or (end_ns is not None and t_ns >= end_ns):
            continue
        if wanted.topics and not any(matches(each, message.topic) for each in wanted.topics):
            continue
        if message.stage in stages:
            yield message
        elif not wanted.stages:
            totals.left_out[f"of stage {message.stage}; --stage takes them"] += 1


def _write(writer: RecordingWriter, message: Recorded, totals: ConversionCounts) -> None:
    reason = writer.write(message)
    if reason is not None:
        known = reason in totals.left_out or len(totals.left_out) < MAX_REASONS
        totals.left_out[reason if known else "of other kinds"] += 1
        return
    totals.messages += 1
    totals.octets += len(message.payload)
    t_ns = message.log_time_ns
    totals.first_ns = t_ns if totals.first_ns is None else min(totals.first_ns, t_ns)
    totals.last_ns = t_ns if totals.last_ns is None else max(totals.last_ns, t_ns)


def _copy_attachments(
    recording: Recording, writer: RecordingWriter, totals: ConversionCounts
) -> None:
    reader = recording.reader
    for name in dict.fromkeys(entry.name for entry in reader.attachments()):
        attachment = reader.attachment(name)
        if attachment is not None and not writer.attach(attachment):
            totals.notes.append(f"the attachment {name!a} was left out")


def _notes(recording: Recording, writer: RecordingWriter, form: FileFormat) -> list[str]:
    notes = [f"{form}: {note}" for note in writer.notes()]
    if recording.reader.skipped:
        notes.append(f"{recording.reader.skipped} packets of {recording.format} hold no UDP")
    return notes


def _print(
    source: Path, target: Path, recording: Recording, form: FileFormat, totals: ConversionCounts
) -> None:
    click.echo(
        f"{source} ({recording.format}) to {target} ({form}): {totals.messages} messages, "
        f"{totals.octets} octets"
    )
    for reason, count in totals.left_out.items():
        click.echo(f"  left out {count} messages: {reason}")
    for note in totals.notes[:MAX_NOTES]:
        click.echo(f"  {note}")
    if len(totals.notes) > MAX_NOTES:
        click.echo(f"  and {len(totals.notes) - MAX_NOTES} more; --json has all")


def _print_json(
    source: Path, target: Path, recording: Recording, form: FileFormat, totals: ConversionCounts
) -> None:
    found: dict[str, Any] = {
        "source": str(source),
        "from": str(recording.format),
        "target": str(target),
        "to": str(form),
        "messages": totals.messages,
        "octets": totals.octets,
        "read": totals.read,
        "first_utc": None if totals.first_ns is None else iso_utc(totals.first_ns),
        "last_utc": None if totals.last_ns is None else iso_utc(totals.last_ns),
        "left_out": dict(totals.left_out),
        "notes": totals.notes,
        "damage": [{"offset": each.offset, "what": each.what} for each in recording.reader.damage],
    }
    click.echo(json.dumps(found))

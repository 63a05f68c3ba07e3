"""What is live or in a file, one line a message; or a file in figures."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from plotfeed.feeds.console import FAILED
from plotfeed.feeds.console.printed import printable, say, say_damage
from plotfeed.feeds.messages.message import checked_topic_filter, is_chosen
from plotfeed.feeds.recording.record_text import (
    EXTRA,
    record_json,
    record_line,
    record_tree,
)
from plotfeed.feeds.recording.recording_settings import ShowSettings
from plotfeed.feeds.recording.summary_text import figures, shown_time, summary_lines
from plotfeed.proto.asterix.codec.decode import Block, Record, records_in
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS
from plotfeed.proto.asterix.standard import tables
from plotfeed.proto.content_types import ASTERIX
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.replay.asterix_blocks import trailer_octets
from plotfeed.replay.asterix_files import RawReader, raw_topic
from plotfeed.replay.files import Recording, open_recording
from plotfeed.replay.recorded import Recorded, Stage
from plotfeed.replay.summary import Summary

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
        if settings.interface is not None:
            raise PlotfeedError("--interface: only for udp://")
        return show_file(Path(source), settings)
    if settings.stages:
        raise PlotfeedError("--stage: only of a file")
    from plotfeed.feeds.recording.record import LIVE, source_of  # and with it what sends
    from plotfeed.feeds.recording.show_live import show_live

    live = source_of(source, access, settings.interface, "plotfeed-show", f"a file, {LIVE}")
    lines_of = partial(_chosen_lines, settings=settings)
    return show_live(live, lines_of, count=settings.count, duration_s=settings.duration)


def _chosen_lines(message: Recorded, settings: ShowSettings) -> Iterator[str]:
    return _content_lines(message, settings) if settings.chooses(message) else iter(())


def show_file(path: Path, settings: ShowSettings) -> int:
    """Print what a file holds, or its messages; the exit code: 2 if it is damaged.

    Raises `PlotfeedError` and `OSError`.
    """
    count = settings.count
    with open_recording(path) as recording:
        reader = recording.reader
        if settings.listed or settings.verbose or count is not None:
            lines = _lines(recording, settings)
            said = _say_all(islice(lines, count))
            if count is not None and next(lines, None) is not None:
                return 0
        else:
            from plotfeed.feeds.console.status_line import with_progress

            summary = Summary(settings.categories)
            for message in with_progress(
                reader.messages(), path.name, lambda: reader.at, recording.octets
            ):
                if settings.chooses(message):
                    summary.add(message)
            said = summary.messages
            if settings.as_json:
                say(json.dumps(figures(path, recording, summary)))
            else:
                say("\n".join(summary_lines(path, recording, summary)))
    say_damage(path, reader.damage, all_in="; --json without --list has all")
    if not said and (settings.topics or settings.stages):
        say(f"plotfeed: {path}: no message is of the topics and stages asked for", err=True)
        return 2 if reader.damage else FAILED
    return 2 if reader.damage else 0


def _say_all(lines: Iterator[str]) -> int:
    """Print lines, in a terminal as they come, else many in one write; how many."""
    at_once, said = 1 if sys.stdout.isatty() else LINES_AT_ONCE, 0
    while some := list(islice(lines, at_once)):
        say("\n".join(some))
        said += len(some)
    return said


def _lines(recording: Recording, settings: ShowSettings) -> Iterator[str]:
    """Lines of every message; records of raw ASTERIX stand for themselves."""
    reader = recording.reader
    if not isinstance(reader, RawReader):
        line_of = partial(
            _message_lines,
            settings=settings,
            dated=recording.has_dates,
            # Where one stage is asked for, every line would have the same.
            staged=recording.has_stages and len(settings.stages) != 1,
        )
        chosen = filter(settings.chooses, reader.messages())
        return (line for message in chosen for line in line_of(message))
    if settings.stages and Stage.RECEIVED not in settings.stages:
        return iter(())
    return _raw_lines(reader, settings)


def _raw_lines(reader: RawReader, settings: ShowSettings) -> Iterator[str]:
    chosen = [n for n in range(256) if is_chosen(raw_topic(n), settings.topics)]
    for octets, at in reader.blocks():
        if octets[0] not in chosen:
            continue
        block = Block(octets[0], octets[HEADER_OCTETS:], at + HEADER_OCTETS)
        try:
            for record in records_in(block, settings.categories):
                yield _told(record, settings)
        except DecodeError as error:
            where = block.at_octet if error.at_octet is None else error.at_octet
            reader.damage.add(where, str(error).removeprefix(f"octet {where}: "))


def _told(record: Record, settings: ShowSettings) -> str:
    if settings.as_json:
        return json.dumps(record_json(record))
    if settings.verbose:
        return record_tree(record, settings.categories)
    return record_line(record, settings.categories)


def _message_lines(
    message: Recorded, *, settings: ShowSettings, dated: bool, staged: bool
) -> Iterator[str]:
    when = shown_time(message.log_time_ns, dated=dated)
    stage = f"{message.stage}  " if staged and message.stage is not Stage.RECEIVED else ""
    told = f', "stage": "{message.stage}"' if staged else ""
    for line in _content_lines(message, settings):
        if settings.as_json:  # an object that message_lines makes has members
            yield f'{{"time_utc": "{when}"{told}, {line[1:]}'
        else:
            yield f"{when}  {stage}{line}"


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
        as_json=settings.as_json,
        categories=settings.categories,
        verbose=settings.verbose,
    )

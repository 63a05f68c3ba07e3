"""Recordings made of others: from one format to another, or of several of one session.

What cannot be read or held is told in a word; what two recordings of a session hold is there once.
"""

from __future__ import annotations

import contextlib
import heapq
import json
import re
from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC
from hashlib import blake2b
from itertools import repeat
from pathlib import Path

from plotfeed.feeds.console.printed import say, say_damage, with_progress
from plotfeed.feeds.console.process import made_of
from plotfeed.feeds.messages.message import checked_topic_filter, is_chosen
from plotfeed.feeds.recording.foreign_recordings import ForeignReader
from plotfeed.feeds.recording.recording_settings import ConvertSettings
from plotfeed.feeds.replaying.replay_settings import Moment
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.replay.files import FORMATS, FileFormat, format_of_suffix, writer_to
from plotfeed.replay.recorded import (
    PLOT_TABLES,
    SCENE_NAME,
    SUFFIX,
    WHAT_LEFT,
    Attachment,
    Recorded,
    RecordingReader,
    RecordingWriter,
    Stage,
    TableName,
)

TABLES = (FileFormat.CSV, FileFormat.PARQUET)
MAX_REASONS = 100
MAX_NOTES = 20
MAX_RETAINED = 100_000  # Topics of which a slice has what was retained when it begins
# The end of the topic on which a session says when it began: without that, no record is one.
SESSION = "/session"


@dataclass(slots=True)
class WrittenCounts:
    """What became of the messages that were to be written."""

    messages: int = 0  # That are in the new file
    octets: int = 0  # Of their payload
    first_ns: int | None = None
    last_ns: int | None = None
    left_out: Counter[str] = field(default_factory=Counter)  # By the reason why

    def write(self, writer: RecordingWriter, message: Recorded) -> None:
        """Write a message, or count why the file cannot hold it."""
        reason = writer.write(message)
        if reason is not None:
            known = reason in self.left_out or len(self.left_out) < MAX_REASONS
            self.left_out[reason if known else "of other kinds"] += 1
            return
        self.messages += 1
        self.octets += len(message.payload)
        t_ns = message.log_time_ns
        self.first_ns = t_ns if self.first_ns is None else min(self.first_ns, t_ns)
        self.last_ns = t_ns if self.last_ns is None else max(self.last_ns, t_ns)

    def times(self) -> dict[str, str | None]:
        """The first and the last time, as JSON has them."""
        named = {"first_utc": self.first_ns, "last_utc": self.last_ns}
        return {name: None if t_ns is None else iso_utc(t_ns) for name, t_ns in named.items()}

    def say_left_out(self) -> None:
        """Print how many messages the file does not hold, and why."""
        for reason, count in self.left_out.items():
            say(f"  left out {count} messages: {reason}")


@dataclass(slots=True)
class ConversionCounts(WrittenCounts):
    """What became of the messages of one recording."""

    read: int = 0
    asked: int = 0  # Of these, by topic, stage and time
    notes: list[str] = field(default_factory=list)


def convert_recording(source: Path, target: Path, settings: ConvertSettings) -> int:
    """Write `target` with what is in `source`; the exit code.

    Raises `PlotfeedError`, and `OSError`.
    """
    from_format = FileFormat(settings.from_format) if settings.from_format else None
    form = FileFormat(settings.to_format) if settings.to_format else format_of_suffix(target)
    table = _table_of(target, form)
    for topic_filter in settings.topics:
        checked_topic_filter(topic_filter)
    date = settings.date and int(settings.date.replace(tzinfo=UTC).timestamp()) * NS
    opened = ForeignReader(source, from_format, date_utc_ns=date or 0)
    counts = ConversionCounts()
    with opened as reader, made_of([source], target, force=settings.force) as (file, keep):
        if not FORMATS[reader.format].has_dates and date is None:
            counts.notes.append(f"{reader.format} has no date: its first day is 1970-01-01")
        selection = None
        if form in TABLES and table in PLOT_TABLES:  # whose plots depend on all that is asked for
            from plotfeed.replay.plots_csv import selection_of

            ahead = _chosen(reader.messages(), settings, form, ConversionCounts())
            selection = selection_of(table, ahead)
        writer = writer_to(file, form, table, selection)
        for name in dict.fromkeys(entry.name for entry in reader.attachments()):
            attachment = reader.attachment(name)
            if attachment is not None and not writer.attach(attachment):
                counts.notes.append(f"the attachment {name!a} was left out")
        messages = with_progress(reader.messages(), target.name, lambda: reader.at, reader.octets)
        for message in _chosen(messages, settings, form, counts):
            counts.write(writer, message)
        writer.close()
        counts.notes += [f"{form}: {note}" for note in writer.notes()]
        if reader.skipped:
            counts.notes.append(f"{reader.skipped} packets of {reader.format} hold no UDP")
        is_made = min(counts.messages, counts.asked) > 0 or not (counts.read or reader.damage)
        keep(is_made)
    say_damage(source, reader.damage, all_in="; --json has all")
    if reader.damage and not counts.read:
        raise PlotfeedError(f"{source}: nothing in it is whole; {target} is not written")
    if not is_made:
        reasons = [f"{count} left out: {reason}" for reason, count in counts.left_out.items()]
        why = ", ".join(reasons[:MAX_NOTES]) or "none is of the topics, stages and times asked for"
        raise PlotfeedError(
            f"{target} is not written: nothing of {counts.read} messages would be in it: {why}"
        )
    if settings.as_json:
        found = {
            "source": str(source),
            "from": str(reader.format),
            "target": str(target),
            "to": str(form),
            "messages": counts.messages,
            "octets": counts.octets,
            "read": counts.read,
            **counts.times(),
            "left_out": dict(counts.left_out),
            "notes": counts.notes,
            "damage": [asdict(each) for each in reader.damage],
        }
        say(json.dumps(found))
        return 0
    say(
        f"{source} ({reader.format}) to {target} ({form}): {counts.messages} messages, "
        f"{counts.octets} octets"
    )
    counts.say_left_out()
    for note in counts.notes[:MAX_NOTES]:
        say(f"  {note}")
    if len(counts.notes) > MAX_NOTES:
        say(f"  and {len(counts.notes) - MAX_NOTES} more; --json has all")
    return 0


def _table_of(target: Path, form: FileFormat) -> TableName:
    """The table in which the file's name ends, as in site-looks.parquet, if such a file holds it.

    Otherwise it is that of plots.
    """
    ends = (t for t in TableName if re.search(rf"(^|[-_. ]){t}$", target.stem.lower()))
    table = next(ends, TableName.PLOTS)
    return table if form is FileFormat.PARQUET or table in PLOT_TABLES else TableName.PLOTS


def _between(
    messages: Iterator[Recorded],
    start: Moment | None,
    end: Moment | None,
    counts: ConversionCounts,
    *,
    keeps: bool,
) -> Iterator[Recorded]:
    """Messages of log times from `start` on and before `end`, counted from the first one's.

    With `keeps`, before them what was retained by then, as of `start`: what a broker would tell.
    """
    start_ns = end_ns = None
    retained: dict[tuple[str, Stage], Recorded] = {}
    for message in messages:
        t_ns = message.log_time_ns
        if not counts.read:
            start_ns = start.at(t_ns) if start else None
            end_ns = end.at(t_ns) if end else None
        counts.read += 1
        if start_ns is not None and t_ns < start_ns:
            key = message.topic, message.stage
            if keeps and message.retain and (key in retained or len(retained) < MAX_RETAINED):
                retained[key] = message
        elif end_ns is None or t_ns < end_ns:
            if start_ns is not None:
                told = [each._replace(log_time_ns=start_ns) for each in retained.values()]
                retained.clear()
                yield from (each for each in told if each.payload)
            yield message


def _chosen(
    messages: Iterator[Recorded],
    settings: ConvertSettings,
    form: FileFormat,
    counts: ConversionCounts,
) -> Iterator[Recorded]:
    """Messages that are asked for, and in MCAP what sessions say of themselves.

    The others are counted where nobody asked for fewer.
    """
    stages = settings.stages or (Stage if FORMATS[form].holds_stages else WHAT_LEFT)
    start, end = (
        None if text is None else Moment.parse(text) for text in (settings.start, settings.end)
    )
    keeps = FORMATS[form].holds_stages
    for message in _between(messages, start, end, counts, keeps=keeps):
        of_topic = is_chosen(message.topic, settings.topics)
        is_asked = of_topic and message.stage in stages
        counts.asked += is_asked
        if is_asked or (
            # With the scene, whatever else is chosen.
            form is FileFormat.MCAP and message.retain and message.topic.endswith(SESSION)
        ):
            yield message
        elif of_topic and not settings.stages:
            counts.left_out[f"of stage {message.stage}; --stage takes them"] += 1


# Messages that are looked for in other files; the oldest are then forgotten.
MAX_REMEMBERED = 1_000_000


@dataclass(slots=True)
class MergeCounts(WrittenCounts):
    """What became of the messages of several recordings."""

    of: dict[str, int] = field(default_factory=dict)  # Read, by file
    twice: int = 0  # Left out, as another file had them


def merge_recordings(
    sources: Sequence[Path], target: Path, *, force: bool = False, as_json: bool = False
) -> int:
    """Write `target` with what is in all `sources`, MCAP of one session; the exit code.

    Raises `PlotfeedError` where they are of different scenes, and `OSError`.
    """
    if len(sources) < 2:
        raise PlotfeedError("expected two recordings or more, and the file to be written")
    if len({path.resolve() for path in sources}) < len(sources):
        raise PlotfeedError("a recording is there twice")
    if target.suffix != SUFFIX:
        raise PlotfeedError(f"{target}: expected a name that ends in {SUFFIX}")
    counts = MergeCounts()
    with contextlib.ExitStack() as files:
        logs = [files.enter_context(ForeignReader(path, FileFormat.MCAP)) for path in sources]
        attachments = _attachments(sources, logs)
        file, keep = files.enter_context(made_of(sources, target, force=force))
        writer = writer_to(file, FileFormat.MCAP)
        for attachment in attachments:
            writer.attach(attachment)
        every = with_progress(
            _merged(sources, logs, counts),
            target.name,
            lambda: sum(log.at for log in logs),
            sum(path.stat().st_size for path in sources),
        )
        for message in every:
            counts.write(writer, message)
        writer.close()
        keep(True)
        for path, log in zip(sources, logs, strict=True):
            say_damage(path, log.damage, all_in="; --json has all")
    if as_json:
        found = {
            "target": str(target),
            "messages": counts.messages,
            "octets": counts.octets,
            "of": counts.of,
            "twice": counts.twice,
            "left_out": dict(counts.left_out),
            **counts.times(),
            "damage": {
                str(path): [asdict(each) for each in log.damage]
                for path, log in zip(sources, logs, strict=True)
            },
        }
        say(json.dumps(found))
        return 0
    say(
        f"{target}: {counts.messages} messages of {len(sources)} recordings, {counts.octets} octets"
    )
    for source, number in counts.of.items():
        say(f"  {number} of {source}")
    if counts.twice:
        say(f"  left out {counts.twice} messages that another recording has")
    counts.say_left_out()
    return 0


def _attachments(sources: Sequence[Path], logs: Sequence[RecordingReader]) -> list[Attachment]:
    """What all have with them, the scene first, each once; raises `PlotfeedError`."""
    found: dict[str, tuple[Path, Attachment]] = {}
    for path, log in zip(sources, logs, strict=True):
        for name in dict.fromkeys([SCENE_NAME, *(entry.name for entry in log.attachments())]):
            attachment = log.attachment(name)
            if attachment is None:
                if name == SCENE_NAME:
                    raise PlotfeedError(f"{path}: holds no scene: expected the record of a session")
                continue
            first, known = found.setdefault(name, (path, attachment))
            if known.data != attachment.data:
                what = "scene" if name == SCENE_NAME else ascii(name)
                raise PlotfeedError(f"{path}: holds another {what} than {first}: not one session")
    return [attachment for _, attachment in found.values()]


def _merged(
    sources: Sequence[Path], logs: Iterable[RecordingReader], counts: MergeCounts
) -> Iterator[Recorded]:
    """Messages of all by log time, and where times are the same by file.

    A message that two files hold comes once, at the earlier time. One that a file holds twice, as
    of a link that doubles, comes twice, however many other files hold it so.
    """
    numbered = (zip(log.messages(), repeat(n)) for n, log in enumerate(logs))
    seen: OrderedDict[bytes, tuple[int, dict[int, int]]] = OrderedDict()
    for path in sources:
        counts.of[str(path)] = 0
    for message, n in heapq.merge(*numbered, key=lambda each: each[0].log_time_ns):
        counts.of[str(sources[n])] += 1
        # What makes messages the same, whenever they were recorded.
        said = (message.topic, str(message.stage), message.content_type, *message.properties)
        octets = repr(said).encode() + b"\n" + message.payload
        key = blake2b(octets, digest_size=16).digest()
        written, of_file = seen.get(key, (0, {}))
        of_file[n] = of_file.get(n, 0) + 1
        if of_file[n] <= written:
            counts.twice += 1
        else:
            written += 1
            yield message
        seen[key] = written, of_file
        seen.move_to_end(key)
        if len(seen) > MAX_REMEMBERED:
            seen.popitem(last=False)

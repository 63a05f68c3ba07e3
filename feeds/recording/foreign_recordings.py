"""Recordings from strangers, read by a process apart: what it finds comes here in columns.

Our readers of containers, and the libraries that unpack them, see nothing of this process: neither
its sockets nor its secrets, and they have limits of the system on memory, time and files. The
process has the file as its standard input, and writes frames: a line of JSON with what many
messages have in common, then their numbers, then their payloads.
"""

from __future__ import annotations

import json
import subprocess
import sys
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from plotfeed.feeds.console.posix import confine_process
from plotfeed.feeds.telemetry.foreign_files import (
    FILE_LIMITS,
    MIB,
    broken_or_beyond,
    process_apart,
    why_not,
)
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.files import FileFormat, format_of, reading
from plotfeed.replay.recorded import (
    LATEST_NS,
    Attachment,
    AttachmentEntry,
    Recorded,
    RecordingReader,
    Stage,
    next_messages,
)

KIND = "recording"
MOST_TOGETHER = 512  # Messages of a frame
# What no reader here gives, and a process that was taken over could claim.
MOST_CLAIMED = 1 << 30
_START = "from plotfeed.feeds.recording.foreign_recordings import main; main()"
_STAGES = {str(stage): stage for stage in Stage}


class Wanted(NamedTuple):
    """What is wanted of a file."""

    form: FileFormat
    date_utc_ns: int = 0  # Midnight of the day on which a file without dates begins
    start_ns: int | None = None  # Messages of log times from here on
    end_ns: int | None = None  # and before here
    attachment: str = ""  # That one, and no messages


class ForeignReader(RecordingReader):
    """Reads a file by another process, and again by one more; `close` ends the one that reads."""

    at = 0

    def __init__(self, path: Path, form: FileFormat | None = None, **asked: Any) -> None:
        """Begin to read, with what is asked as `Wanted` has it, in the format that the file is in.

        `form` is another. Raises `PlotfeedError` if it cannot be told or read, and `OSError`.
        """
        super().__init__()
        self.octets = 0  # Of the file; unpacked, where gzip packed it
        self.format = form or format_of(path)
        self._path = path
        self._wanted = Wanted(self.format, **asked)
        self._entries: Sequence[AttachmentEntry] = ()
        self._is_read = False  # Or being read
        self._begin(self._wanted)

    def _begin(self, wanted: Wanted) -> None:
        started = process_apart(_START, json.dumps(wanted))
        with self._path.open("rb") as file:
            self._process = subprocess.Popen(**started, stdin=file, stdout=subprocess.PIPE)
        self._out: BinaryIO = self._process.stdout  # type: ignore[assignment]
        try:
            with self._sound():
                head = self._head()
                self.octets = int(head["octets"])
                self._entries = [
                    AttachmentEntry(
                        name=str(name), media_type=str(kind), octets=int(n), offset=int(at)
                    )
                    for name, kind, n, at in head["attachments"]
                ]
        except BaseException:
            self.close()
            raise

    def messages(
        self, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Recorded]:
        """Messages in the order of the file, of log times from `start_ns` on, before `end_ns`.

        They are read as often as is asked for. Raises `PlotfeedError` where reading breaks off.
        """
        if self._is_read or start_ns is not None or end_ns is not None:
            self.close()
            self._begin(self._wanted._replace(start_ns=start_ns, end_ns=end_ns))
        self._is_read = True
        with self._sound():
            for head, columns, payloads in self._frames():
                series = [
                    (str(topic), str(kind), bool(retain), int(qos), _STAGES[stage])
                    for topic, kind, retain, qos, stage in head["series"]
                ]
                names, values = head["names"], head["values"]
                "".join(names + values)  # of texts and nothing else
                at = told = 0
                for number, log_ns, due_ns, octets, properties in zip(*columns, strict=True):
                    topic, kind, retain, qos, stage = series[number]
                    payload = payloads[at : (at := at + octets)]
                    beside: tuple[tuple[str, str], ...] = ()
                    if properties:
                        which = slice(told, told := told + properties)
                        beside = tuple(zip(names[which], values[which], strict=True))
                    yield Recorded(topic, payload, log_ns, due_ns, kind, beside, retain, qos, stage)

    def attachments(self) -> Sequence[AttachmentEntry]:
        """Files within the file."""
        return self._entries

    def attachment(self, name: str) -> Attachment | None:
        """The last attachment of that name that is whole; None if there is none."""
        with ForeignReader(self._path, self.format, attachment=name) as other:
            found = list(other.messages())
        for damage in other.damage:
            self.damage.add(damage.offset, damage.what)
        if not found:
            return None
        kind, data, t_ns, *_ = found[0]
        return Attachment(name=name, media_type=kind, data=data, log_time_ns=t_ns)

    def close(self) -> None:
        """End the process, if it has not ended itself."""
        self._process.kill()
        self._process.wait()
        self._out.close()

    def _frames(self) -> Iterator[tuple[dict[str, Any], list[array[int]], bytes]]:
        """What messages have in common; their numbers, as `_write` has them; payloads."""
        while number := int((head := self._head())["messages"]):
            columns = [array("Q") for _ in range(5)]
            for column in columns:
                column.frombytes(self._take(number * column.itemsize))
            yield head, columns, self._take(sum(columns[3]))

    def _head(self) -> dict[str, Any]:
        """The next line of JSON, what is told in every one taken."""
        head: dict[str, Any] = json.loads(self._out.readline(MOST_CLAIMED))
        if error := head.get("error"):
            raise PlotfeedError(f"{self._path}: {str(error)[:1000]}")
        self.at, self.skipped = int(head["at"]), int(head["skipped"])
        for offset, what in head["damage"]:
            self.damage.add(int(offset), str(what))
        return head

    def _take(self, octets: int) -> bytes:
        data = self._out.read(octets) if octets <= MOST_CLAIMED else b""
        if len(data) < octets:
            raise ValueError
        return data

    @contextmanager
    def _sound(self) -> Iterator[None]:
        """Have what is no such answer be an error in a line."""
        try:
            yield
        except (ValueError, TypeError, LookupError, OverflowError, AttributeError, RecursionError):
            raise PlotfeedError(f"{self._path}: {broken_or_beyond(KIND)}") from None


def main() -> None:
    """Read the file that is our standard input, and write what is asked of it."""
    limits = FILE_LIMITS[KIND]
    confine_process(limits.memory_mib * MIB, limits.seconds)
    out, asked = sys.stdout.buffer, Wanted(*json.loads(sys.argv[1]))
    try:
        file = sys.stdin.buffer
        with reading(file, FileFormat(asked.form), asked.date_utc_ns) as (reader, octets):
            _write(out, reader, octets, asked, together=MOST_TOGETHER if file.seekable() else 1)
    except BrokenPipeError:  # nobody wants more
        return
    except Exception as error:  # noqa: BLE001 - of what unpacks it, which raises what it likes
        out.write(json.dumps({"error": why_not(KIND, KIND, error)}).encode() + b"\n")
        out.flush()


def _write(
    out: BinaryIO, reader: RecordingReader, octets: int, asked: Wanted, *, together: int
) -> None:
    """Write what there is to know of the file, then frames, of which the last is empty."""
    known = 0

    def head(**facts: Any) -> bytes:
        nonlocal known
        new, known = reader.damage[known:], len(reader.damage)
        facts |= {"at": reader.at, "skipped": reader.skipped}
        facts["damage"] = [(damage.offset, damage.what) for damage in new]
        return json.dumps(facts).encode() + b"\n"

    entries = [(e.name, e.media_type, e.octets, e.offset) for e in reader.attachments()]
    out.write(head(octets=octets, attachments=entries))
    out.flush()
    messages = _messages(reader, asked)
    while some := next_messages(messages, together):
        topics, payloads, log_ns, due_ns, kinds, beside, retained, qos, stages = zip(
            *some, strict=True
        )
        names_of_stages = [stage._value_ for stage in stages]  # an enum's own hash takes long
        series = list(zip(topics, kinds, retained, qos, names_of_stages, strict=True))
        numbers = {each: n for n, each in enumerate(dict.fromkeys(series))}
        rows = [numbers[each] for each in series]
        lengths, told = list(map(len, payloads)), list(map(len, beside))
        pairs = list(chain.from_iterable(beside))
        names, values = zip(*pairs, strict=True) if pairs else ((), ())
        out.write(head(messages=len(some), series=list(numbers), names=names, values=values))
        out.writelines(array("Q", column) for column in (rows, log_ns, due_ns, lengths, told))
        out.writelines(payloads)
        out.flush()
    out.write(head(messages=0))
    out.flush()


def _messages(reader: RecordingReader, asked: Wanted) -> Iterator[Recorded]:
    """What is asked for, as messages."""
    if asked.attachment:
        found = reader.attachment(asked.attachment)
        return iter([Recorded(found.media_type, found.data, found.log_time_ns, 0)] if found else [])
    if asked.form == FileFormat.MCAP:
        return reader.messages(asked.start_ns, asked.end_ns)  # type: ignore[call-arg]
    first, end = asked.start_ns or 0, LATEST_NS + 1 if asked.end_ns is None else asked.end_ns
    return (each for each in reader.messages() if first <= each.log_time_ns < end)

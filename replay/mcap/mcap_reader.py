"""Reads MCAP, ours and what others wrote: by the index or without."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self

from mcap.opcode import Opcode

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.mcap.channels import ChannelKey, Properties, properties_of_json
from plotfeed.replay.mcap.mcap_contents import (
    HEAD,
    MAGIC,
    MESSAGE,
    McapSource,
    TimeSpan,
    attachment_of,
    read_index,
    scan,
)
from plotfeed.replay.recorded import (
    LATEST_NS,
    Attachment,
    AttachmentEntry,
    Recorded,
    RecordingReader,
    Stage,
)

MAX_HELD_OCTETS = 64 << 20  # Of chunks whose times overlap, while their messages are put in order
# In a chunk, and so many again that wait to be put in order: a message of no octets takes room.
MAX_MESSAGES = 1 << 18
_log_time = attrgetter("log_time_ns")


@dataclass(frozen=True, slots=True, kw_only=True)
class McapSummary:
    """What an MCAP file holds."""

    counts: Mapping[ChannelKey, int]  # Messages of each series
    start_ns: int | None  # First log time; None without messages
    end_ns: int | None  # Last log time
    # Whether it was ended as it should, so that a part of it is found without reading the rest.
    indexed: bool

    @property
    def messages(self) -> int:
        """All of them."""
        return sum(self.counts.values())


class McapReader(RecordingReader):
    """Messages of an MCAP file, by log time. Raises `DecodeError` if it is none, and `OSError`."""

    def __init__(self, source: Path | str | BinaryIO) -> None:
        super().__init__()
        self._own = open(source, "rb") if isinstance(source, (Path, str)) else None  # noqa: SIM115, PTH123
        try:
            self._source = McapSource(self._own or source)  # type: ignore[arg-type]
            self._check_magic()
            contents = read_index(self._source, self.damage)
            self._indexed = contents is not None
            self._contents = contents or scan(self._source, self.damage)
        except BaseException:
            self.close()
            raise
        self._contents.spans.sort()

    def summary(self) -> McapSummary:
        """Counts and times."""
        counts: dict[ChannelKey, int] = {}
        for number, channel in self._contents.channels.items():
            if not channel.holds_properties and (count := self._contents.counts.get(number)):
                counts[channel.series] = counts.get(channel.series, 0) + count
        spans = self._contents.spans
        return McapSummary(
            counts=counts,
            start_ns=spans[0].first_ns if spans else None,
            end_ns=max(span.last_ns for span in spans) if spans else None,
            indexed=self._indexed,
        )

    @property
    def at(self) -> int:
        """Where the file is read now."""
        return self._source.file.tell()

    def attachments(self) -> Sequence[AttachmentEntry]:
        """Files within the file, as they come; a name may be there twice."""
        return self._contents.attachments

    def attachment(self, name: str) -> Attachment | None:
        """The last attachment of that name that is whole; None if there is none."""
        for entry in reversed(self._contents.attachments):
            if entry.name != name:
                continue
            try:
                opcode, body = self._source.body(entry.offset)
                if opcode == Opcode.ATTACHMENT:
                    return attachment_of(body)
                raise DecodeError(f"expected the attachment {name!a}")
            except DecodeError as error:
                self.damage.add(entry.offset, str(error))
        return None

    def messages(
        self,
        start_ns: int | None = None,
        end_ns: int | None = None,
        topics: Collection[str] | None = None,
        stages: Collection[Stage] | None = None,
    ) -> Iterator[Recorded]:
        """Messages by log time, from `start_ns` on and before `end_ns`, of those topics and stages.

        Those of one time are in the order in which they were written.
        """
        first, end = start_ns or 0, LATEST_NS + 1 if end_ns is None else end_ns
        wanted = self._wanted(topics, stages)
        spans = [s for s in self._contents.spans if s.last_ns >= first and s.first_ns < end]
        held: list[Recorded] = []
        held_octets = 0
        for n, span in enumerate(spans, 1):
            more, octets = self._read(span, wanted, first, end)
            held, held_octets = sorted([*held, *more], key=_log_time), held_octets + octets
            if n == len(spans) or held_octets > MAX_HELD_OCTETS or len(held) > MAX_MESSAGES:
                ready = len(held)
            else:
                ready = bisect_left(held, spans[n].first_ns, key=_log_time)
            yield from held[:ready]
            held = held[ready:]
            held_octets = held_octets if held else 0

    def close(self) -> None:
        """Close the file, if it was opened here."""
        if self._own is not None:
            self._own.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check_magic(self) -> None:
        """A file that is cut may have none, and one that begins wrongly may go on rightly."""
        beginning = self._source.at(0, len(MAGIC))
        if MAGIC.startswith(beginning):
            return
        head = self._source.head(len(MAGIC))
        if head is None or head[0] != Opcode.HEADER:
            raise DecodeError("expected an MCAP file", at_octet=0)

    def _wanted(
        self, topics: Collection[str] | None, stages: Collection[Stage] | None
    ) -> dict[int, _Wanted]:
        numbers: dict[ChannelKey, int] = {}
        wanted = {}
        for channel_id, channel in self._contents.channels.items():
            series = channel.series
            if (topics is None or series.topic in topics) and (
                stages is None or series.stage in stages
            ):
                number = numbers.setdefault(series, len(numbers))
                wanted[channel_id] = _Wanted(series, number, channel.holds_properties)
        return wanted

    def _read(
        self, span: TimeSpan, wanted: Mapping[int, _Wanted], first_ns: int, end_ns: int
    ) -> tuple[list[Recorded], int]:
        """The messages of a span by log time, and how many octets they were in."""
        try:
            if span.is_chunk:
                data = self._source.chunk(span.offset)
            else:
                data = self._source.at(span.offset, span.octets)
        except DecodeError as error:
            self.damage.add(span.offset, str(error))
            return [], 0
        found = self._messages(span.offset, data, wanted, first_ns, end_ns)
        return found, len(data)

    def _messages(
        self, offset: int, data: bytes, wanted: Mapping[int, _Wanted], first_ns: int, end_ns: int
    ) -> list[Recorded]:
        """Messages in records, as they come; `offset` is where these are in the file."""
        found: list[Recorded] = []
        properties: dict[int, Properties] = {}
        unpack, known = MESSAGE.unpack_from, self._contents.channels
        at, octets = 0, len(data)
        while at + MESSAGE.size <= octets:
            opcode, length, number, sequence, log_ns, publish_ns = unpack(data, at)
            payload_at, at = at + MESSAGE.size, at + HEAD.size + length
            if at > octets or (opcode == Opcode.MESSAGE and at < payload_at):
                break
            if opcode != Opcode.MESSAGE:
                continue
            channel = wanted.get(number)
            if channel is None:
                if number not in known:
                    self.damage.add(offset, f"messages of channel {number}, which is unknown")
                continue
            if not first_ns <= log_ns < end_ns:
                continue
            key = channel.number << 32 | sequence
            if channel.holds_properties:
                properties[key] = self._properties(offset, data[payload_at:at])
                continue
            if len(found) == MAX_MESSAGES:
                self.damage.add(offset, f"a chunk: {MAX_MESSAGES} of its messages are read")
                return found
            series = channel.series
            beside = properties.pop(key, ()) if properties else ()
            found.append(
                Recorded(
                    series.topic,
                    data[payload_at:at],
                    log_ns,
                    publish_ns,
                    series.content_type,
                    beside,
                    series.retain,
                    series.qos,
                    series.stage,
                )
            )
        if at > octets or at + HEAD.size > octets > at:
            self.damage.add(offset, "in a chunk: a record that does not end")
        return found

    def _properties(self, offset: int, data: bytes) -> Properties:
        try:
            return properties_of_json(data)
        except DecodeError as error:
            self.damage.add(offset, str(error))
            return ()


class _Wanted(NamedTuple):
    """A channel whose messages are asked for."""

    series: ChannelKey
    number: int  # Of the series
    holds_properties: bool

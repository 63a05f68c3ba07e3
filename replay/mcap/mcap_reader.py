"""Reads MCAP, ours and what others wrote: by its index, or by a scan where that is broken."""

from __future__ import annotations

import re
import struct
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self
from zlib import crc32

import zstandard
from mcap.opcode import Opcode

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.mcap.channels import (
    Channel,
    ChannelKey,
    Properties,
    channel_of,
    properties_of_json,
)
from plotfeed.replay.recorded import (
    LATEST_NS,
    Attachment,
    AttachmentEntry,
    Damages,
    Recorded,
    RecordingReader,
    Stage,
)

MAGIC = b"\x89MCAP0\r\n"  # The first and the last octets of a file
# Of a record or a chunk's content; whatever claims to be longer is not read.
MAX_RECORD_OCTETS = 256 << 20
MAX_HEADER_OCTETS = 4096
# Octets of content for each of a file's that was read, and in any case: what grows more is made to
# cost time, for a log shrinks to a tenth or a fiftieth.
MOST_UNPACKED, SPARE_OCTETS = 256, 1 << 20

HEAD = struct.Struct("<BQ")  # Opcode, and octets that follow
# Head, channel, sequence, log time and publish time of a message; its payload follows.
MESSAGE = struct.Struct("<BQHIQQ")
MESSAGE_FIELDS_OCTETS = MESSAGE.size - HEAD.size
# First and last log time, octets when uncompressed and their CRC; name and content follow.
CHUNK_FIELDS = struct.Struct("<QQQI")
# Octets that one octet can stand for: of zstd, 4 octets are a run of 128 KiB at most.
MOST_SHRUNK = {"": 1, "zstd": 1 << 15, "lz4": 255}
# Opcode, length, where the summary and its offsets begin, CRC of the summary; then the magic.
FOOTER = struct.Struct("<BQQQI8s")
# First and last log time, offset and octets of the chunk, and octets of a map to go over.
CHUNK_INDEX = struct.Struct("<QQQQI")
# Messages, schemas, channels, attachments, metadata, chunks, first and last log time, octets of the
# messages by channel, which follow.
STATISTICS = struct.Struct("<QHIIIIQQI")
COUNT = struct.Struct("<HQ")  # Channel, and its messages
# Offset and length of the record, log time, time of creation, octets of the data.
ATTACHMENT_INDEX = struct.Struct("<QQQQQ")


class Fields:
    """Takes the fields of one record one after the other; raises `DecodeError` beyond its end."""

    __slots__ = ("_at", "_data", "_end")

    def __init__(self, data: bytes, at: int = 0, end: int | None = None) -> None:
        self._data = data
        self._at = at
        self._end = len(data) if end is None else end

    @property
    def left(self) -> int:
        """Octets that have not been taken."""
        return self._end - self._at

    def skip(self, octets: int) -> int:
        """Go over so many octets; where they begin."""
        at, end = self._at, self._at + octets
        if end > self._end:
            raise DecodeError(f"expected {octets} octets, {self.left} are left", at_octet=at)
        self._at = end
        return at

    def take(self, layout: struct.Struct) -> tuple[int, ...]:
        """Numbers of a fixed layout."""
        return layout.unpack_from(self._data, self.skip(layout.size))

    def number(self, octets: int) -> int:
        """An unsigned number of 2, 4 or 8 octets."""
        at = self.skip(octets)
        return int.from_bytes(self._data[at : at + octets], "little")

    def octets(self, length: int) -> bytes:
        """Octets as they are."""
        at = self.skip(length)
        return self._data[at : at + length]

    def text(self) -> str:
        """UTF-8, after its length."""
        at = self._at
        try:
            return self.octets(self.number(4)).decode()
        except UnicodeDecodeError:
            raise DecodeError("expected UTF-8", at_octet=at) from None

    def texts(self) -> dict[str, str]:
        """Pairs of texts, after their octets."""
        end = self.number(4)
        inner = Fields(self._data, at := self.skip(end), at + end)
        found = {}
        while inner.left:
            name = inner.text()
            found[name] = inner.text()
        return found


def attachment_of(body: bytes) -> Attachment:
    """The attachment in the body of its record, which ends with a CRC; raises `DecodeError`."""
    fields = Fields(body)
    log_time_ns, _created_ns = fields.number(8), fields.number(8)
    name, media_type = fields.text(), fields.text()
    data = fields.octets(fields.number(8))
    crc = fields.number(4)
    if crc and crc != crc32(body[: len(body) - fields.left - 4]):
        raise DecodeError(f"attachment {name!a}: its CRC is wrong")
    return Attachment(name=name, media_type=media_type, data=data, log_time_ns=log_time_ns)


def unpacked(body: bytes, most: int = MAX_RECORD_OCTETS) -> bytes:
    """The records in a chunk, from the body of its record; raises `DecodeError`.

    Allocates no more than what `body` can possibly hold, and than `most` octets.
    """
    fields = Fields(body)
    *_, octets, crc = fields.take(CHUNK_FIELDS)
    name = fields.text()
    content = fields.octets(fields.number(8))
    if fields.left:
        raise DecodeError("a chunk: longer than what is in it")
    if name not in MOST_SHRUNK:
        raise DecodeError(f"a chunk: expected zstd, lz4 or no compression, not {name[:20]!a}")
    if octets > min(MAX_RECORD_OCTETS, len(content) * MOST_SHRUNK[name]):
        raise DecodeError(f"a chunk: {len(content)} octets cannot hold {octets}, as it says")
    if octets > most:
        raise DecodeError(
            f"a chunk: left out, since the file would grow more than {MOST_UNPACKED}-fold"
        )
    records = _decompressed(name, content, octets)
    if len(records) != octets:
        raise DecodeError(f"a chunk: expected {octets} octets in it, not {len(records)}")
    if crc and crc != crc32(records):
        raise DecodeError("a chunk: its CRC is wrong")
    return records


def _decompressed(name: str, content: bytes, octets: int) -> bytes:
    if name == "zstd":
        try:
            if zstandard.frame_content_size(content) not in (octets, -1):  # some write no size
                raise DecodeError("a chunk: its zstd is of another size")
            return zstandard.ZstdDecompressor().decompress(content, max_output_size=octets)
        except zstandard.ZstdError:
            raise DecodeError("a chunk: its zstd is broken") from None
    if name == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(content, octets))
        except (RuntimeError, EOFError):
            raise DecodeError("a chunk: its lz4 is broken") from None
    return content


class TimeSpan(NamedTuple):
    """Octets of the file that hold messages: a chunk's record, or messages outside chunks."""

    first_ns: int  # Log time
    last_ns: int
    offset: int
    octets: int
    is_chunk: bool = True


@dataclass(slots=True)
class Contents:
    """What is in a file, as its index says or a scan has found."""

    channels: dict[int, Channel] = field(default_factory=dict)
    spans: list[TimeSpan] = field(default_factory=list)
    attachments: list[AttachmentEntry] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)  # Messages by channel
    schemas: dict[int, str] = field(default_factory=dict)  # Their names

    def define(self, opcode: int, fields: Fields) -> None:
        """Take the record of a schema or a channel; raises `DecodeError`."""
        number = fields.number(2)
        if opcode == Opcode.SCHEMA:
            self.schemas[number] = fields.text()
        else:
            schema = self.schemas.get(fields.number(2), "")
            topic, encoding = fields.text(), fields.text()
            self.channels[number] = channel_of(topic, encoding, schema, fields.texts())


class McapSource:
    """A file that is read at any place; its end is where it was when it was opened."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.octets = file.seek(0, 2)
        self._may_unpack = SPARE_OCTETS

    def at(self, offset: int, octets: int) -> bytes:
        """What is there, less where the file ends earlier."""
        self.file.seek(offset)
        return self.file.read(max(0, min(octets, self.octets - offset)))

    def head(self, offset: int) -> tuple[int, int] | None:
        """Opcode and length of the record there; None if the file ends before it does."""
        octets = self.at(offset, HEAD.size)
        if len(octets) < HEAD.size:
            return None
        opcode, length = HEAD.unpack(octets)
        return (opcode, length) if offset + HEAD.size + length <= self.octets else None

    def body(self, offset: int) -> tuple[int, bytes]:
        """Opcode and body of the record there; raises `DecodeError`."""
        head = self.head(offset)
        if head is None:
            raise DecodeError("a record that the file is too short for")
        if head[1] > MAX_RECORD_OCTETS:
            raise DecodeError(f"a record of {head[1]} octets: expected {MAX_RECORD_OCTETS} at most")
        return head[0], self.at(offset + HEAD.size, head[1])

    def chunk(self, offset: int) -> bytes:
        """The records in the chunk there; raises `DecodeError`, also where all is too much."""
        opcode, body = self.body(offset)
        if opcode != Opcode.CHUNK:
            raise DecodeError("expected a chunk")
        self._may_unpack += MOST_UNPACKED * len(body)
        records = unpacked(body, self._may_unpack)
        self._may_unpack -= len(records)
        return records


def library_of(path: Path) -> str:
    """The library that the file says it was written by; raises `DecodeError` and `OSError`."""
    with path.open("rb") as file:
        fields = Fields(file.read(len(MAGIC) + HEAD.size + MAX_HEADER_OCTETS))
    if fields.octets(len(MAGIC)) != MAGIC or fields.take(HEAD)[0] != Opcode.HEADER:
        raise DecodeError("expected an MCAP file", at_octet=0)
    _profile, library = fields.text(), fields.text()
    return library


def read_index(source: McapSource, damages: Damages) -> Contents | None:
    """What the index says; None if there is none, or one that does not tell everything."""
    start = _summary_start(source, damages)
    if start is None:
        return None
    end = source.octets - FOOTER.size
    summary = source.at(start, end - start)
    try:
        return _contents(summary, start)
    except DecodeError as error:
        damages.add(start + (error.at_octet or 0), f"the index: {error}")
        return None


def _summary_start(source: McapSource, damages: Damages) -> int | None:
    """Where the summary begins, if its CRC is right."""
    octets = source.at(max(0, source.octets - FOOTER.size), FOOTER.size)
    if len(octets) < FOOTER.size:
        return None
    opcode, length, start, _, crc, magic = FOOTER.unpack(octets)
    start = int(start)
    if magic != MAGIC:
        return None  # the scan says how it ends instead
    at = source.octets - FOOTER.size
    if (opcode, length) != (Opcode.FOOTER, FOOTER.size - HEAD.size - len(MAGIC)):
        damages.add(at, "the footer: it is not one")
    elif not start:
        return None
    elif not len(MAGIC) <= start <= at or at - start > MAX_RECORD_OCTETS:
        damages.add(at, "the footer: the index cannot be where it says")
    elif crc and crc != crc32(octets[: -4 - len(MAGIC)], crc32(source.at(start, at - start))):
        damages.add(start, "the index: its CRC is wrong")
    else:
        return start
    return None


def _contents(summary: bytes, start: int) -> Contents | None:
    """None if the records within are not all that the file has; raises `DecodeError`."""
    found, told = Contents(), (-1, -1, -1, -1)
    fields = Fields(summary)
    while fields.left:
        opcode, length = fields.take(HEAD)
        at = fields.skip(length)
        record = Fields(summary, at, at + length)
        if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            found.define(opcode, record)
        elif opcode == Opcode.CHUNK_INDEX:
            first_ns, last_ns, offset, octets, _ = record.take(CHUNK_INDEX)
            found.spans.append(TimeSpan(first_ns, last_ns, offset, octets))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            offset, *_, octets = record.take(ATTACHMENT_INDEX)
            name, media_type = record.text(), record.text()
            found.attachments.append(
                AttachmentEntry(name=name, media_type=media_type, octets=octets, offset=offset)
            )
        elif opcode == Opcode.STATISTICS:
            _, schemas, channels, attachments, _, chunks, *_, octets = record.take(STATISTICS)
            told = (schemas, channels, attachments, chunks)
            for _ in range(octets // COUNT.size):
                number, found.counts[number] = record.take(COUNT)
    spans = sorted(found.spans, key=attrgetter("offset"))
    ends = [span.offset + span.octets for span in spans]
    if any(end > after.offset for end, after in zip(ends, spans[1:], strict=False)):
        raise DecodeError("chunks that overlap")
    if ends and ends[-1] > start:
        raise DecodeError("a chunk beyond the data")
    there = (len(found.schemas), len(found.channels), len(found.attachments), len(spans))
    if told != there or (not spans and any(found.counts.values())):
        return None
    return found


LOOSE_OCTETS = 1 << 20  # Messages outside chunks are read so many octets at a time
# In which a chunk is looked for: first small ones, then large ones.
PIECES_OCTETS = 1 << 12, 1 << 20
# Of what is broken, so many times the file's octets are read, and those, before it is given up.
PATIENCE, PATIENCE_OCTETS = 8, 64 << 20
# Where a chunk may begin: its opcode, and its compression in the right place.
_CHUNK = re.compile(rb"\x06(?=(?s:.{36})(?:\x04\0{3}zstd|\x03\0{3}lz4|\0{4}))")
CHUNK_OCTETS = HEAD.size + CHUNK_FIELDS.size + 4 + 4 + 8  # At most, up to its content
_KINDS = frozenset(Opcode)


class _Scan:
    """Finds all that can be read of a file; what cannot is noted."""

    def __init__(self, source: McapSource, damages: Damages) -> None:
        self._contents = Contents()
        self._source = source
        self._damages = damages
        self._loose: TimeSpan | None = None
        self._wasted = 0  # Octets read in vain

    def run(self) -> Contents:
        """What is in it, record after record; after a broken one, wherever the next is found."""
        at, source = len(MAGIC), self._source
        if source.at(0, at) != MAGIC:
            self._damages.add(0, "the beginning: it is not that of an MCAP file")
        opcode = 0
        while at < source.octets and opcode != Opcode.DATA_END:
            head = source.head(at)
            if head is None:
                at = self._after_broken(
                    at, source.octets, "a record that the file is too short for"
                )
                continue
            opcode, length = head
            end = at + HEAD.size + length
            try:
                self._take(opcode, at, end)
            except DecodeError as error:
                opcode = 0
                end = self._after_broken(at, end, str(error))
            at = end
        self._end_loose()
        magic = source.at(max(0, source.octets - len(MAGIC)), len(MAGIC))
        if opcode != Opcode.DATA_END or magic != MAGIC:
            self._damages.add(source.octets, "the end: cut, or still being written")
        return self._contents

    def _take(self, opcode: int, at: int, end: int) -> None:
        """One record; raises `DecodeError`."""
        if opcode == Opcode.MESSAGE:
            self._take_loose(at, end)
        elif opcode == Opcode.CHUNK:
            first_ns, last_ns = self._take_records(at, self._source.chunk(at))
            if first_ns <= last_ns:
                self._contents.spans.append(TimeSpan(first_ns, last_ns, at, end - at))
        else:
            self._take_other(opcode, at, self._source.body(at)[1])

    def _take_other(self, opcode: int, at: int, body: bytes) -> None:
        """A record without messages, unless it is none; raises `DecodeError`."""
        fields = Fields(body)
        if opcode == Opcode.ATTACHMENT:
            found = attachment_of(body)
            entry = AttachmentEntry(
                name=found.name, media_type=found.media_type, octets=len(found.data), offset=at
            )
            self._contents.attachments.append(entry)
            return
        if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            self._contents.define(opcode, fields)
            return
        if opcode == Opcode.DATA_END:
            fields.skip(4)
        elif opcode == Opcode.MESSAGE_INDEX:
            fields.skip(2)
            fields.skip(fields.number(4))
        elif opcode in {Opcode.METADATA, Opcode.HEADER}:
            fields.text()
            fields.skip(fields.number(4))
        else:
            raise DecodeError(f"a record of an unknown kind, {opcode:#04x}")
        if fields.left:
            raise DecodeError("a record that is longer than its fields")

    def _take_records(self, at: int, data: bytes) -> tuple[int, int]:
        """First and last log time of the messages in a chunk."""
        first_ns, last_ns, counts = LATEST_NS, 0, self._contents.counts
        unpack, unpack_head = MESSAGE.unpack_from, HEAD.unpack_from
        place = 0
        try:
            while place < len(data):
                body = place + HEAD.size
                opcode, length = unpack_head(data, place) if body <= len(data) else (0, 0)
                end = body + length
                if end > len(data):
                    raise DecodeError("a record that does not end", at_octet=place)
                if opcode == Opcode.MESSAGE and length >= MESSAGE_FIELDS_OCTETS:
                    _, _, channel_id, _, log_ns, _ = unpack(data, place)
                    counts[channel_id] = counts.get(channel_id, 0) + 1
                    first_ns, last_ns = min(first_ns, log_ns), max(last_ns, log_ns)
                elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    self._contents.define(opcode, Fields(data, body, end))
                place = end
        except DecodeError as error:  # what is before it is whole
            self._damages.add(at, f"in a chunk: {error}")
        return first_ns, last_ns

    def _take_loose(self, at: int, end: int) -> None:
        """A message outside chunks."""
        head = self._source.at(at, MESSAGE.size)
        if end - at < MESSAGE.size:
            raise DecodeError("a message that is too short")
        _, _, channel_id, _, log_ns, _ = MESSAGE.unpack(head)
        if channel_id not in self._contents.channels:
            raise DecodeError(f"a message of channel {channel_id}, which is unknown")
        self._contents.counts[channel_id] = self._contents.counts.get(channel_id, 0) + 1
        loose = self._loose
        if loose is None or loose.offset + loose.octets != at or loose.octets > LOOSE_OCTETS:
            self._end_loose()
            loose = TimeSpan(log_ns, log_ns, at, 0, is_chunk=False)
        self._loose = TimeSpan(
            min(loose.first_ns, log_ns),
            max(loose.last_ns, log_ns),
            loose.offset,
            end - loose.offset,
            is_chunk=False,
        )

    def _end_loose(self) -> None:
        if self._loose is not None:
            self._contents.spans.append(self._loose)
            self._loose = None

    def _after_broken(self, at: int, end: int, what: str) -> int:
        """Where to go on: after the record if its lengths agree or another follows, or a chunk."""
        self._damages.add(at, what)
        source = self._source
        self._wasted += end - at
        if self._wasted > PATIENCE * source.octets + PATIENCE_OCTETS:
            self._damages.add(at + 1, "from here on: given up, for all that is broken before it")
            return source.octets
        head = source.head(end)
        if (head is not None and head[0] in _KINDS) or self._is_chunk(at):
            return end
        return self._next_chunk(at + 1)

    def _next_chunk(self, at: int) -> int:
        """The next place at which a chunk stands that fits into the file; else its end."""
        source, (piece_octets, most) = self._source, PIECES_OCTETS
        while at < source.octets:
            piece = source.at(at, piece_octets + CHUNK_OCTETS)
            self._wasted += len(piece)
            for match in _CHUNK.finditer(piece, 0, piece_octets + CHUNK_OCTETS):
                if self._is_chunk(at + match.start()):
                    return at + match.start()
            at += piece_octets
            piece_octets = min(2 * piece_octets, most)
        return source.octets

    def _is_chunk(self, at: int) -> bool:
        """Whether its lengths agree, and the file holds all of it."""
        head = self._source.head(at)
        if head is None or head[0] != Opcode.CHUNK:
            return False
        fields = Fields(self._source.at(at + HEAD.size, CHUNK_OCTETS))
        try:
            first_ns, last_ns, _, _ = fields.take(CHUNK_FIELDS)
            name = fields.text()
            length = CHUNK_FIELDS.size + 4 + len(name) + 8 + fields.number(8)
        except DecodeError:
            return False
        return name in MOST_SHRUNK and first_ns <= last_ns and length == head[1]


MAX_HELD_OCTETS = 64 << 20  # Of chunks whose times overlap, while their messages are put in order
# In a chunk, and so many again that wait to be put in order: a message of no octets takes room.
MAX_MESSAGES = 1 << 18
_log_time = attrgetter("log_time_ns")
# Channels whose messages are asked for, by their numbers, and the number of the series of each.
Wanted = dict[int, tuple[Channel, int]]


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
            # A file that is cut may have no magic, and one that begins wrongly may go on rightly.
            head = self._source.head(len(MAGIC))
            is_begun = MAGIC.startswith(self._source.at(0, len(MAGIC)))
            if not is_begun and (head is None or head[0] != Opcode.HEADER):
                raise DecodeError("expected an MCAP file", at_octet=0)
            contents = read_index(self._source, self.damage)
            self._indexed = contents is not None
            self._contents = contents or _Scan(self._source, self.damage).run()
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

    def _wanted(self, topics: Collection[str] | None, stages: Collection[Stage] | None) -> Wanted:
        numbers: dict[ChannelKey, int] = {}
        wanted: Wanted = {}
        for channel_id, channel in self._contents.channels.items():
            series = channel.series
            if (topics is None or series.topic in topics) and (
                stages is None or series.stage in stages
            ):
                wanted[channel_id] = channel, numbers.setdefault(series, len(numbers))
        return wanted

    def _read(
        self, span: TimeSpan, wanted: Wanted, first_ns: int, end_ns: int
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
        self, offset: int, data: bytes, wanted: Wanted, first_ns: int, end_ns: int
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
            asked_for = wanted.get(number)
            if asked_for is None:
                if number not in known:
                    self.damage.add(offset, f"messages of channel {number}, which is unknown")
                continue
            if not first_ns <= log_ns < end_ns:
                continue
            channel, of_series = asked_for
            key = of_series << 32 | sequence
            if channel.holds_properties:
                try:
                    properties[key] = properties_of_json(data[payload_at:at])
                except DecodeError as error:
                    self.damage.add(offset, str(error))
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

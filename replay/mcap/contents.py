"""What is known of an MCAP file before its messages are read, and the index that tells it."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO, NamedTuple
from zlib import crc32

from mcap.opcode import Opcode

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.mcap.channels import Channel, channel_of
from plotfeed.replay.mcap.records import HEAD, MAGIC, MAX_RECORD_OCTETS, Fields
from plotfeed.replay.recorded import AttachmentEntry, Damages


class TimeSpan(NamedTuple):
    """Octets of the file that hold messages: a chunk's record, or messages outside chunks."""

    first_ns: int
    """Log time."""
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
    counts: dict[int, int] = field(default_factory=dict)
    """Messages by channel."""
    schemas: dict[int, str] = field(default_factory=dict)
    """Their names."""

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


MAX_HEADER_OCTETS = 4096


def library_of(path: Path) -> str:
    """The library that the file says it was written by; raises `DecodeError` and `OSError`."""
    with path.open("rb") as file:
        fields = Fields(file.read(len(MAGIC) + HEAD.size + MAX_HEADER_OCTETS))
    if fields.octets(len(MAGIC)) != MAGIC or fields.take(HEAD)[0] != Opcode.HEADER:
        raise DecodeError("expected an MCAP file", at_octet=0)
    _profile, library = fields.text(), fields.text()
    return library


FOOTER = struct.Struct("<BQQQI8s")
"""Opcode, length, where the summary and its offsets begin, CRC of the summary; then the magic."""
CHUNK_INDEX = struct.Struct("<QQQQI")
"""First and last log time, offset and octets of the chunk, and octets of a map to go over."""


STATISTICS = struct.Struct("<QHIIIIQQI")
"""Messages, schemas, channels, attachments, metadata, chunks, first and last log time, octets of
the messages by channel, which follow."""
COUNT = struct.Struct("<HQ")
"""Channel, and its messages."""
ATTACHMENT_INDEX = struct.Struct("<QQQQQ")
"""Offset and length of the record, log time, time of creation, octets of the data."""


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

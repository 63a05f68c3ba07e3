"""Records of MCAP, read strictly: fields, chunks and attachments, and the index of a file."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO, NamedTuple
from zlib import crc32

import zstandard
from mcap.opcode import Opcode

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.mcap.channels import Channel, channel_of
from plotfeed.replay.recorded import Attachment, AttachmentEntry, Damages

MAGIC = b"\x89MCAP0\r\n"
"""The first and the last octets of a file."""
MAX_RECORD_OCTETS = 256 << 20
"""Of a record or a chunk's content; whatever claims to be longer is not read."""
MAX_HEADER_OCTETS = 4096
MOST_UNPACKED, SPARE_OCTETS = 256, 1 << 20
"""Octets of content for each of a file's that was read, and in any case: what grows more is made
to cost time, for a log shrinks to a tenth or a fiftieth."""

HEAD = struct.Struct("<BQ")
"""Opcode, and octets that follow."""
MESSAGE = struct.Struct("<BQHIQQ")
"""Head, channel, sequence, log time and publish time of a message; its payload follows."""
MESSAGE_FIELDS_OCTETS = MESSAGE.size - HEAD.size
CHUNK_FIELDS = struct.Struct("<QQQI")
"""First and last log time, octets when uncompressed and their CRC; name and content follow."""
MOST_SHRUNK = {"": 1, "zstd": 1 << 15, "lz4": 255}
"""Octets that one octet can stand for: of zstd, 4 octets are a run of 128 KiB at most."""
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

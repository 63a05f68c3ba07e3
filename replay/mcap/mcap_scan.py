"""Reads MCAP from its beginning, where there is no index or it is broken."""

from __future__ import annotations

import re
from collections.abc import Iterator

from mcap.opcode import Opcode

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.mcap.records import (
    CHUNK_FIELDS,
    HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_FIELDS_OCTETS,
    MOST_SHRUNK,
    Contents,
    Fields,
    McapSource,
    TimeSpan,
    attachment_of,
)
from plotfeed.replay.recorded import LATEST_NS, AttachmentEntry, Damages

LOOSE_OCTETS = 1 << 20
"""Messages outside chunks are read so many octets at a time."""
PIECES_OCTETS = 1 << 12, 1 << 20
"""In which a chunk is looked for: first small ones, then large ones."""
PATIENCE, PATIENCE_OCTETS = 8, 64 << 20
"""Of what is broken, so many times the file's octets are read, and those, before it is given up."""
_CHUNK = re.compile(rb"\x06(?=(?s:.{36})(?:\x04\0{3}zstd|\x03\0{3}lz4|\0{4}))")
"""Where a chunk may begin: its opcode, and its compression in the right place."""
CHUNK_OCTETS = HEAD.size + CHUNK_FIELDS.size + 4 + 4 + 8
"""At most, up to its content."""
_KINDS = frozenset(Opcode)


def scan(source: McapSource, damages: Damages) -> Contents:
    """All that can be read of the file; what cannot is noted."""
    found = _Scan(source, damages)
    found.run()
    return found.contents


def records_of(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, first octet and end of each record's body; raises `DecodeError` at a broken one."""
    at, end = 0, len(data)
    unpack, head = HEAD.unpack_from, HEAD.size
    while at + head <= end:
        opcode, length = unpack(data, at)
        body, at = at + head, at + head + length
        if at > end:
            raise DecodeError("a record that does not end", at_octet=body - head)
        yield opcode, body, at
    if at != end:
        raise DecodeError("a record that does not end", at_octet=at)


class _Scan:
    def __init__(self, source: McapSource, damages: Damages) -> None:
        self.contents = Contents()
        self._source = source
        self._damages = damages
        self._loose: TimeSpan | None = None
        self._wasted = 0
        """Octets read in vain."""

    def run(self) -> None:
        """Record after record; after a broken one, wherever the next can be found."""
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

    def _take(self, opcode: int, at: int, end: int) -> None:
        """One record; raises `DecodeError`."""
        if opcode == Opcode.MESSAGE:
            self._take_loose(at, end)
        elif opcode == Opcode.CHUNK:
            self._take_chunk(at, end)
        elif opcode == Opcode.ATTACHMENT:
            self._take_attachment(at)
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            self.contents.define(opcode, Fields(self._source.body(at)[1]))
        else:
            self._pass_over(opcode, at)

    def _pass_over(self, opcode: int, at: int) -> None:
        """A record that is not needed, unless it is none; raises `DecodeError`."""
        fields = Fields(self._source.body(at)[1])
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

    def _take_chunk(self, at: int, end: int) -> None:
        data = self._source.chunk(at)
        first_ns, last_ns = self._take_records(at, data)
        if first_ns <= last_ns:
            self.contents.spans.append(TimeSpan(first_ns, last_ns, at, end - at))

    def _take_records(self, at: int, data: bytes) -> tuple[int, int]:
        """First and last log time of the messages in a chunk."""
        first_ns, last_ns, counts = LATEST_NS, 0, self.contents.counts
        unpack = MESSAGE.unpack_from
        try:
            for opcode, body, end in records_of(data):
                if opcode == Opcode.MESSAGE and end - body >= MESSAGE_FIELDS_OCTETS:
                    _, _, channel_id, _, log_ns, _ = unpack(data, body - HEAD.size)
                    counts[channel_id] = counts.get(channel_id, 0) + 1
                    first_ns, last_ns = min(first_ns, log_ns), max(last_ns, log_ns)
                elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    self.contents.define(opcode, Fields(data, body, end))
        except DecodeError as error:  # what is before it is whole
            self._damages.add(at, f"in a chunk: {error}")
        return first_ns, last_ns

    def _take_attachment(self, at: int) -> None:
        attachment = attachment_of(self._source.body(at)[1])
        self.contents.attachments.append(
            AttachmentEntry(
                name=attachment.name,
                media_type=attachment.media_type,
                octets=len(attachment.data),
                offset=at,
            )
        )

    def _take_loose(self, at: int, end: int) -> None:
        """A message outside chunks."""
        head = self._source.at(at, MESSAGE.size)
        if end - at < MESSAGE.size:
            raise DecodeError("a message that is too short")
        _, _, channel_id, _, log_ns, _ = MESSAGE.unpack(head)
        if channel_id not in self.contents.channels:
            raise DecodeError(f"a message of channel {channel_id}, which is unknown")
        self.contents.counts[channel_id] = self.contents.counts.get(channel_id, 0) + 1
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
            self.contents.spans.append(self._loose)
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

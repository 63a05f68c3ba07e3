"""What is known of a native log before its messages are read: channels, chunks, attachments."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.log_channels import Channel, channel_of
from plotfeed.replay.log_records import HEAD, MAX_RECORD_OCTETS, AttachmentEntry, Fields


class Span(NamedTuple):
    """Octets of the file that hold messages: a chunk's record, or messages outside chunks."""

    first_ns: int
    """Log time."""
    last_ns: int
    offset: int
    octets: int
    is_chunk: bool = True


@dataclass(slots=True)
class Contents:
    """As its index says, or a scan has found."""

    channels: dict[int, Channel] = field(default_factory=dict)
    spans: list[Span] = field(default_factory=list)
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


class Source:
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

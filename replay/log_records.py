"""Records of MCAP, the native log: their numbers, their limits, and their fields, read strictly."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from zlib import crc32

from plotfeed.proto.errors import DecodeError

MAGIC = b"\x89MCAP0\r\n"
"""The first and the last octets of a file."""
MAX_RECORD_OCTETS = 256 << 20
"""Of a record or a chunk's content; whatever claims to be longer is not read."""
LAST_TIME_NS = (1 << 64) - 1

HEAD = struct.Struct("<BQ")
"""Opcode, and octets that follow."""
MESSAGE = struct.Struct("<BQHIQQ")
"""Head, channel, sequence, log time and publish time of a message; its payload follows."""
MESSAGE_FIELDS_OCTETS = MESSAGE.size - HEAD.size


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """A file within the file, such as the scene."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int = 0
    """UTC since 1970: when it was put there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachmentEntry:
    """Where an attachment is."""

    name: str
    media_type: str
    octets: int
    """Of its data."""
    offset: int
    """Of its record in the file."""
    length: int
    """Of its record, octets."""


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
        """So many octets as they are."""
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
    """From the body of its record, which ends with a CRC; raises `DecodeError`."""
    fields = Fields(body)
    log_time_ns, _created_ns = fields.number(8), fields.number(8)
    name, media_type = fields.text(), fields.text()
    data = fields.octets(fields.number(8))
    crc = fields.number(4)
    if crc and crc != crc32(body[: len(body) - fields.left - 4]):
        raise DecodeError(f"attachment {name!a}: its CRC is wrong")
    return Attachment(name=name, media_type=media_type, data=data, log_time_ns=log_time_ns)

"""Records of MCAP: numbers, limits, fields read strictly, and chunks."""

from __future__ import annotations

import struct
from zlib import crc32

import zstandard

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.recorded import Attachment

MAGIC = b"\x89MCAP0\r\n"
"""The first and the last octets of a file."""
MAX_RECORD_OCTETS = 256 << 20
"""Of a record or a chunk's content; whatever claims to be longer is not read."""

HEAD = struct.Struct("<BQ")
"""Opcode, and octets that follow."""
MESSAGE = struct.Struct("<BQHIQQ")
"""Head, channel, sequence, log time and publish time of a message; its payload follows."""
MESSAGE_FIELDS_OCTETS = MESSAGE.size - HEAD.size


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


FIELDS = struct.Struct("<QQQI")
"""First and last log time, octets when uncompressed and their CRC; name and content follow."""
MOST_SHRUNK = {"": 1, "zstd": 1 << 15, "lz4": 255}
"""Octets that one octet can stand for: of zstd, 4 octets are a run of 128 KiB at most."""


def unpacked(body: bytes) -> bytes:
    """The records in a chunk, from the body of its record; raises `DecodeError`.

    Allocates no more than what `body` can possibly hold.
    """
    fields = Fields(body)
    *_, octets, crc = fields.take(FIELDS)
    name = fields.text()
    content = fields.octets(fields.number(8))
    if fields.left:
        raise DecodeError("a chunk: longer than what is in it")
    if name not in MOST_SHRUNK:
        raise DecodeError(f"a chunk: expected zstd, lz4 or no compression, not {name[:20]!a}")
    if octets > min(MAX_RECORD_OCTETS, len(content) * MOST_SHRUNK[name]):
        raise DecodeError(f"a chunk: {len(content)} octets cannot hold {octets}, as it says")
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

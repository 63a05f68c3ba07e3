"""Chunks of the native log: records together, compressed and with a CRC."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from zlib import crc32

import zstandard
from mcap.opcode import Opcode

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.log_records import HEAD, MAX_RECORD_OCTETS, Fields

FIELDS = struct.Struct("<QQQI")
"""First and last log time, octets when uncompressed and their CRC; name and content follow."""
ZSTD_LEVEL = 1
"""Higher levels take longer and make the messages of sensors hardly smaller."""
MOST_SHRUNK = {"": 1, "zstd": 1 << 15, "lz4": 255}
"""Octets that one octet can stand for: of zstd, 4 octets are a run of 128 KiB at most."""


def packed(records: bytes, first_ns: int, last_ns: int) -> tuple[bytes, int]:
    """The record of a chunk, and how many octets of it are the compressed content."""
    content = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(records)
    name = b"\4\0\0\0zstd"
    fields = FIELDS.pack(first_ns, last_ns, len(records), crc32(records))
    size = len(content).to_bytes(8, "little")
    length = len(fields) + len(name) + len(size) + len(content)
    return b"".join((HEAD.pack(Opcode.CHUNK, length), fields, name, size, content)), len(content)


def message_index(channel_id: int, entries: Sequence[int]) -> bytes:
    """The record that says where a channel's messages are: log time, offset, log time, ..."""
    octets = 8 * len(entries)
    return struct.pack(
        f"<BQHI{len(entries)}Q", Opcode.MESSAGE_INDEX, 6 + octets, channel_id, octets, *entries
    )


def chunk_index(
    first_ns: int,
    last_ns: int,
    *,
    offset: int,
    octets: int,
    index_offsets: Mapping[int, int],
    index_octets: int,
    compressed_octets: int,
    uncompressed_octets: int,
) -> bytes:
    """The record of the summary that says where a chunk is, and each channel's index of it."""
    places = b"".join(struct.pack("<HQ", *place) for place in index_offsets.items())
    fields = struct.pack("<QQQQI", first_ns, last_ns, offset, octets, len(places))
    end = struct.pack("<QI4sQQ", index_octets, 4, b"zstd", compressed_octets, uncompressed_octets)
    length = len(fields) + len(places) + len(end)
    return b"".join((HEAD.pack(Opcode.CHUNK_INDEX, length), fields, places, end))


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
        import lz4.frame  # type: ignore[import-untyped]  # noqa: PLC0415 - what we write never needs it

        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(content, octets))
        except (RuntimeError, EOFError):
            raise DecodeError("a chunk: its lz4 is broken") from None
    return content

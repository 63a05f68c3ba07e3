"""The file of an MCAP writer: chunks and attachments, whole records at its end, and its summary."""

from __future__ import annotations

import contextlib
import struct
import weakref
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import BinaryIO
from zlib import crc32

import mcap.records as mcap
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from plotfeed.replay.mcap.records import MAGIC
from plotfeed.replay.recorded import LATEST_NS, Attachment

ZSTD_LEVEL = 1
"""Higher levels take longer and make the messages of sensors hardly smaller."""
IN_MEMORY_OCTETS = 1 << 20
"""Of the index, which has some octets for each channel in each chunk: hours make it large."""


class ChunkFile:
    """Takes chunks and attachments. After an `OSError` it ends with what was whole."""

    def __init__(self, file: BinaryIO, library: str, attachments: Iterable[Attachment]) -> None:
        self.schemas: list[bytes] = []
        """Records for the summary, as the next."""
        self.channels: list[bytes] = []
        self._chunk_indexes = Overflowing(file)
        self._attachment_indexes: list[bytes] = []
        self._counts: Counter[int] = Counter()
        """Messages by channel."""
        self._first_ns, self._last_ns = LATEST_NS, 0
        self._file = file
        self._octets = 0
        """Of whole records."""
        self._failed = False
        self._append([MAGIC, record_of(mcap.Header(profile="", library=library))])
        for attachment in attachments:
            self.attach(attachment)

    def add_chunk(self, parts: Sequence[bytes], entries: Mapping[int, Sequence[int]]) -> None:
        """A chunk of those records; `entries` are log time, offset, log time, ... by channel."""
        records = b"".join(parts)
        content = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(records)
        first_ns = min(min(times[::2]) for times in entries.values())
        last_ns = max(max(times[::2]) for times in entries.values())
        chunk = record_of(
            mcap.Chunk(
                compression="zstd",
                data=content,
                message_end_time=last_ns,
                message_start_time=first_ns,
                uncompressed_crc=crc32(records),
                uncompressed_size=len(records),
            )
        )
        begin = at = self._octets + len(chunk)
        indexes, index_offsets = [], {}
        for channel_id, times in entries.items():
            indexes.append(_message_index(channel_id, times))
            index_offsets[channel_id] = at
            at += len(indexes[-1])
        index = mcap.ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=self._octets,
            compression="zstd",
            compressed_size=len(content),
            message_end_time=last_ns,
            message_index_length=at - begin,
            message_index_offsets=index_offsets,
            message_start_time=first_ns,
            uncompressed_size=len(records),
        )
        before = self._octets
        if self._append([chunk, *indexes]):
            try:
                self._chunk_indexes.append(record_of(index))
            except OSError:
                self._octets = before
                self._give_up()
                raise
            self._counts.update({number: len(times) // 2 for number, times in entries.items()})
            self._first_ns = min(self._first_ns, first_ns)
            self._last_ns = max(self._last_ns, last_ns)

    def attach(self, attachment: Attachment) -> None:
        """Put another file into the file."""
        record = mcap.Attachment(
            create_time=attachment.log_time_ns,
            log_time=attachment.log_time_ns,
            name=attachment.name,
            media_type=attachment.media_type,
            data=attachment.data,
        )
        octets, offset = record_of(record), self._octets
        if self._append([octets]):
            index = mcap.AttachmentIndex(
                offset=offset,
                length=len(octets),
                log_time=record.log_time,
                create_time=record.create_time,
                data_size=len(record.data),
                name=record.name,
                media_type=record.media_type,
            )
            self._attachment_indexes.append(record_of(index))

    def end(self) -> None:
        """The summary. A file that has failed gets one too, if there is room where it failed."""
        told, self._failed = self._failed, False
        try:
            self._append(self._summary())
        except OSError:
            if not told:
                raise
        finally:
            self._chunk_indexes.close()

    def _append(self, parts: Iterable[bytes]) -> bool:
        """Write all of them or none; False if the file takes no more. Raises `OSError` once."""
        if self._failed:
            return False
        octets = 0
        try:
            for part in parts:
                left = memoryview(part)
                octets += len(part)
                while left:  # a file without a buffer may take a part
                    left = left[self._file.write(left) :]
            self._file.flush()
        except OSError:
            self._give_up()
            raise
        self._octets += octets
        return True

    def _give_up(self) -> None:
        """Leave what is whole, and take no more."""
        self._failed = True
        with contextlib.suppress(OSError):
            self._file.seek(self._octets)
            self._file.truncate()

    def _summary(self) -> Iterator[bytes]:
        """What lies between the end of the data and the end of the file."""
        statistics = mcap.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self.channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunk_indexes.count,
            message_count=self._counts.total(),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns if self._counts else 0,
            metadata_count=0,
            schema_count=len(self.schemas),
        )
        groups: dict[Opcode, Iterable[bytes]] = {
            Opcode.SCHEMA: self.schemas,
            Opcode.CHANNEL: self.channels,
            Opcode.STATISTICS: [record_of(statistics)],
            Opcode.CHUNK_INDEX: self._chunk_indexes,
            Opcode.ATTACHMENT_INDEX: self._attachment_indexes,
        }
        data_end = record_of(mcap.DataEnd(data_section_crc=0))
        yield data_end
        start = at = self._octets + len(data_end)
        offsets: list[bytes] = []
        crc = 0
        for opcode, parts in groups.items():
            begin = at
            for part in parts:
                crc, at = crc32(part, crc), at + len(part)
                yield part
            if at > begin:
                place = mcap.SummaryOffset(
                    group_opcode=opcode, group_start=begin, group_length=at - begin
                )
                offsets.append(record_of(place))
        footer = record_of(mcap.Footer(summary_start=start, summary_offset_start=at, summary_crc=0))
        end = b"".join((*offsets, footer[:-4]))
        yield b"".join((end, struct.pack("<I", crc32(end, crc)), MAGIC))


class Overflowing:
    """Records for the end of a file: the first in memory, many in a nameless file beside it."""

    def __init__(self, beside: BinaryIO) -> None:
        name = getattr(beside, "name", None)
        folder = str(Path(name).parent) if isinstance(name, str | Path) else None
        self.count = 0
        self._octets = 0
        """Of whole records."""
        self._file = SpooledTemporaryFile(IN_MEMORY_OCTETS, dir=folder)  # noqa: SIM115
        self._close = weakref.finalize(self, self._file.close)  # a writer may be given up

    def append(self, record: bytes) -> None:
        """Keep another; raises `OSError`, and then keeps nothing of it."""
        self._file.seek(self._octets)
        self._file.write(record)
        self._octets += len(record)
        self.count += 1

    def close(self) -> None:
        """Give back the file."""
        self._close()

    def __iter__(self) -> Iterator[bytes]:
        """All of them, one after the other, in pieces of any size."""
        self._file.seek(0)
        left = self._octets
        while left > 0 and (piece := self._file.read(min(left, IN_MEMORY_OCTETS))):
            left -= len(piece)
            yield piece


def record_of(record: mcap.McapRecord) -> bytes:
    """The octets of a record; raises `UnicodeEncodeError`."""
    builder = RecordBuilder()
    record.write(builder)
    octets: bytes = builder.end()  # type: ignore[no-untyped-call]
    return octets


def _message_index(channel_id: int, entries: Sequence[int]) -> bytes:
    """The record that says where a channel's messages are: log time, offset, log time, ..."""
    octets = 8 * len(entries)
    return struct.pack(
        f"<BQHI{len(entries)}Q", Opcode.MESSAGE_INDEX, 6 + octets, channel_id, octets, *entries
    )

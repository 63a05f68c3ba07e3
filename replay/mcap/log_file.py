"""The file of a native log that is being written: whole records at its end, and its summary."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import BinaryIO
from zlib import crc32

import mcap.records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from plotfeed.replay.mcap.records import MAGIC, Attachment, chunk_index, message_index, packed


def record_of(record: mcap.McapRecord) -> bytes:
    """Its octets; raises `UnicodeEncodeError`."""
    builder = RecordBuilder()
    record.write(builder)
    octets: bytes = builder.end()  # type: ignore[no-untyped-call]
    return octets


def _no_statistics() -> mcap.Statistics:
    return mcap.Statistics(
        attachment_count=0,
        channel_count=0,
        channel_message_counts={},
        chunk_count=0,
        message_count=0,
        message_end_time=0,
        message_start_time=0,
        metadata_count=0,
        schema_count=0,
    )


class LogFile:
    """Takes chunks and attachments. After an `OSError` it ends with what was whole."""

    def __init__(self, file: BinaryIO, library: str, attachments: Iterable[Attachment]) -> None:
        self.definitions: dict[str, list[bytes]] = {"schemas": [], "channels": []}
        """Records for the summary."""
        self._file = file
        self._octets = 0
        """Of whole records."""
        self._failed = False
        self._statistics = _no_statistics()
        self._chunk_indexes: list[bytes] = []
        self._attachment_indexes: list[bytes] = []
        self._append(MAGIC + record_of(mcap.Header(profile="", library=library)))
        for attachment in attachments:
            self.attach(attachment)

    def add_chunk(self, parts: Sequence[bytes], indexes: Mapping[int, Sequence[int]]) -> None:
        """A chunk of those records; `indexes` are log time, offset, log time, ... by channel."""
        records = b"".join(parts)
        first_ns = min(min(entries[::2]) for entries in indexes.values())
        last_ns = max(max(entries[::2]) for entries in indexes.values())
        chunk, compressed_octets = packed(records, first_ns, last_ns)
        offset = self._octets
        octets = [chunk]
        at, index_offsets = offset + len(chunk), {}
        for channel_id, entries in indexes.items():
            octets.append(message_index(channel_id, entries))
            index_offsets[channel_id] = at
            at += len(octets[-1])
        if not self._append(b"".join(octets)):
            return
        self._count(indexes, first_ns, last_ns)
        self._chunk_indexes.append(
            chunk_index(
                first_ns,
                last_ns,
                offset=offset,
                octets=len(chunk),
                index_offsets=index_offsets,
                index_octets=at - offset - len(chunk),
                compressed_octets=compressed_octets,
                uncompressed_octets=len(records),
            )
        )

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
        if self._append(octets):
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

    def _append(self, octets: bytes) -> bool:
        """Write it all; False if the file takes no more. Raises `OSError` once."""
        if self._failed:
            return False
        left = memoryview(octets)
        try:
            while left:  # a file without a buffer may take a part
                left = left[self._file.write(left) :]
            self._file.flush()
        except OSError:
            self._failed = True
            with contextlib.suppress(OSError):
                self._file.seek(self._octets)
                self._file.truncate()
            raise
        self._octets += len(octets)
        return True

    def _count(self, indexes: Mapping[int, Sequence[int]], first_ns: int, last_ns: int) -> None:
        counts = self._statistics
        if not counts.chunk_count:
            counts.message_start_time = first_ns
        counts.message_start_time = min(counts.message_start_time, first_ns)
        counts.message_end_time = max(counts.message_end_time, last_ns)
        counts.chunk_count += 1
        for channel_id, entries in indexes.items():
            messages = len(entries) // 2
            counts.message_count += messages
            counts.channel_message_counts[channel_id] = (
                counts.channel_message_counts.get(channel_id, 0) + messages
            )

    def _summary(self) -> bytes:
        """From the end of the data to the end of the file."""
        self._statistics.schema_count = len(self.definitions["schemas"])
        self._statistics.channel_count = len(self.definitions["channels"])
        self._statistics.attachment_count = len(self._attachment_indexes)
        groups = {
            Opcode.SCHEMA: self.definitions["schemas"],
            Opcode.CHANNEL: self.definitions["channels"],
            Opcode.STATISTICS: [record_of(self._statistics)],
            Opcode.CHUNK_INDEX: self._chunk_indexes,
            Opcode.ATTACHMENT_INDEX: self._attachment_indexes,
        }
        data_end = record_of(mcap.DataEnd(data_section_crc=0))
        start = at = self._octets + len(data_end)
        offsets: list[bytes] = []
        for opcode, records in groups.items():
            if records:
                length = sum(map(len, records))
                place = mcap.SummaryOffset(group_opcode=opcode, group_start=at, group_length=length)
                offsets.append(record_of(place))
                at += length
        body = b"".join([record for records in groups.values() for record in records] + offsets)
        footer = record_of(mcap.Footer(summary_start=start, summary_offset_start=at, summary_crc=0))
        crc = struct.pack("<I", crc32(footer[:-4], crc32(body)))
        return b"".join((data_end, body, footer[:-4], crc, MAGIC))

"""Writes MCAP in zstd chunks, indexed, whole up to the last chunk at any time.

The official library writes the records that are few. Those that are many are written here: its
writer ends no chunk before it is full, tells of channels once, keeps the index of hours in memory,
and leaves a file without an end where the disk is full.
"""

from __future__ import annotations

import contextlib
import struct
import weakref
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import BinaryIO
from zlib import crc32

import mcap.records as mcap
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from plotfeed.proto.errors import EncodeError
from plotfeed.replay.mcap.channels import (
    BEFORE,
    PROPERTIES,
    ChannelKey,
    encoding_of,
    json_schema_of,
    message_type_of,
    properties_to_json,
    schema_of,
)
from plotfeed.replay.mcap.mcap_reader import (
    MAGIC,
    MAX_RECORD_OCTETS,
    MESSAGE,
    MESSAGE_FIELDS_OCTETS,
)
from plotfeed.replay.recorded import LATEST_NS, Attachment, Recorded, RecordingWriter, Stage

ZSTD_LEVEL = 1  # Higher levels take longer and make the messages of sensors hardly smaller
# Of the index, which has some octets for each channel in each chunk: hours make it large.
IN_MEMORY_OCTETS = 1 << 20


class ChunkFile:
    """Takes chunks and attachments. After an `OSError` it ends with what was whole."""

    def __init__(self, file: BinaryIO, library: str, attachments: Iterable[Attachment]) -> None:
        self.schemas: list[bytes] = []  # Records for the summary, as the next
        self.channels: list[bytes] = []
        self._chunk_indexes = Overflowing(file)
        self._attachment_indexes: list[bytes] = []
        self._counts: Counter[int] = Counter()  # Messages by channel
        self._first_ns, self._last_ns = LATEST_NS, 0
        self._file = file
        self._octets = 0  # Of whole records
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
            octets = 8 * len(times)
            head = (Opcode.MESSAGE_INDEX, 6 + octets, channel_id, octets)
            indexes.append(struct.pack(f"<BQHI{len(times)}Q", *head, *times))
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
        self._octets = 0  # Of whole records
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


CHUNK_OCTETS = 256 << 10
MAX_PAYLOAD_OCTETS = MAX_RECORD_OCTETS // 2
# Chunks: where there is no index, the loss of one shall not make others unreadable for long.
DEFINE_EVERY = 16
MAX_CHANNELS = 65_535
LAST_SEQUENCE = 0xFFFFFFFF

# Does a piece of work now or later, the pieces one after the other.
Run = Callable[[Callable[[], None]], object]


class _Channel:
    """A channel that is being written."""

    __slots__ = ("defined_in", "definition", "entries", "id", "messages", "properties")

    def __init__(self, number: int, definition: bytes) -> None:
        self.id = number
        self.definition = definition
        self.defined_in = 0  # Number of the last chunk that has the definition
        self.messages = 0
        self.entries: list[int] = []  # Of the current chunk: log time, offset, log time, ..
        self.properties: _Channel | None = None


class McapWriter(RecordingWriter):
    """Writes messages to a file, which it does not close; best opened without a buffer.

    What takes long, compressing a chunk and writing it, is handed to `run`, and `OSError` is raised
    there. The file then ends with the last whole chunk and takes no more messages.
    """

    def __init__(
        self,
        file: BinaryIO,
        *,
        attachments: Iterable[Attachment] = (),
        library: str = "plotfeed",
        run: Run = lambda work: work(),
    ) -> None:
        self._run = run
        self._file = ChunkFile(file, library, attachments)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[object, ...], _Channel] = {}
        self._last_id = 0
        self._parts: list[bytes] = []
        self._octets = 0
        self._touched: list[_Channel] = []
        self._chunk = 1  # Number of the current one
        self._closed = False

    def write(self, message: Recorded) -> str | None:
        """Add a message whole; or why such a file cannot hold it, and nothing of it is there."""
        if len(message.payload) > MAX_PAYLOAD_OCTETS:
            return f"payload: larger than {MAX_PAYLOAD_OCTETS} octets"
        stage = message.stage._value_  # a text: its hash is much quicker than that of an enum
        key = (message.topic, message.content_type, stage, message.retain, message.qos)
        try:
            channel = self._channels.get(key) or self._new_channel(key, message)
            if message.properties:  # a message of their own, with the same number and times
                beside = channel.properties
                if beside is None:
                    beside = self._new_channel(("properties", *key), message, of_properties=True)
                    channel.properties = beside
                beside.messages = channel.messages
                told = properties_to_json(message.properties)
                self._add(beside, message.log_time_ns, message.publish_time_ns, told)
            self._add(channel, message.log_time_ns, message.publish_time_ns, message.payload)
        except UnicodeEncodeError as error:
            return f"{ascii(error.object)[:60]}: expected text that UTF-8 can hold"
        except EncodeError as error:
            return str(error)
        if self._octets >= CHUNK_OCTETS:
            self.flush()
        return None

    def flush(self) -> None:
        """End the chunk, so that what has been written is in the file and readable."""
        if not self._touched:
            return
        entries = {channel.id: channel.entries for channel in self._touched}
        for channel in self._touched:
            channel.entries = []
        work = partial(self._file.add_chunk, self._parts, entries)
        self._parts, self._octets, self._touched = [], 0, []
        self._chunk += 1
        self._run(work)

    def attach(self, attachment: Attachment) -> bool:
        """Put another file into the file."""
        self.flush()
        self._run(partial(self._file.attach, attachment))
        return True

    def close(self) -> None:
        """End the file with its index; again does nothing."""
        if not self._closed:
            self._closed = True
            self.flush()
            self._run(self._file.end)

    def _add(self, channel: _Channel, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """The whole message or, with an `EncodeError`, nothing of it."""
        octets = len(payload)
        try:
            head = MESSAGE.pack(
                Opcode.MESSAGE,
                MESSAGE_FIELDS_OCTETS + octets,
                channel.id,
                channel.messages & LAST_SEQUENCE,
                log_ns,
                publish_ns,
            )
        except struct.error:
            raise EncodeError("expected times after 1970, before 2554", field="time") from None
        channel.messages += 1
        entries = channel.entries
        if not entries:
            self._touched.append(channel)
            if not channel.defined_in or self._chunk - channel.defined_in >= DEFINE_EVERY:
                self._put(channel.definition)
                channel.defined_in = self._chunk
        entries += (log_ns, self._octets)
        self._parts += (head, payload)
        self._octets += MESSAGE.size + octets

    def _new_channel(
        self, key: tuple[object, ...], message: Recorded, *, of_properties: bool = False
    ) -> _Channel:
        series = ChannelKey.of(message)
        if self._last_id == MAX_CHANNELS:
            raise EncodeError(f"more than {MAX_CHANNELS} channels", field="topic")
        # Protobuf's or of JSON; 0 where there is none.
        named, schema_id = message_type_of(series), 0
        if named and not of_properties:
            schema_id = self._schema(named, "protobuf", schema_of(named))
        elif not of_properties and (found := json_schema_of(series)) is not None:
            schema_id = self._schema(found[0], "jsonschema", found[1])
        encoding = "json" if of_properties else encoding_of(series.content_type)
        before = (PROPERTIES if of_properties else "") + (
            BEFORE if series.stage is Stage.BEFORE else ""
        )
        definition = mcap.Channel(
            id=self._last_id + 1,
            topic=before + series.topic,  # under which other tools list it
            message_encoding=encoding if schema_id or encoding != "protobuf" else "",
            metadata=series.metadata(of_properties=of_properties),
            schema_id=schema_id,
        )
        channel = _Channel(definition.id, record_of(definition))
        self._last_id = channel.id
        self._channels[key] = channel
        self._file.channels.append(channel.definition)
        return channel

    def _schema(self, name: str, encoding: str, data: bytes | None) -> int:
        """Number of a schema, which is put into the file once."""
        key = f"{encoding} {name}"
        if key not in self._schemas:
            number = 0 if data is None else len(self._file.schemas) + 1
            if data is not None:
                schema = record_of(mcap.Schema(id=number, name=name, encoding=encoding, data=data))
                self._put(schema)
                self._file.schemas.append(schema)
            self._schemas[key] = number
        return self._schemas[key]

    def _put(self, record: bytes) -> None:
        self._parts.append(record)
        self._octets += len(record)

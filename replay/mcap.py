"""MCAP, in which everything that a message has is kept: records, chunks, channels and index.

The `mcap` library writes and names the records that are few. Its own writer and readers are not
used: they take two to three times as long, and of what a day or a stranger brings
- its writer keeps the index of hours in memory, tells of channels once, which a lost chunk takes
  along, and leaves a file without an end where the disk is full;
- its readers trust every length, and give up at the first record that is broken.
"""

from __future__ import annotations

import contextlib
import json
import re
import struct
import weakref
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from importlib import import_module
from json.encoder import encode_basestring as quoted
from operator import attrgetter
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import BinaryIO, NamedTuple
from zlib import crc32

import mcap.records as mcap
import zstandard
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import Default
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import (
    ASTERIX,
    GEOJSON,
    JSON,
    PROTOBUF,
    TELEMETRY,
    message_type,
    protobuf_content_type,
    schema_name,
)
from plotfeed.proto.errors import DecodeError, EncodeError
from plotfeed.proto.json_schemas import JSON_SCHEMAS, json_schema
from plotfeed.replay.recorded import (
    LATEST_NS,
    Attachment,
    AttachmentEntry,
    Damages,
    Recorded,
    RecordingReader,
    RecordingWriter,
    Stage,
)

MAGIC = b"\x89MCAP0\r\n"  # The first and the last octets of a file
# Of a record or a chunk's content; whatever claims to be longer is not read.
MAX_RECORD_OCTETS = 256 << 20
MAX_HEADER_OCTETS = 4096
# Octets of content for each of a file's that was read, and in any case: what grows more is made to
# cost time, for a log shrinks to a tenth or a fiftieth.
MOST_UNPACKED, SPARE_OCTETS = 256, 1 << 20

HEAD = struct.Struct("<BQ")  # Opcode, and octets that follow
# Head, channel, sequence, log time and publish time of a message; its payload follows.
MESSAGE = struct.Struct("<BQHIQQ")
MESSAGE_FIELDS_OCTETS = MESSAGE.size - HEAD.size
# First and last log time, octets when uncompressed and their CRC; name and content follow.
CHUNK_FIELDS = struct.Struct("<QQQI")
# Octets that one octet can stand for: of zstd, 4 octets are a run of 128 KiB at most.
MOST_SHRUNK = {"": 1, "zstd": 1 << 15, "lz4": 255}
# Opcode, length, where the summary and its offsets begin, CRC of the summary; then the magic.
FOOTER = struct.Struct("<BQQQI8s")
# First and last log time, offset and octets of the chunk, and octets of a map to go over.
CHUNK_INDEX = struct.Struct("<QQQQI")
# Messages, schemas, channels, attachments, metadata, chunks, first and last log time, octets of the
# messages by channel, which follow.
STATISTICS = struct.Struct("<QHIIIIQQI")
COUNT = struct.Struct("<HQ")  # Channel, and its messages
# Offset and length of the record, log time, time of creation, octets of the data.
ATTACHMENT_INDEX = struct.Struct("<QQQQQ")

Properties = tuple[tuple[str, str], ...]

_decode = json.JSONDecoder().raw_decode  # json.loads looks for other encodings first


@lru_cache(maxsize=64)  # a message is written before its link and after it
def properties_to_json(properties: Properties) -> bytes:
    """An object; a list of pairs if a name is there twice. Raises `UnicodeEncodeError`.

    By hand it takes two thirds of the time.
    """
    if len(dict(properties)) == len(properties):
        pairs = [f"{quoted(name)}:{quoted(value)}" for name, value in properties]
        return f"{{{','.join(pairs)}}}".encode()
    return json.dumps(properties, ensure_ascii=False, separators=(",", ":")).encode()


def properties_of_json(data: bytes) -> Properties:
    """User properties of their JSON; raises `DecodeError`."""
    try:
        text = data.decode()
        found, end = _decode(text)
    except (ValueError, RecursionError):
        raise DecodeError("user properties: expected JSON") from None
    if end != len(text):
        raise DecodeError("user properties: expected JSON and nothing behind it")
    if isinstance(found, dict):
        pairs = tuple(found.items())
    elif isinstance(found, list) and all(isinstance(p, list) and len(p) == 2 for p in found):
        pairs = tuple((name, value) for name, value in found)
    else:
        raise DecodeError("user properties: expected an object or a list of pairs")
    for name, value in pairs:
        if type(name) is not str or type(value) is not str:
            raise DecodeError("user properties: expected texts")
    return pairs


# Of packages: what brings their messages along, if it is installed.
MODULES = {
    "plotfeed.v1.": "plotfeed.proto.plotfeed_pb2",
    "sapient_msg.bsi_flex_335_v2_0.": "sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2",
}


def schema_of(message_type: str) -> bytes | None:
    """A FileDescriptorSet with that message and all it needs; None if it is not known here."""
    for package, module in MODULES.items():
        if message_type.startswith(package):
            with contextlib.suppress(ImportError):
                import_module(module)
    try:
        message = Default().FindMessageTypeByName(message_type)
    except KeyError:
        return None
    files: dict[str, FileDescriptor] = {}
    _collect(message.file, files)
    found = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(found.file.add())
    return found.SerializeToString(deterministic=True)


def _collect(file: FileDescriptor, files: dict[str, FileDescriptor]) -> None:
    """Dependencies come before what needs them."""
    if file.name not in files:
        for needed in file.dependencies:
            _collect(needed, files)
        files[file.name] = file


# Our protobuf messages that are published as JSON, by the last level of their topics.
JSON_BY_TOPIC: Mapping[str, str] = {
    "status": "SensorStatus",
    "description": "SensorDescription",
    "errors": "Refusal",
}


def json_schema_of(series: ChannelKey) -> tuple[str, bytes] | None:
    """Name and JSON schema of what messages in JSON are; None of others.

    By their content type, or else by their topic; of what is neither, that it is an object.
    """
    if encoding_of(series.content_type) != "json":
        return None
    name = schema_name(series.content_type)
    schema = JSON_SCHEMAS.get(name)
    if schema is None:
        kind = JSON_BY_TOPIC.get(series.topic.rpartition("/")[2], "")
        kind = "Telemetry" if series.stage is Stage.TELEMETRY else kind
        found = pb.DESCRIPTOR.message_types_by_name.get(kind)
        name = "" if found is None else found.full_name
        schema = ANY_OBJECT if found is None else json_schema(found, ())
    return name or "plotfeed.Object", json.dumps(schema).encode()


ANY_OBJECT: Mapping[str, object] = {"type": "object"}
OURS = "plotfeed."  # Before our names in a channel's metadata
BEFORE, PROPERTIES = "before/", "properties/"  # Before topics, where one topic has several channels


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelKey:
    """What messages of a channel have in common."""

    topic: str
    content_type: str = ""
    stage: Stage = Stage.RECEIVED
    retain: bool = False
    qos: int = 0

    @classmethod
    def of(cls, recorded: Recorded) -> ChannelKey:
        """The key of a message."""
        return cls(
            topic=recorded.topic,
            content_type=recorded.content_type,
            stage=recorded.stage,
            retain=recorded.retain,
            qos=recorded.qos,
        )

    def metadata(self, *, of_properties: bool) -> dict[str, str]:
        """Everything, for a channel of the messages, or of their user properties."""
        return {
            f"{OURS}topic": self.topic,
            f"{OURS}stage": str(self.stage),
            f"{OURS}content_type": self.content_type,
            f"{OURS}retain": "true" if self.retain else "false",
            f"{OURS}qos": str(self.qos),
            f"{OURS}holds": "properties" if of_properties else "messages",
        }


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of a file that is read."""

    series: ChannelKey
    # Whether its messages are the user properties of the series' messages.
    holds_properties: bool = False


def channel_of(topic: str, encoding: str, schema: str, metadata: Mapping[str, str]) -> Channel:
    """The channel of a record with these fields; one that is not ours has been received."""
    given = {name.removeprefix(OURS): v for name, v in metadata.items() if name.startswith(OURS)}
    try:
        series = ChannelKey(
            topic=given["topic"],
            content_type=given["content_type"],
            stage=Stage(given["stage"]),
            retain=given["retain"] == "true",
            qos=int(given["qos"]),
        )
    except (KeyError, ValueError):
        return Channel(ChannelKey(topic=topic, content_type=_content_type(encoding, schema)))
    return Channel(series, given.get("holds") == "properties")


def encoding_of(content_type: str) -> str:
    """MCAP's name for how messages of a content type are written."""
    kind = content_type.partition(";")[0].strip()
    return {PROTOBUF: "protobuf", JSON: "json", GEOJSON: "json", ASTERIX: "asterix"}.get(kind, kind)


def message_type_of(series: ChannelKey) -> str:
    """Full name of the protobuf message that the messages are; empty if it is not known."""
    if series.content_type.partition(";")[0].strip() != PROTOBUF:
        return ""
    unnamed = TELEMETRY if series.stage is Stage.TELEMETRY else ""
    return message_type(series.content_type) or unnamed


def _content_type(encoding: str, schema: str) -> str:
    """What others wrote, in our words."""
    if encoding == "protobuf":
        return protobuf_content_type(schema) if schema else PROTOBUF
    return {"json": JSON, "asterix": ASTERIX}.get(encoding, f"application/x-{encoding or 'octets'}")


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
        self._schemas: dict[tuple[str, str], int] = {}
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
        schema_id = 0 if of_properties else self._schema_of(series)
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

    def _schema_of(self, series: ChannelKey) -> int:
        """Number of the schema of a series, put into the file once; 0 where none is known."""
        if named := message_type_of(series):
            name, encoding, data = named, "protobuf", schema_of(named)
        else:
            encoding, (name, data) = "jsonschema", json_schema_of(series) or ("", None)
        if data is None:
            return 0
        if (name, encoding) not in self._schemas:
            number = self._schemas[name, encoding] = len(self._schemas) + 1
            schema = record_of(mcap.Schema(id=number, name=name, encoding=encoding, data=data))
            self._put(schema)
            self._file.schemas.append(schema)
        return self._schemas[name, encoding]

    def _put(self, record: bytes) -> None:
        self._parts.append(record)
        self._octets += len(record)


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

    first_ns: int  # Log time
    last_ns: int
    offset: int
    octets: int
    is_chunk: bool = True

    def is_followed_at(self, at: int) -> bool:
        """Whether a message outside chunks that begins there is read together with these."""
        return not self.is_chunk and self.offset + self.octets == at and self.octets <= LOOSE_OCTETS


@dataclass(slots=True)
class Contents:
    """What is in a file, as its index says or a scan has found."""

    channels: dict[int, Channel] = field(default_factory=dict)
    spans: list[TimeSpan] = field(default_factory=list)
    attachments: list[AttachmentEntry] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)  # Messages by channel
    schemas: dict[int, str] = field(default_factory=dict)  # Their names

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

    def crc(self, start: int, end: int) -> int:
        """CRC-32 of the octets from `start` up to `end`."""
        crc = 0
        for offset in range(start, end, LOOSE_OCTETS):
            crc = crc32(self.at(offset, min(LOOSE_OCTETS, end - offset)), crc)
        return crc

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

    def records(self, span: TimeSpan) -> bytes:
        """The records that hold the messages of a span; raises `DecodeError`."""
        return self.chunk(span.offset) if span.is_chunk else self.at(span.offset, span.octets)


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
    try:
        return _contents(source, start)
    except DecodeError as error:
        damages.add(start, f"the index: {error}")
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
    elif not len(MAGIC) <= start <= at:
        damages.add(at, "the footer: the index cannot be where it says")
    elif crc and crc != crc32(octets[: -4 - len(MAGIC)], source.crc(start, at)):
        damages.add(start, "the index: its CRC is wrong")
    else:
        return start
    return None


def _contents(source: McapSource, start: int) -> Contents | None:
    """None if the records from there on are not all that the file has; raises `DecodeError`."""
    found, told = Contents(), (-1, -1, -1, -1)
    at, end = start, source.octets - FOOTER.size
    while at < end:
        opcode, body = source.body(at)
        at += HEAD.size + len(body)
        record = Fields(body)
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
    if at > end:
        raise DecodeError("a record beyond its end")
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


LOOSE_OCTETS = 1 << 20  # Messages outside chunks are read so many octets at a time
# In which a chunk is looked for: first small ones, then large ones.
PIECES_OCTETS = 1 << 12, 1 << 20
# Of what is broken, so many times the file's octets are read, and those, before it is given up.
PATIENCE, PATIENCE_OCTETS = 8, 64 << 20
# Where a chunk may begin: its opcode, and its compression in the right place.
_CHUNK = re.compile(rb"\x06(?=(?s:.{36})(?:\x04\0{3}zstd|\x03\0{3}lz4|\0{4}))")
CHUNK_HEAD_OCTETS = HEAD.size + CHUNK_FIELDS.size + 4 + 4 + 8  # At most, up to its content
_KINDS = frozenset(Opcode)


class _Scan:
    """Finds all that can be read of a file; what cannot is noted."""

    def __init__(self, source: McapSource, damages: Damages) -> None:
        self._contents = Contents()
        self._source = source
        self._damages = damages
        self._wasted = 0  # Octets read in vain

    def run(self) -> Contents:
        """What is in it, record after record; after a broken one, wherever the next is found."""
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
        magic = source.at(max(0, source.octets - len(MAGIC)), len(MAGIC))
        if opcode != Opcode.DATA_END or magic != MAGIC:
            self._damages.add(source.octets, "the end: cut, or still being written")
        return self._contents

    def _take(self, opcode: int, at: int, end: int) -> None:
        """One record; raises `DecodeError`."""
        if opcode == Opcode.MESSAGE:
            self._take_loose(at, end)
        elif opcode == Opcode.CHUNK:
            first_ns, last_ns = self._take_records(at, self._source.chunk(at))
            if first_ns <= last_ns:
                self._contents.spans.append(TimeSpan(first_ns, last_ns, at, end - at))
        else:
            self._take_other(opcode, at, self._source.body(at)[1])

    def _take_other(self, opcode: int, at: int, body: bytes) -> None:
        """A record without messages, unless it is none; raises `DecodeError`."""
        fields = Fields(body)
        if opcode == Opcode.ATTACHMENT:
            found = attachment_of(body)
            entry = AttachmentEntry(
                name=found.name, media_type=found.media_type, octets=len(found.data), offset=at
            )
            self._contents.attachments.append(entry)
            return
        if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            self._contents.define(opcode, fields)
            return
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

    def _take_records(self, at: int, data: bytes) -> tuple[int, int]:
        """First and last log time of the messages in a chunk."""
        first_ns, last_ns, counts = LATEST_NS, 0, self._contents.counts
        unpack, unpack_head = MESSAGE.unpack_from, HEAD.unpack_from
        place = 0
        try:
            while place < len(data):
                body = place + HEAD.size
                opcode, length = unpack_head(data, place) if body <= len(data) else (0, 0)
                end = body + length
                if end > len(data):
                    raise DecodeError("a record that does not end", at_octet=place)
                if opcode == Opcode.MESSAGE and length >= MESSAGE_FIELDS_OCTETS:
                    _, _, channel_id, _, log_ns, _ = unpack(data, place)
                    counts[channel_id] = counts.get(channel_id, 0) + 1
                    first_ns, last_ns = min(first_ns, log_ns), max(last_ns, log_ns)
                elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    self._contents.define(opcode, Fields(data, body, end))
                place = end
        except DecodeError as error:  # what is before it is whole
            self._damages.add(at, f"in a chunk: {error}")
        return first_ns, last_ns

    def _take_loose(self, at: int, end: int) -> None:
        """A message outside chunks."""
        head = self._source.at(at, MESSAGE.size)
        if end - at < MESSAGE.size:
            raise DecodeError("a message that is too short")
        _, _, channel_id, _, log_ns, _ = MESSAGE.unpack(head)
        if channel_id not in self._contents.channels:
            raise DecodeError(f"a message of channel {channel_id}, which is unknown")
        self._contents.counts[channel_id] = self._contents.counts.get(channel_id, 0) + 1
        first_ns, last_ns, begin = log_ns, log_ns, at
        spans = self._contents.spans
        if spans and spans[-1].is_followed_at(at):
            first_ns, last_ns, begin, *_ = spans.pop()
        first_ns, last_ns = min(first_ns, log_ns), max(last_ns, log_ns)
        spans.append(TimeSpan(first_ns, last_ns, begin, end - begin, is_chunk=False))

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
            piece = source.at(at, piece_octets + CHUNK_HEAD_OCTETS)
            self._wasted += len(piece)
            for match in _CHUNK.finditer(piece, 0, piece_octets + CHUNK_HEAD_OCTETS):
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
        fields = Fields(self._source.at(at + HEAD.size, CHUNK_HEAD_OCTETS))
        try:
            first_ns, last_ns, _, _ = fields.take(CHUNK_FIELDS)
            name = fields.text()
            length = CHUNK_FIELDS.size + 4 + len(name) + 8 + fields.number(8)
        except DecodeError:
            return False
        return name in MOST_SHRUNK and first_ns <= last_ns and length == head[1]


MAX_HELD_OCTETS = 64 << 20  # Of chunks whose times overlap, while their messages are put in order
# In a chunk, and so many again that wait to be put in order: a message of no octets takes room.
MAX_MESSAGES = 1 << 18
_log_time = attrgetter("log_time_ns")
# Channels whose messages are asked for, by their numbers, and the number of the series of each.
Wanted = dict[int, tuple[Channel, int]]


class McapReader(RecordingReader):
    """Messages of an MCAP file, by log time. Raises `DecodeError` if it is none, and `OSError`."""

    def __init__(self, source: Path | str | BinaryIO) -> None:
        super().__init__()
        self._own = open(source, "rb") if isinstance(source, (Path, str)) else None  # noqa: SIM115, PTH123
        try:
            self._source = McapSource(self._own or source)  # type: ignore[arg-type]
            # A file that is cut may have no magic, and one that begins wrongly may go on rightly.
            head = self._source.head(len(MAGIC))
            is_begun = MAGIC.startswith(self._source.at(0, len(MAGIC)))
            if not is_begun and (head is None or head[0] != Opcode.HEADER):
                raise DecodeError("expected an MCAP file", at_octet=0)
            contents = read_index(self._source, self.damage)
            # Whether it was ended as it should, so that a part is found without reading the rest.
            self.is_indexed = contents is not None
            self._contents = contents or _Scan(self._source, self.damage).run()
        except BaseException:
            self.close()
            raise
        self._contents.spans.sort()

    @property
    def counts(self) -> Counter[ChannelKey]:
        """How many messages each series has."""
        counts: Counter[ChannelKey] = Counter()
        for number, channel in self._contents.channels.items():
            if not channel.holds_properties and (count := self._contents.counts.get(number)):
                counts[channel.series] += count
        return counts

    @property
    def times_ns(self) -> tuple[int, int] | None:
        """The first and the last log time; None without messages."""
        spans = self._contents.spans
        return (spans[0].first_ns, max(span.last_ns for span in spans)) if spans else None

    @property
    def at(self) -> int:
        """Where the file is read now."""
        return self._source.file.tell()

    def attachments(self) -> Sequence[AttachmentEntry]:
        """Files within the file, as they come; a name may be there twice."""
        return self._contents.attachments

    def attachment(self, name: str) -> Attachment | None:
        """The last attachment of that name that is whole; None if there is none."""
        for entry in reversed(self._contents.attachments):
            if entry.name != name:
                continue
            try:
                opcode, body = self._source.body(entry.offset)
                if opcode == Opcode.ATTACHMENT:
                    return attachment_of(body)
                raise DecodeError(f"expected the attachment {name!a}")
            except DecodeError as error:
                self.damage.add(entry.offset, str(error))
        return None

    def messages(
        self,
        start_ns: int | None = None,
        end_ns: int | None = None,
        topics: Collection[str] | None = None,
        stages: Collection[Stage] | None = None,
    ) -> Iterator[Recorded]:
        """Messages by log time, from `start_ns` on and before `end_ns`, of those topics and stages.

        Those of one time are in the order in which they were written.
        """
        first, end = start_ns or 0, LATEST_NS + 1 if end_ns is None else end_ns
        wanted = self._wanted(topics, stages)
        spans = [s for s in self._contents.spans if s.last_ns >= first and s.first_ns < end]
        held: list[Recorded] = []
        held_octets = 0
        for n, span in enumerate(spans, 1):
            data = b""
            try:
                data = self._source.records(span)
            except DecodeError as error:
                self.damage.add(span.offset, str(error))
            held += self._messages(span.offset, data, wanted, first, end)
            held.sort(key=_log_time)
            held_octets += len(data)
            if n == len(spans) or held_octets > MAX_HELD_OCTETS or len(held) > MAX_MESSAGES:
                ready = len(held)
            else:
                ready = bisect_left(held, spans[n].first_ns, key=_log_time)
            yield from held[:ready]
            held = held[ready:]
            held_octets = held_octets if held else 0

    def close(self) -> None:
        """Close the file, if it was opened here."""
        if self._own is not None:
            self._own.close()

    def _wanted(self, topics: Collection[str] | None, stages: Collection[Stage] | None) -> Wanted:
        numbers: dict[ChannelKey, int] = {}
        wanted: Wanted = {}
        for channel_id, channel in self._contents.channels.items():
            series = channel.series
            if (topics is None or series.topic in topics) and (
                stages is None or series.stage in stages
            ):
                wanted[channel_id] = channel, numbers.setdefault(series, len(numbers))
        return wanted

    def _messages(
        self, offset: int, data: bytes, wanted: Wanted, first_ns: int, end_ns: int
    ) -> list[Recorded]:
        """Messages in records, as they come; `offset` is where these are in the file."""
        found: list[Recorded] = []
        properties: dict[int, Properties] = {}
        unpack, known = MESSAGE.unpack_from, self._contents.channels
        at, octets = 0, len(data)
        while at + MESSAGE.size <= octets:
            opcode, length, number, sequence, log_ns, publish_ns = unpack(data, at)
            payload_at, at = at + MESSAGE.size, at + HEAD.size + length
            if at > octets or (opcode == Opcode.MESSAGE and at < payload_at):
                break
            if opcode != Opcode.MESSAGE:
                continue
            asked_for = wanted.get(number)
            if asked_for is None:
                if number not in known:
                    self.damage.add(offset, f"messages of channel {number}, which is unknown")
                continue
            if not first_ns <= log_ns < end_ns:
                continue
            channel, of_series = asked_for
            key = of_series << 32 | sequence
            if channel.holds_properties:
                try:
                    properties[key] = properties_of_json(data[payload_at:at])
                except DecodeError as error:
                    self.damage.add(offset, str(error))
                continue
            if len(found) == MAX_MESSAGES:
                self.damage.add(offset, f"a chunk: {MAX_MESSAGES} of its messages are read")
                return found
            series = channel.series
            beside = properties.pop(key, ()) if properties else ()
            found.append(
                Recorded(
                    series.topic,
                    data[payload_at:at],
                    log_ns,
                    publish_ns,
                    series.content_type,
                    beside,
                    series.retain,
                    series.qos,
                    series.stage,
                )
            )
        if at > octets or at + HEAD.size > octets > at:
            self.damage.add(offset, "in a chunk: a record that does not end")
        return found

"""Writes MCAP in zstd chunks, indexed, whole up to the last chunk at any time.

The official library writes the records that are few. Those that are many are written here, since
it takes several times as long for them, and does its compression where the messages come in.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from functools import partial
from typing import BinaryIO

import mcap.records as mcap
from mcap.opcode import Opcode

from plotfeed.proto.errors import EncodeError
from plotfeed.replay.mcap.channels import (
    PROPERTIES,
    ChannelKey,
    encoding_of,
    json_schema_of,
    message_type_of,
    properties_to_json,
    schema_of,
)
from plotfeed.replay.mcap.chunk_file import ChunkFile, record_of
from plotfeed.replay.mcap.records import MAX_RECORD_OCTETS, MESSAGE, MESSAGE_FIELDS_OCTETS
from plotfeed.replay.recorded import Attachment, Recorded, RecordingWriter

CHUNK_OCTETS = 256 << 10
MAX_PAYLOAD_OCTETS = MAX_RECORD_OCTETS // 2
DEFINE_EVERY = 16
"""Chunks: where there is no index, the loss of one shall not make others unreadable for long."""
MAX_CHANNELS = 65_535
LAST_SEQUENCE = 0xFFFFFFFF

Run = Callable[[Callable[[], None]], object]
"""Does a piece of work now or later, the pieces one after the other."""


def _at_once(work: Callable[[], None]) -> None:
    work()


class _Channel:
    """A channel that is being written."""

    __slots__ = ("defined_in", "definition", "entries", "id", "messages", "properties")

    def __init__(self, number: int, definition: bytes) -> None:
        self.id = number
        self.definition = definition
        self.defined_in = 0
        """Number of the last chunk that has the definition."""
        self.messages = 0
        self.entries: list[int] = []
        """Of the current chunk: log time, offset, log time, ..."""
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
        run: Run = _at_once,
    ) -> None:
        self._run = run
        self._file = ChunkFile(file, library, attachments)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[object, ...], _Channel] = {}
        self._last_id = 0
        self._parts: list[bytes] = []
        self._octets = 0
        self._touched: list[_Channel] = []
        self._chunk = 1
        """Number of the current one."""
        self._closed = False

    def write(self, message: Recorded) -> str | None:
        """Add a message whole; or why such a file cannot hold it, and nothing of it is there."""
        if len(message.payload) > MAX_PAYLOAD_OCTETS:
            return f"payload: larger than {MAX_PAYLOAD_OCTETS} octets"
        stage = message.stage._value_  # a text: its hash is much quicker than that of an enum
        key = (message.topic, message.content_type, stage, message.retain, message.qos)
        try:
            channel = self._channels.get(key) or self._new_channel(key, ChannelKey.of(message))
            if message.properties:
                self._add_properties(channel, key, message)
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
            self._touch(channel)
        entries += (log_ns, self._octets)
        self._parts += (head, payload)
        self._octets += MESSAGE.size + octets

    def _add_properties(
        self, channel: _Channel, key: tuple[object, ...], message: Recorded
    ) -> None:
        """A message of its own before the message itself, with the same number and times."""
        beside = channel.properties
        if beside is None:
            beside = channel.properties = self._new_channel(
                ("properties", *key), ChannelKey.of(message), of_properties=True
            )
        beside.messages = channel.messages
        payload = properties_to_json(message.properties)
        self._add(beside, message.log_time_ns, message.publish_time_ns, payload)

    def _new_channel(
        self, key: tuple[object, ...], series: ChannelKey, *, of_properties: bool = False
    ) -> _Channel:
        if self._last_id == MAX_CHANNELS:
            raise EncodeError(f"more than {MAX_CHANNELS} channels", field="topic")
        schema_id = 0 if of_properties else self._schema_of(series)
        encoding = "json" if of_properties else encoding_of(series.content_type)
        definition = mcap.Channel(
            id=self._last_id + 1,
            topic=(PROPERTIES if of_properties else "") + series.shown_topic,
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
        """Number of the schema of a series, protobuf's or of JSON; 0 if there is none."""
        message_type = message_type_of(series)
        if message_type:
            return self._schema(message_type, "protobuf", schema_of(message_type))
        found = json_schema_of(series)
        return 0 if found is None else self._schema(found[0], "jsonschema", found[1])

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

    def _touch(self, channel: _Channel) -> None:
        """The channel is in this chunk, with its definition if that is far away."""
        self._touched.append(channel)
        if not channel.defined_in or self._chunk - channel.defined_in >= DEFINE_EVERY:
            self._put(channel.definition)
            channel.defined_in = self._chunk

    def _put(self, record: bytes) -> None:
        self._parts.append(record)
        self._octets += len(record)

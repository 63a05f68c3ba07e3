"""Writes the native log: MCAP in zstd chunks, indexed, whole up to the last chunk at any time.

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
    message_type_of,
    properties_to_json,
    schema_of,
)
from plotfeed.replay.mcap.log_file import LogFile, record_of
from plotfeed.replay.mcap.records import (
    MAX_RECORD_OCTETS,
    MESSAGE,
    MESSAGE_FIELDS_OCTETS,
    Attachment,
)
from plotfeed.replay.recorded import Recorded

CHUNK_OCTETS = 256 << 10
"""Uncompressed; a chunk ends as soon as it is as large."""
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
    """One that is being written."""

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


class LogWriter:
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
        self._file = LogFile(file, library, attachments)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[object, ...], _Channel] = {}
        self._last_id = 0
        self._parts: list[bytes] = []
        self._octets = 0
        self._touched: list[_Channel] = []
        self._chunk = 1
        """Number of the current one."""
        self._closed = False

    def write(self, recorded: Recorded) -> None:
        """Add a message; raises `EncodeError` if such a file cannot hold it."""
        if len(recorded.payload) > MAX_PAYLOAD_OCTETS:
            raise EncodeError(f"larger than {MAX_PAYLOAD_OCTETS} octets", field="payload")
        stage = recorded.stage._value_  # a text: its hash is much quicker than that of an enum
        key = (recorded.topic, recorded.content_type, stage, recorded.retain, recorded.qos)
        try:
            channel = self._channels.get(key) or self._new_channel(key, ChannelKey.of(recorded))
            if recorded.properties:
                self._add_properties(channel, key, recorded)
            self._add(channel, recorded.log_time_ns, recorded.publish_time_ns, recorded.payload)
        except UnicodeEncodeError as error:
            raise EncodeError(
                "expected text that UTF-8 can hold", field=ascii(error.object)[:60]
            ) from None
        if self._octets >= CHUNK_OCTETS:
            self._end_chunk()

    def flush(self) -> None:
        """End the chunk, so that what has been written is in the file and readable."""
        self._end_chunk()

    def attach(self, attachment: Attachment) -> None:
        """Put another file into the file."""
        self._end_chunk()
        self._run(partial(self._file.attach, attachment))

    def close(self) -> None:
        """End the file with its index; again does nothing."""
        if not self._closed:
            self._closed = True
            self._end_chunk()
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
        self, channel: _Channel, key: tuple[object, ...], recorded: Recorded
    ) -> None:
        """Before the message itself, with the same number and times."""
        beside = channel.properties
        if beside is None:
            beside = self._new_channel(
                ("properties", *key), ChannelKey.of(recorded), of_properties=True
            )
            channel.properties = beside
        beside.messages = channel.messages
        payload = properties_to_json(recorded.properties)
        self._add(beside, recorded.log_time_ns, recorded.publish_time_ns, payload)

    def _new_channel(
        self, key: tuple[object, ...], series: ChannelKey, *, of_properties: bool = False
    ) -> _Channel:
        if self._last_id == MAX_CHANNELS:
            raise EncodeError(f"more than {MAX_CHANNELS} channels", field="topic")
        schema_id = 0 if of_properties else self._schema(message_type_of(series))
        encoding = "json" if of_properties else encoding_of(series.content_type)
        channel = _Channel(self._last_id + 1, b"")
        channel.definition = record_of(
            mcap.Channel(
                id=channel.id,
                topic=(PROPERTIES if of_properties else "") + series.shown_topic,
                message_encoding=encoding if schema_id or encoding != "protobuf" else "",
                metadata=series.metadata(of_properties=of_properties),
                schema_id=schema_id,
            )
        )
        self._last_id = channel.id
        self._channels[key] = channel
        self._file.definitions["channels"].append(channel.definition)
        return channel

    def _schema(self, message_type: str) -> int:
        """Number of a protobuf schema; 0 if there is none."""
        found = self._schemas.get(message_type)
        if found is not None or not message_type:
            return found or 0
        data = schema_of(message_type)
        if data is None:
            found = 0
        else:
            found = 1 + sum(number > 0 for number in self._schemas.values())
            schema = mcap.Schema(id=found, name=message_type, encoding="protobuf", data=data)
            octets = record_of(schema)
            self._put(octets)
            self._file.definitions["schemas"].append(octets)
        self._schemas[message_type] = found
        return found

    def _touch(self, channel: _Channel) -> None:
        """It is in this chunk, with its definition if that is far away."""
        self._touched.append(channel)
        if not channel.defined_in or self._chunk - channel.defined_in >= DEFINE_EVERY:
            self._put(channel.definition)
            channel.defined_in = self._chunk

    def _put(self, record: bytes) -> None:
        self._parts.append(record)
        self._octets += len(record)

    def _end_chunk(self) -> None:
        if not self._touched:
            return
        indexes = {channel.id: channel.entries for channel in self._touched}
        for channel in self._touched:
            channel.entries = []
        self._run(partial(self._file.add_chunk, self._parts, indexes))
        self._parts, self._octets, self._touched = [], 0, []
        self._chunk += 1

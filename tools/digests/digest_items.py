"""What a command wrote, as lines: text, octets, and the messages of a recording or a listener.

An item's digest is of its lines. Where a revision differs, the lines of both show what differs.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from google.protobuf.message import Message as ProtobufMessage
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from plotfeed.proto.content_types import protobuf_content_type
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.ledger_pb2 import LedgerBatch
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.mcap import McapReader, McapWriter, properties_to_json
from plotfeed.replay.recorded import Recorded

OCTETS_A_LINE = 32
HASH = 16  # Hexadecimal digits of a digest
# Before the topic of a channel that holds the user properties of another's messages.
PROPERTIES = "properties/"
LEDGER = "truth"
# Last levels of topics that tell how a session does: said things, no feed.
ABOUT_A_SESSION = {"status", "description", "settings", "session", "score", "refused", "report"}


@dataclass(frozen=True)
class Item:
    lines: list[str]
    # Whether it is text for people, or JSON of the same, and not what a tracker is sent.
    is_said: bool = False

    @property
    def digest(self) -> str:
        return hashlib.sha256("\n".join(self.lines).encode()).hexdigest()[:HASH]


def of_text(text: str) -> Item:
    return Item(text.split("\n"), is_said=True)


def of_octets(data: bytes) -> Item:
    at = range(0, len(data), OCTETS_A_LINE)
    return Item([data[i : i + OCTETS_A_LINE].hex() for i in at])


def of_messages(topic: str, lines: Iterable[str]) -> Item:
    return Item([*lines], is_said=topic.rsplit("/", 1)[-1] in ABOUT_A_SESSION)


def of_recording(path: Path) -> dict[str, Item]:
    """What an MCAP file holds, by topic and stage, in the order of the file; and that order.

    How messages are cut into chunks is left out: a session writes one every 0.25 s of real time.
    The ledger is decoded, for only what it says may not change. User properties, which come before
    their message, stand behind the message before; of the ledger those of the first sector do.
    """
    found: dict[str, list[str]] = {}
    order, others, ledger = [], [], []
    channels: dict[int, list[object]] = {}
    before, properties = "", b""
    for record, channel, schema in _records(path):
        if isinstance(record, Attachment):
            others.append(
                f"{record.name} {record.media_type} {record.log_time} {_sha(record.data)}"
            )
        elif isinstance(record, Metadata):
            others.append(json.dumps([record.name, sorted(record.metadata.items())]))
        elif isinstance(record, Message) and channel is not None:
            if channel.topic.startswith(PROPERTIES):
                properties = record.data
                continue
            of = channel.metadata.get("plotfeed.topic", channel.topic)
            is_ledger = of.rsplit("/", 1)[-1] == LEDGER
            if properties and before in found:  # else the message before is of the ledger
                if is_ledger:
                    properties = _properties_of_first(of, record.data)
                found[before][-1] += f" {properties.hex()}"
            properties = b""
            before = name = f"{of} {channel.metadata.get('plotfeed.stage', '')}".strip()
            if is_ledger:
                ledger.append(record.data)
                continue
            if channel.id not in channels:
                channels[channel.id] = _told(channel, schema)
                found.setdefault(name, []).append(json.dumps(channels[channel.id]))
            if of.rsplit("/", 1)[-1] not in ABOUT_A_SESSION:
                order.append(name)
            times = f"due {record.publish_time} sent {record.log_time}"
            found.setdefault(name, []).append(f"{times} {without_pace(of, record.data).hex()}")
    items = {name: of_messages(name.split()[0], lines) for name, lines in sorted(found.items())}
    items |= {"order": Item(order), "attachments": Item(others, is_said=True)}
    return items | {"ledger": Item(sorted(row for data in ledger for row in _rows(data)))}


def without_pace(topic: str, payload: bytes) -> bytes:
    """A message, without what a status says of the machine's own pace."""
    if topic.endswith("/status") and payload.startswith(b"{"):
        said = json.loads(payload)
        said.pop("intake_behind_s", None)
        return json.dumps(said, sort_keys=True).encode()  # maps of protobuf have no order
    return payload


def _rows(payload: bytes) -> Iterator[str]:
    """The rows of a ledger's message, each by itself, with the sector that it is of."""
    for entry in entries_in(payload):
        of = f"{entry.sensor} {entry.scan} {entry.sector}"
        yield f"{of} link {entry.link}"
        for table in ("looks", "plots", "messages", "claims"):
            for i, row in enumerate(getattr(entry, table)):
                yield f"{of} {table} {i} {json.dumps(_values(row))}"


def write_by_sector(path: Path) -> None:
    """Have a recording hold its ledger as earlier versions did: a message for each sector."""
    found = path.read_bytes()
    with McapReader(io.BytesIO(found)) as log, path.open("wb") as file:
        held = map(log.attachment, [entry.name for entry in log.attachments()])
        writer = McapWriter(file, attachments=[each for each in held if each is not None])
        for message in log.messages():
            for each in _by_sector(message):
                writer.write(each)
        writer.close()


def _by_sector(message: Recorded) -> Iterator[Recorded]:
    if message.topic.rsplit("/", 1)[-1] != LEDGER:
        yield message
        return
    for entry, end_ns, properties in _sectors(message.topic, message.payload):
        yield message._replace(
            payload=entry.SerializeToString(),
            publish_time_ns=end_ns,
            content_type=protobuf_content_type("plotfeed.v1.Ledger"),
            properties=properties,
        )


def _properties_of_first(topic: str, payload: bytes) -> bytes:
    *_, properties = next(_sectors(topic, payload))
    return properties_to_json(properties)


def _sectors(topic: str, payload: bytes) -> Iterator[tuple[Any, int, Any]]:
    """Each sector's entry, its end, and the user properties that its message once had."""
    prefix = topic.removesuffix(f"/{LEDGER}")
    ends_ns = LedgerBatch.FromString(payload).sectors.end_utc_ns
    for entry, end_ns in zip(entries_in(payload), ends_ns, strict=True):
        properties = (
            ("specversion", "1.0"),
            ("id", f"truth-{entry.scan}-{entry.sector}"),
            ("source", f"{prefix}/{entry.sensor}"),
            ("type", "plotfeed.truth"),
            ("time", iso_utc(end_ns)),
            ("sensor", entry.sensor),
            ("scan", str(entry.scan)),
            ("sector", str(entry.sector)),
        )
        yield entry, end_ns, properties


def _values(row: ProtobufMessage) -> dict[str, Any]:
    return {
        field.name: [*value] if field.is_repeated else value for field, value in row.ListFields()
    }


def _records(path: Path) -> Iterator[tuple[object, Channel | None, Schema | None]]:
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                yield record, channel, schemas.get(channel.schema_id)
            else:
                yield record, None, None


def _told(channel: Channel, schema: Schema | None) -> list[object]:
    of_schema = [schema.name, schema.encoding, _sha(schema.data)] if schema else []
    about = sorted(channel.metadata.items())
    return [channel.topic, channel.message_encoding, about, of_schema]


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
